// Light on an instance: a gain of its splats' colours, linear in their normals.

// A unit normal from two numbers of 16 bits on an unfolded octahedron, as
// `gn0.render.cuda.instances.pack_normals` packs them.
__device__ __forceinline__ float2 read_normal(u32 word) {
  return make_float2((float)(short)(word & 0xffffu) * (1.f / 32767.f),
                     (float)(short)(word >> 16) * (1.f / 32767.f));
}

__device__ __forceinline__ float3 unfold_normal(float2 flat) {
  float x = flat.x, y = flat.y;
  float z = 1.f - fabsf(x) - fabsf(y), fold = fmaxf(-z, 0.f);
  x += x < 0.f ? fold : -fold, y += y < 0.f ? fold : -fold;
  float scale = fast_rsqrt(fmaf(x, x, fmaf(y, y, z * z)));
  return make_float3(x * scale, y * scale, z * scale);
}

__device__ __forceinline__ void light_splat(Staged &to, const Part &part, u32 slot) {
  const u32 *normals = part.normals;
  if (!normals) return;
  const float4 *rows = (const float4 *)part.gain;
  bool posed = part.cloud.degree == PACKED;
  u32 word = __ldg(normals + (posed ? slot * 4 + 3 : slot));
  float3 n = unfold_normal(posed ? read_posed_normal(word) : read_normal(word));
  float4 a = __ldg(rows), b = __ldg(rows + 1), c = __ldg(rows + 2);
  float red = fmaf(c.y, n.z, fmaf(b.z, n.y, fmaf(a.w, n.x, a.x)));
  float green = fmaf(c.z, n.z, fmaf(b.w, n.y, fmaf(b.x, n.x, a.y)));
  float blue = fmaf(c.w, n.z, fmaf(c.x, n.y, fmaf(b.y, n.x, a.z)));
  to.b.z *= fmaxf(red, 0.f), to.b.w *= fmaxf(green, 0.f), to.c.x *= fmaxf(blue, 0.f);
}
