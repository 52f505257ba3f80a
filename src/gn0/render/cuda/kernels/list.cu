// Lists of entries of all views, and the scans that give them room and an order; see `list.cuh`.

// Counts one splat in `stride`.
KERNEL_BOUNDED(count_entries, CHUNK, COVER_BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const Group *__restrict__ groups,
 u32 group_count, const u32 *__restrict__ members, u32 tiles_x, u32 tiles, u32 flags, u32 each,
 u32 *counts, u32 stride) {
  Lists to = {counts, nullptr, 0, 0};
  list_chunks<false>(views, clouds, groups, group_count, members, tiles_x, tiles, flags, each, stride, to);
}

KERNEL_BOUNDED(emit_entries, CHUNK, COVER_BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const Group *__restrict__ groups,
 u32 group_count, const u32 *__restrict__ members, u32 tiles_x, u32 tiles, u32 flags, u32 each,
 u32 *counts, const u64 *__restrict__ needed, u64 *entries, u64 capacity, u32 room) {
  if (!room && *needed > capacity) return;  // the host sees it too, and repeats with more room
  Lists to = {counts, entries, capacity, room};
  list_chunks<true>(views, clouds, groups, group_count, members, tiles_x, tiles, flags, each, 1, to);
}

// A block of 256 threads adds up SCAN counts.
#define SCAN 2048
#define EACH (SCAN / 256)

__device__ __forceinline__ u64 sum_block(u64 mine, u64 *held) {
  for (int d = WARP / 2; d; d >>= 1) mine += __shfl_xor_sync(FULL, mine, d);
  if (lane_id() == 0) held[threadIdx.x / WARP] = mine;
  __syncthreads();
  u64 sum = 0;
  for (u32 w = 0; w < 256 / WARP; w++) sum += held[w];
  __syncthreads();
  return sum;
}

// Tiles are drawn longest list first, by class, so that no long one is left over at the end.
#define CLASSES 8
#define SHORT_BITS 10  // lists shorter than 2^10 are one class, in their own order

struct Classes {  // zeros before
  u32 many[CLASSES], taken[CLASSES], longest, over;
};

__device__ __forceinline__ u32 class_of(u32 count) {
  u32 bits = 32 - __clz(count | 1);
  return bits <= SHORT_BITS ? 0 : min(bits - SHORT_BITS, (u32)CLASSES - 1);
}

// Adds these counts to the block's classes, to be seen behind the next barrier.
__device__ __forceinline__ void count_classes(const u32 *count, u32 n, Classes &to) {
  u32 plain = 0, longest = 0;
  for (u32 k = 0; k < n; k++) {
    u32 c = class_of(count[k]);
    if (c) atomicAdd(to.many + c, 1u);
    else plain++;
    longest = max(longest, count[k]);
  }
  if (plain) atomicAdd(to.many, plain);
  if (longest) atomicMax(&to.longest, longest);
}

// Room for a list of which a pass over one splat in `stride` has counted so many: what was counted
// if it was all, else a quarter more than expected and SLACK (eight standard deviations at 1,000).
#define SLACK 256
__device__ __forceinline__ u32 room_for(u32 counted, u32 stride) {
  return stride == 1 ? counted : counted * stride + counted * stride / 4 + SLACK;
}

struct Written {  // lists behind `emit_entries`
  const u32 *counts;
  const u64 *starts;  // null where all have the same room

  __device__ __forceinline__ u32 length(u64 tile) const {
    return starts ? counts[tile] - (u32)starts[tile] : counts[tile];
  }
  __device__ __forceinline__ bool over(u64 tile, u32 length) const {
    return starts && length > starts[tile + 1] - starts[tile];
  }
};

// Only where a scan takes more blocks than one. With `stride`: of the room for lists; else of their
// lengths, and their classes.
KERNEL(sum_counts)(const u32 *__restrict__ counts, u32 all_tiles, u32 stride,
                   const u64 *__restrict__ starts, u64 *sums, Classes *classes) {
  __shared__ u64 held[256 / WARP];
  __shared__ Classes mine_of;
  if (threadIdx.x < sizeof(Classes) / 4) ((u32 *)&mine_of)[threadIdx.x] = 0;
  __syncthreads();
  const Written lists = {counts, starts};
  u64 mine = 0;
  u32 count[EACH], n = 0;
  for (u32 k = 0; k < EACH; k++) {
    u64 at = (u64)blockIdx.x * SCAN + k * 256 + threadIdx.x;
    if (at >= all_tiles) continue;
    if (stride) {
      mine += room_for(counts[at], stride);
      continue;
    }
    mine += count[n] = lists.length(at);
    if (lists.over(at, count[n++])) atomicMax(&mine_of.over, 1u);
  }
  if (!stride) count_classes(count, n, mine_of);
  u64 sum = sum_block(mine, held);
  if (threadIdx.x == 0) sums[blockIdx.x] = sum;
  if (stride) return;
  if (threadIdx.x == 0) {
    atomicMax(&classes->longest, mine_of.longest);
    if (mine_of.over) atomicMax(&classes->over, 1u);
  }
  if (threadIdx.x < CLASSES && mine_of.many[threadIdx.x])
    atomicAdd(classes->many + threadIdx.x, mine_of.many[threadIdx.x]);
}

// How much lies before this thread's share, which is `mine`; all threads of all blocks call it.
__device__ __forceinline__ u64 scan_block(u64 mine, const u64 *__restrict__ sums, u64 *held) {
  u64 others = 0;
  for (u32 b = threadIdx.x; b < blockIdx.x; b += 256) others += sums[b];
  u64 before = sum_block(others, held), sum = mine;
  for (u32 d = 1; d < WARP; d <<= 1) {
    u64 other = __shfl_up_sync(FULL, sum, d);
    if (lane_id() >= d) sum += other;
  }
  if (lane_id() == WARP - 1) held[threadIdx.x / WARP] = sum;
  __syncthreads();
  for (u32 w = 0; w < threadIdx.x / WARP; w++) before += held[w];
  return before + sum - mine;
}

// Where lists begin, by what was counted; `counts` become where the next entry goes.
KERNEL(place_lists)(u32 *counts, u32 all_tiles, u32 stride, const u64 *__restrict__ sums, u64 *starts) {
  __shared__ u64 held[256 / WARP];
  u64 first = (u64)blockIdx.x * SCAN + threadIdx.x * EACH, total = 0;
  u32 room[EACH];
  for (u32 k = 0; k < EACH; k++) {
    room[k] = first + k < all_tiles ? room_for(counts[first + k], stride) : 0;
    total += room[k];
  }
  u64 before = scan_block(total, sums, held);
  for (u32 k = 0; k < EACH && first + k < all_tiles; k++) {
    starts[first + k] = before;
    counts[first + k] = (u32)before;  // lists of more than 2^32 entries have no room anyhow
    before += room[k];
    if (first + k == all_tiles - 1) starts[all_tiles] = before;
  }
}

// The order in which lists are drawn, what is known of them all, also for the host (`told`), and
// whether a view is none (`written`: by `write_views`).
KERNEL(scan_counts)(const u32 *__restrict__ counts, u32 all_tiles, const u64 *__restrict__ starts,
                    const u64 *__restrict__ sums, Classes *classes, u32 *order,
                    const View *__restrict__ written, u32 views, State *state, u64 *told) {
  __shared__ u64 held[256 / WARP], whole;
  __shared__ Classes mine_of;
  __shared__ u32 place[CLASSES], wrong;
  if (threadIdx.x < sizeof(Classes) / 4) ((u32 *)&mine_of)[threadIdx.x] = 0;
  if (threadIdx.x == 0) wrong = NOWHERE;
  __syncthreads();
  const Written lists = {counts, starts};
  u64 first = (u64)blockIdx.x * SCAN + threadIdx.x * EACH, total = 0;
  u32 count[EACH], n = 0;
  for (u32 k = 0; k < EACH; k++) {
    count[k] = first + k < all_tiles ? lists.length(first + k) : 0;
    if (first + k < all_tiles && lists.over(first + k, count[k])) atomicMax(&mine_of.over, 1u);
    n += first + k < all_tiles;
    total += count[k];
  }
  count_classes(count, n, mine_of);
  u64 before = scan_block(total, sums, held);
  bool alone = gridDim.x == 1, last = blockIdx.x == gridDim.x - 1;
  if (threadIdx.x < CLASSES) {
    const u32 *many = alone ? mine_of.many : classes->many;
    u32 ahead = 0, c = threadIdx.x;
    for (u32 k = c + 1; k < CLASSES; k++) ahead += many[k];
    place[c] = ahead + (alone ? 0 : atomicAdd(classes->taken + c, mine_of.many[c]));
  }
  if (n && first + n == all_tiles) whole = before + total;
  __syncthreads();
  u32 plain = 0;
  for (u32 k = 0; k < n; k++) plain += !class_of(count[k]);
  u32 at = plain ? atomicAdd(place, plain) : 0;
  for (u32 k = 0; k < n; k++) {
    u32 c = class_of(count[k]);
    order[c ? atomicAdd(place + c, 1u) : at++] = (u32)first + k;
  }
  if (!last) return;
  u32 found = NOWHERE;
  for (u32 v = threadIdx.x; v < views; v += 256) found = min(found, written[v].spare[0]);
  if (found != NOWHERE) atomicMin(&wrong, found);
  __syncthreads();
  if (threadIdx.x) return;
  bool over = alone ? mine_of.over : classes->over;
  State now = {over ? NO_ROOM : starts ? starts[all_tiles] : whole,
               alone ? mine_of.longest : classes->longest, wrong, whole};
  *state = now;
  told[0] = now.needed, told[1] = now.longest, told[2] = now.wrong, told[3] = now.entries;
}
