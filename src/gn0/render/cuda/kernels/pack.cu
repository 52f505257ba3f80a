// A cloud's own arrays to the layout that drawing reads; see `gn0.render.cuda.pack`.
//
// Operation for operation what `gn0.render.cpu_pack` does, so that all backends start from the same
// numbers. Each splat goes to its own place: no order of threads shows.

#define CHUNK 256
#define NOWHERE 0xffffffffu
#define HALF_MAX 65504.f

__device__ __forceinline__ u32 to_half(float x) {
  return float_to_half(fminf(fmaxf(x, -HALF_MAX), HALF_MAX));
}

// Rows that nobody packs are padding. Grid: rows / 256.
KERNEL(clear_rows)(float4 *__restrict__ splats, u32 *__restrict__ order) {
  u64 row = (u64)blockIdx.x * CHUNK + threadIdx.x;
  float4 zero = {0.f, 0.f, 0.f, 0.f}, dead = {0.f, 0.f, 0.f, -1.f};
  splats[row * 4] = dead;
  splats[row * 4 + 1] = zero, splats[row * 4 + 2] = zero, splats[row * 4 + 3] = zero;
  order[row] = 0;
}

// Splats of a piece of the cloud; `places` says which row each goes to, and `index` which number
// in its cloud it has. `coefficients`: of spherical harmonics a colour, the first one included.
KERNEL(pack_splats)(const float *__restrict__ means, const float *__restrict__ quats,
                    const float *__restrict__ scales, const float *__restrict__ log_opacity,
                    const float *__restrict__ sh, u32 coefficients, u32 count,
                    const u32 *__restrict__ places, const u32 *__restrict__ index,
                    float4 *__restrict__ splats, u32 *__restrict__ order,
                    u32 *__restrict__ sh_rows, u32 sh_row) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count) return;
  u32 row = places[i];
  if (row == NOWHERE) return;
  float w = quats[i * 4], x = quats[i * 4 + 1], y = quats[i * 4 + 2], z = quats[i * 4 + 3];
  float norm = sqrtf(w * w + x * x + y * y + z * z);
  if (norm > 0.f) w = w / norm, x = x / norm, y = y / norm, z = z / norm;
  else w = 1.f;  // no rotation stored: the axes of the world
  float a = scales[i * 3], b = scales[i * 3 + 1], c = scales[i * 3 + 2];
  float log_o = log_opacity[i];
  float extent = sqrtf(fmaxf(2.f * (log_o - LOG_ALPHA_MIN), 0.f));
  float4 *to = splats + (u64)row * 4;
  to[0] = {means[i * 3], means[i * 3 + 1], means[i * 3 + 2], extent};
  to[1] = {(1.f - 2.f * (y * y + z * z)) * a, 2.f * (x * y - w * z) * b,
           2.f * (x * z + w * y) * c, 2.f * (x * y + w * z) * a};
  to[2] = {(1.f - 2.f * (x * x + z * z)) * b, 2.f * (y * z - w * x) * c,
           2.f * (x * z - w * y) * a, 2.f * (y * z + w * x) * b};
  const float *from = sh + (u64)i * coefficients * 3;
  float red = SH_C0 * from[0], green = SH_C0 * from[1], blue = SH_C0 * from[2];
  if (coefficients == 1) {
    red = fmaxf(red + 0.5f, 0.f), green = fmaxf(green + 0.5f, 0.f);
    blue = fmaxf(blue + 0.5f, 0.f);
  }
  to[3] = {(1.f - 2.f * (x * x + y * y)) * c, log_o,
           __uint_as_float(to_half(red) | to_half(green) << 16), __uint_as_float(to_half(blue))};
  order[row] = index[i];
  if (!sh_row) return;
  u32 values = (coefficients - 1) * 3, *rest = sh_rows + (u64)row * (sh_row / 2);
  for (u32 k = 0; k < sh_row; k += 2) {
    u32 low = k < values ? to_half(from[3 + k]) : 0u;
    u32 high = k + 1 < values ? to_half(from[4 + k]) : 0u;
    rest[k / 2] = low | high << 16;
  }
}

// Lowest and highest centre and largest reach of chunks: of a cloud, or of its splats `slots`.
// Grid: chunks.
KERNEL(box_chunks)(const float4 *__restrict__ splats, const u32 *__restrict__ slots, u32 rows,
                   float *__restrict__ boxes) {
  __shared__ float low[3][CHUNK / WARP], high[4][CHUNK / WARP];
  u64 at = (u64)blockIdx.x * CHUNK + threadIdx.x;
  u32 row = slots ? slots[at] : (u32)at;
  float lo[3] = {INFINITY, INFINITY, INFINITY}, hi[4] = {-INFINITY, -INFINITY, -INFINITY, 0.f};
  if (row < rows && splats[(u64)row * 4].w >= 0.f) {
    const float4 *s = splats + (u64)row * 4;
    float4 p = s[0], a = s[1], b = s[2];
    float last = s[3].x;
    lo[0] = hi[0] = p.x, lo[1] = hi[1] = p.y, lo[2] = hi[2] = p.z;
    // a column of M is an axis of the ellipsoid, as long as its standard deviation
    float x = a.x * a.x + a.w * a.w + b.z * b.z;
    float y = a.y * a.y + b.x * b.x + b.w * b.w;
    float z = a.z * a.z + b.y * b.y + last * last;
    hi[3] = p.w * sqrtf(fmaxf(x, fmaxf(y, z))) * 1.00001f;
  }
  for (int d = WARP / 2; d; d >>= 1) {
    for (int k = 0; k < 3; k++) lo[k] = fminf(lo[k], __shfl_xor_sync(FULL, lo[k], d));
    for (int k = 0; k < 4; k++) hi[k] = fmaxf(hi[k], __shfl_xor_sync(FULL, hi[k], d));
  }
  u32 warp = threadIdx.x / WARP;
  if (lane_id() == 0) {
    for (int k = 0; k < 3; k++) low[k][warp] = lo[k];
    for (int k = 0; k < 4; k++) high[k][warp] = hi[k];
  }
  __syncthreads();
  if (threadIdx.x < 7) {
    u32 k = threadIdx.x;
    float v = k < 3 ? low[k][0] : high[k - 3][0];
    for (u32 w = 1; w < CHUNK / WARP; w++)
      v = k < 3 ? fminf(v, low[k][w]) : fmaxf(v, high[k - 3][w]);
    boxes[(u64)blockIdx.x * 7 + k] = v;
  }
}
