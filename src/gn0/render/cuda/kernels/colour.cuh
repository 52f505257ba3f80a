// Colour of one splat from its spherical harmonics: `gn0.render.cpu_sh` with half coefficients.

// Adds eight halves, times the weights of their coefficients, to three colours in turn.
#define TERM(k, value) rgb[(k) % 3] = fmaf(weight[(k) / 3], half_to_float((u16)(value)), rgb[(k) % 3])

__device__ __forceinline__ float3 find_colour(const Cloud &cloud, const Splat &s, u32 slot,
                                              const View &w) {
  bool posed = INSTANCES && cloud.degree == PACKED;
  const uint2 *at = posed ? (const uint2 *)((const float4 *)cloud.slots + (u64)slot * 2 + 1)
                          : (const uint2 *)(cloud.splats + (u64)slot * 4) + 7;
  const uint2 packed = __ldg(at);
  float rgb[3] = {half_to_float((u16)packed.x), half_to_float((u16)(packed.x >> 16)),
                  half_to_float((u16)packed.y)};
  if (!cloud.degree || posed) return make_float3(rgb[0], rgb[1], rgb[2]);
  float x = s.x - w.eye[0], y = s.y - w.eye[1], z = s.z - w.eye[2];
  float squared = fmaf(x, x, fmaf(y, y, z * z));
  float scale = squared > 0.f ? fast_rsqrt(squared) : 0.f;
  x *= scale, y *= scale, z *= scale;
  float xx = x * x, yy = y * y, zz = z * z;
  float weight[16] = {
      -0.4886025119029199f * y,
      0.4886025119029199f * z,
      -0.4886025119029199f * x,
      1.0925484305920792f * x * y,
      -1.0925484305920792f * y * z,
      0.31539156525252005f * (2.f * zz - xx - yy),
      -1.0925484305920792f * x * z,
      0.5462742152960396f * (xx - yy),
      -0.5900435899266435f * y * (3.f * xx - yy),
      2.890611442640554f * x * y * z,
      -0.4570457994644658f * y * (4.f * zz - xx - yy),
      0.3731763325901154f * z * (2.f * zz - 3.f * xx - 3.f * yy),
      -0.4570457994644658f * x * (4.f * zz - xx - yy),
      1.445305721320277f * z * (xx - yy),
      -0.5900435899266435f * x * (xx - 3.f * yy),
      0.f};
  const uint4 *row = (const uint4 *)(cloud.sh + (u64)slot * cloud.sh_row);
  // 9, 24 or 45 halves, padded with zeros to whole quadruples of words
  u32 quads = cloud.degree == 1 ? 2 : cloud.degree == 2 ? 3 : 6;
#pragma unroll
  for (u32 q = 0; q < 6; q++) {
    if (q >= quads) break;
    uint4 v = __ldg(row + q);
    TERM(q * 8 + 0, v.x), TERM(q * 8 + 1, v.x >> 16);
    TERM(q * 8 + 2, v.y), TERM(q * 8 + 3, v.y >> 16);
    TERM(q * 8 + 4, v.z), TERM(q * 8 + 5, v.z >> 16);
    TERM(q * 8 + 6, v.w), TERM(q * 8 + 7, v.w >> 16);
  }
  return make_float3(fmaxf(rgb[0] + 0.5f, 0.f), fmaxf(rgb[1] + 0.5f, 0.f), fmaxf(rgb[2] + 0.5f, 0.f));
}
