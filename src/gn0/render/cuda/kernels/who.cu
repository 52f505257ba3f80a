// How instances show: a block each. `numbers` [V, pixels] say which instance of its view each pixel
// shows, by its place from 1; `alone` [K, pixels] are opacities of K instances with nothing around
// them. Of instance k, that of the view `views[k]` with the place `places[k]`, row `rows[k]` of
// `out` gets the pixels that show it, those that it has alone from the opacity `shown` on, those of
// both, and the box of the first: left, top, right, bottom.
#define SEEN 7

KERNEL(count_seen)(const u32 *numbers, const float *alone, const int *views, const int *places,
                   const int *rows, u64 pixels, u32 width, float shown, u32 *out) {
  __shared__ u32 all[SEEN];
  u32 t = threadIdx.x, k = blockIdx.x, place = (u32)places[k] + 1;
  if (t < SEEN) all[t] = t == 3 || t == 4 ? 0xffffffffu : 0;
  __syncthreads();
  const u32 *mine = numbers + (u64)views[k] * pixels;
  const float *whole = alone + (u64)k * pixels;
  u32 seen = 0, total = 0, both = 0, left = 0xffffffffu, top = 0xffffffffu, right = 0, bottom = 0;
  for (u64 i = t; i < pixels; i += blockDim.x) {
    bool here = mine[i] == place, there = whole[i] >= shown;
    total += there, both += here && there;
    if (!here) continue;
    u32 x = (u32)(i % width), y = (u32)(i / width);
    seen++;
    left = min(left, x), right = max(right, x + 1);
    top = min(top, y), bottom = max(bottom, y + 1);
  }
  if (total) atomicAdd(all + 1, total);
  if (both) atomicAdd(all + 2, both);
  if (seen) {
    atomicAdd(all, seen);
    atomicMin(all + 3, left), atomicMin(all + 4, top);
    atomicMax(all + 5, right), atomicMax(all + 6, bottom);
  }
  __syncthreads();
  if (t < SEEN) out[(u64)rows[k] * SEEN + t] = all[0] || t < 3 ? all[t] : 0;
}
