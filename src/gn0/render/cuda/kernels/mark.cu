// Behind pack.cu. Visible sets: from marks (a bit a splat, in cloud order, as np.packbits lays them)
// to lists of packed numbers.
// Everything that crosses threads is an OR, a count or a minimum: its order cannot show.

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
