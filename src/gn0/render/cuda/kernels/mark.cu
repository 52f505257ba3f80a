// Visible sets: from marks (a bit a splat, in cloud order, as np.packbits lays them) to slot lists.
// Everything that crosses threads is an OR, a count or a minimum: its order cannot show.

#define CHUNK 256

// Bit of splat `index` in a row of little-endian words whose bytes are np.packbits's.
__device__ __forceinline__ u32 mark_bit(u32 index) { return 1u << ((index & 24u) | (7u - (index & 7u))); }

// Marks what lies within sqrt(reach2) of a place: near planes may have cut it off.
// Grid: chunks of the cloud. Places are x, y, z and, as bits, the row of their set.
KERNEL(mark_near)(const float4 *__restrict__ splats, const u32 *__restrict__ order,
                  const float *__restrict__ boxes, const float4 *__restrict__ places, int count,
                  float reach2, u32 *__restrict__ bits, u32 words) {
  u32 c = blockIdx.x;
  const float *box = boxes + (u64)c * 7;
  u64 slot = (u64)c * CHUNK + threadIdx.x;
  float4 s = splats[slot * 4];
  u32 index = order[slot];
  for (int k = 0; k < count; k++) {
    float4 eye = places[k];
    float gx = fmaxf(fmaxf(box[0] - eye.x, eye.x - box[3]), 0.f);
    float gy = fmaxf(fmaxf(box[1] - eye.y, eye.y - box[4]), 0.f);
    float gz = fmaxf(fmaxf(box[2] - eye.z, eye.z - box[5]), 0.f);
    if (gx * gx + gy * gy + gz * gz > reach2) continue;
    float x = s.x - eye.x, y = s.y - eye.y, z = s.z - eye.z;
    if (s.w >= 0.f && x * x + y * y + z * z <= reach2)
      atomicOr(bits + (u64)__float_as_uint(eye.w) * words + (index >> 5), mark_bit(index));
  }
}

__device__ __forceinline__ bool is_marked(const u32 *row, const u32 *order, u64 slot, u32 alive) {
  if (slot >= alive) return false;
  u32 index = order[slot];
  return (row[index >> 5] & mark_bit(index)) != 0;
}

// Marked splats of each chunk of the cloud. Grid: (chunks, sets).
KERNEL(count_slots)(const u32 *__restrict__ bits, u32 words, const u32 *__restrict__ order,
                    u32 alive, u32 *__restrict__ counts) {
  const u32 *row = bits + (u64)blockIdx.y * words;
  int n = __syncthreads_count(is_marked(row, order, (u64)blockIdx.x * CHUNK + threadIdx.x, alive));
  if (threadIdx.x == 0) counts[(u64)blockIdx.y * gridDim.x + blockIdx.x] = n;
}

// Counts to starts, in place, a block of 256 threads a set; `totals` gets the sums.
KERNEL(scan_slots)(u32 *__restrict__ counts, u32 chunks, u32 *__restrict__ totals) {
  __shared__ u32 sums[CHUNK / WARP];
  u32 *row = counts + (u64)blockIdx.x * chunks;
  u32 warp = threadIdx.x / WARP, before = 0;
  for (u32 first = 0; first < chunks; first += CHUNK) {
    u32 at = first + threadIdx.x, mine = at < chunks ? row[at] : 0, sum = mine;
    for (u32 d = 1; d < WARP; d <<= 1) {
      u32 other = __shfl_up_sync(FULL, sum, d);
      if (lane_id() >= d) sum += other;
    }
    if (lane_id() == WARP - 1) sums[warp] = sum;
    __syncthreads();
    u32 base = before, all = before;
    for (u32 w = 0; w < CHUNK / WARP; w++) {
      if (w < warp) base += sums[w];
      all += sums[w];
    }
    if (at < chunks) row[at] = base + sum - mine;
    before = all;
    __syncthreads();
  }
  if (threadIdx.x == 0) totals[blockIdx.x] = before;
}

// Packed numbers of one set's splats, in packed order. Grid: chunks of the cloud.
KERNEL(fill_slots)(const u32 *__restrict__ row, const u32 *__restrict__ order, u32 alive,
                   const u32 *__restrict__ starts, u32 *__restrict__ slots, u32 total) {
  __shared__ u32 sums[CHUNK / WARP];
  u64 slot = (u64)blockIdx.x * CHUNK + threadIdx.x;
  bool marked = is_marked(row, order, slot, alive);
  u32 votes = __ballot_sync(FULL, marked), warp = threadIdx.x / WARP;
  if (lane_id() == 0) sums[warp] = __popc(votes);
  __syncthreads();
  u32 at = starts[blockIdx.x] + __popc(votes & ((1u << lane_id()) - 1));
  for (u32 w = 0; w < warp; w++) at += sums[w];
  if (marked && at < total) slots[at] = (u32)slot;
}

// Boxes of a set's own chunks: lowest and highest centre, largest reach. Grid: chunks of the set.
KERNEL(box_slots)(const float4 *__restrict__ splats, const u32 *__restrict__ slots, u32 total,
                  float *__restrict__ boxes) {
  __shared__ float low[3][CHUNK / WARP], high[4][CHUNK / WARP];
  u64 at = (u64)blockIdx.x * CHUNK + threadIdx.x;
  float lo[3] = {INFINITY, INFINITY, INFINITY}, hi[4] = {-INFINITY, -INFINITY, -INFINITY, 0.f};
  if (at < total) {
    const float4 *s = splats + (u64)slots[at] * 4;
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
