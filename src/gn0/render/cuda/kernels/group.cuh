// A tile's list, a group at a time, in order of its keys.
//
// A list that fits a group (CAPACITY) is sorted at once. A longer one is first parted by key into
// PARTS, by one pass that counts and one that moves its entries to the spare list; a run of parts
// that fits is the next group. So each entry is moved once, however long the list is, and what lies
// behind the last open pixel is never sorted. A part that does not fit (one floor seen from above:
// all at one depth) gives its lowest entries a group at a time.

#define PIXELS 2                         // side by side, that a thread blends
#define BLENDERS (TILE * TILE / PIXELS)  // threads; what more there are only sort and stage
#define WARPS (BLENDERS / WARP)          // of these; each blends a quarter of the tile
#define SIDE (TILE / 2)                  // px: of a quarter
#define PARTS (2 * CAPACITY)
#define HOLD (CAPACITY / THREADS)  // entries of a group that a thread holds
#define AHEAD 4                    // loads of a list under way
#define SPAN (WARP + 1)
#define LOG2_ALPHA_MIN (LOG_ALPHA_MIN * LOG2_E)
#define SQRT_LOG2_E 1.2011224087864498f

struct Staged {
  float4 a;  // qx, qy, c, k: q = qx x + qy y + c
  float4 b;  // s, log2 opacity, red, green: exponent = log2 o - (k y + s)^2 - q^2
  float2 c;  // blue, depth
  float2 spare;  // 16-byte loads need the room, and 48 bytes meet few bank conflicts
};

struct Plan {  // of the walk through a list; the same for all threads
  const u64 *list;
  u64 *spare;
  u64 low, high;  // keys that are still to come of a part that does not fit
  u64 base;       // of the cut into parts
  int shift;      // of that; negative before there is one
  u32 n, begin, next;         // entries; those done, and the first cut part behind them
  u32 crowd, crowd_size;      // where the part that does not fit lies in `spare`
};

struct Corner {  // of what a block draws
  u32 all, view;   // the tile's number among those of all views
  int x, y;        // the tile's first pixel
  u32 quarter;     // of it; NOWHERE for all
};

struct TileRoom {
  union {
    u64 loose[CAPACITY];
    Staged staged[STAGE / WARP * SPAN];  // by 32, and one behind them that shows nowhere
    u8 picture[TILE * TILE * 3];
  };
  u32 indices[CAPACITY];  // of the group, in order: low words of keys
  Plan plan;
  Corner corner;
  View view;
  Cloud cloud[2];  // the view's own, and its tail
  u32 bucket[BUCKETS];
  u32 ends[PARTS];
  u8 rows[THREADS][TILE + 4];  // of the splat that a thread stages: a bit a thread of a row
  u32 reach[WARPS][STAGE];     // [warp][32 a word][lane]: splats that reach it, the first highest
  u32 open[WARPS];  // whether a warp has a pixel that can still change
  u32 sums[THREADS / WARP];
  u32 lowest[2], highest[2];  // depth bits, index
  u32 over;                   // first bucket by which more entries have come than fit a group
  u32 taken;
};

struct Bounds {  // of keys: depth bits, index
  u32 d0, d1, i0, i1;

  __device__ __forceinline__ void widen(u64 key) {
    u32 d = (u32)(key >> 32), i = (u32)key;
    d0 = min(d0, d), d1 = max(d1, d), i0 = min(i0, i), i1 = max(i1, i);
  }
};

struct Cut {  // how keys are cut into buckets; the same in all threads
  u64 base;
  int shift;
};

// Calls `of` with each entry that is this thread's, a few loads ahead.
template <class Of>
__device__ __forceinline__ void for_each(const u64 *list, u32 n, const Of &of) {
  u32 k = threadIdx.x;
  for (; k + (AHEAD - 1) * THREADS < n; k += AHEAD * THREADS) {
    u64 key[AHEAD];
#pragma unroll
    for (u32 a = 0; a < AHEAD; a++) key[a] = list[k + a * THREADS];
#pragma unroll
    for (u32 a = 0; a < AHEAD; a++) of(key[a]);
  }
  for (; k < n; k += THREADS) of(list[k]);
}

// Cuts all keys between the bounds of the block's threads into at most `buckets`.
__device__ __forceinline__ Cut find_cut(TileRoom &t, Bounds b, u32 buckets) {
  if (threadIdx.x < 2) t.lowest[threadIdx.x] = NOWHERE, t.highest[threadIdx.x] = 0;
  __syncthreads();
  b.d0 = __reduce_min_sync(FULL, b.d0), b.d1 = __reduce_max_sync(FULL, b.d1);
  b.i0 = __reduce_min_sync(FULL, b.i0), b.i1 = __reduce_max_sync(FULL, b.i1);
  if (lane_id() == 0) {
    atomicMin(&t.lowest[0], b.d0), atomicMax(&t.highest[0], b.d1);
    atomicMin(&t.lowest[1], b.i0), atomicMax(&t.highest[1], b.i1);
  }
  __syncthreads();
  u32 d0 = t.lowest[0], d1 = t.highest[0];
  u64 base = (u64)d0 << 32 | (d0 == d1 ? t.lowest[1] : 0u);
  u64 top = (u64)d1 << 32 | (d0 == d1 ? t.highest[1] : NOWHERE);
  int bits = 64 - __clzll((i64)(top - base));
  return {base, max(bits - (31 - __clz(buckets)), 0)};
}

// Turns counts into how many come before each; returns how many there are.
template <u32 SIZE>
__device__ __forceinline__ u32 sum_before(TileRoom &t, u32 *counts) {
  const u32 each = SIZE / THREADS;
  u32 count[each], mine = 0;
#pragma unroll
  for (u32 k = 0; k < each; k++) mine += count[k] = counts[threadIdx.x * each + k];
  u32 sum = mine;
#pragma unroll
  for (u32 d = 1; d < WARP; d <<= 1) {
    u32 other = __shfl_up_sync(FULL, sum, d);
    if (lane_id() >= d) sum += other;
  }
  if (lane_id() == WARP - 1) t.sums[threadIdx.x / WARP] = sum;
  __syncthreads();
  u32 before = sum - mine, total = 0;
#pragma unroll
  for (u32 w = 0; w < THREADS / WARP; w++) {
    if (w < threadIdx.x / WARP) before += t.sums[w];
    total += t.sums[w];
  }
#pragma unroll
  for (u32 k = 0; k < each; k++) {
    counts[threadIdx.x * each + k] = before;
    before += count[k];
  }
  __syncthreads();
  return total;
}

// Quarters of the tile with a pixel that can still change.
__device__ __forceinline__ u32 find_open(const TileRoom &t) {
  u32 open = 0;
#pragma unroll
  for (u32 w = 0; w < WARPS; w++)
    if (t.open[w]) open |= 1u << w;
  return open;
}

// Moves what a list holds of the `open` quarters to `spare`, part by part; `ends` then says where
// each part ends, and `n` how many there are.
__device__ __forceinline__ Cut part_list(TileRoom &t, const u64 *list, u64 *spare, u32 open, u32 &n) {
  for (u32 k = threadIdx.x; k < PARTS; k += THREADS) t.ends[k] = 0;
  Bounds bounds = {NOWHERE, 0, NOWHERE, 0};
  for_each(list, n, [&](u64 key) {
    if (key & open) bounds.widen(key);
  });
  __syncwarp();
  Cut cut = find_cut(t, bounds, PARTS);
  for_each(list, n, [&](u64 key) {
    if (key & open) atomicAdd(&t.ends[(key - cut.base) >> cut.shift], 1u);
  });
  __syncthreads();
  u32 total = sum_before<PARTS>(t, t.ends);
  for_each(list, n, [&](u64 key) {
    if (key & open) spare[atomicAdd(&t.ends[(key - cut.base) >> cut.shift], 1u)] = key;
  });
  __syncthreads();
  n = total;
  return cut;
}

// Past-the-last part of the group that begins with part `next`, at `begin`.
__device__ __forceinline__ u32 end_group(const TileRoom &t, u32 next, u32 begin) {
  u32 low = next, high = PARTS;
  while (low < high) {
    u32 middle = (low + high + 1) / 2;
    if (t.ends[middle - 1] - begin <= CAPACITY) low = middle;
    else high = middle - 1;
  }
  return low;
}

// Brings the lowest keys from `low` to `top` that fit a group into `loose`, in any order; returns
// how many. `low` moves behind them.
__device__ __forceinline__ u32 pick_group(TileRoom &t, const u64 *list, u32 n, u64 &low, u64 top) {
  int shift = max(64 - __clzll((i64)(top - low)) - (31 - __clz(BUCKETS)), 0);
  u32 end, size;
  while (true) {
    __syncthreads();
    for (u32 k = threadIdx.x; k < BUCKETS; k += THREADS) t.bucket[k] = 0;
    if (threadIdx.x == 0) t.over = BUCKETS, t.taken = 0;
    __syncthreads();
    for_each(list, n, [&](u64 key) {
      u64 b = (key - low) >> shift;
      if (key >= low && b < BUCKETS) atomicAdd(&t.bucket[b], 1u);
    });
    __syncthreads();
    u32 total = sum_before<BUCKETS>(t, t.bucket);
    for (u32 k = threadIdx.x; k < BUCKETS; k += THREADS)
      if ((k + 1 < BUCKETS ? t.bucket[k + 1] : total) > CAPACITY) atomicMin(&t.over, k);
    __syncthreads();
    end = t.over, size = end < BUCKETS ? t.bucket[end] : total;
    if (end || !shift) break;
    shift = max(shift - (31 - __clz(BUCKETS)), 0);  // the first bucket alone
  }
  if (!end) end = 1, size = CAPACITY;  // only if one entry were listed many times
  for_each(list, n, [&](u64 key) {
    if (key < low || (key - low) >> shift >= end) return;
    u32 at = atomicAdd(&t.taken, 1u);
    if (at < CAPACITY) t.loose[at] = key;
  });
  __syncthreads();
  low += (u64)end << shift;
  return size;
}

// Orders those of the `size` entries at `from` that reach `open` quarters into `indices`; returns how
// many.
__device__ __forceinline__ u32 sort_group(TileRoom &t, const u64 *from, u32 size, u32 open) {
  u64 held[HOLD];
  u32 place[HOLD];  // bucket, and place in it
  Bounds bounds = {NOWHERE, 0, NOWHERE, 0};
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    u32 k = threadIdx.x + j * THREADS;
    held[j] = k < size ? from[k] : 0;  // zeros reach nothing
  }
#pragma unroll
  for (u32 j = 0; j < HOLD; j++)
    if (held[j] & open) bounds.widen(held[j]);
  for (u32 k = threadIdx.x; k < BUCKETS; k += THREADS) t.bucket[k] = 0;
  __syncwarp();
  Cut cut = find_cut(t, bounds, BUCKETS);
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    if (!(held[j] & open)) continue;
    u32 b = (u32)((held[j] - cut.base) >> cut.shift);
    place[j] = atomicAdd(&t.bucket[b], 1u) << 16 | b;
  }
  __syncthreads();
  u32 total = sum_before<BUCKETS>(t, t.bucket);
#pragma unroll
  for (u32 j = 0; j < HOLD; j++)
    if (held[j] & open) t.loose[t.bucket[place[j] & 0xffff] + (place[j] >> 16)] = held[j];
  __syncthreads();
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    if (!(held[j] & open)) continue;
    u32 b = place[j] & 0xffff, first = t.bucket[b], at = first + (place[j] >> 16), rank = first;
    u32 last = b + 1 < BUCKETS ? t.bucket[b + 1] : total;
    for (u32 k = first; k < last; k++) {
      u64 other = t.loose[k];
      rank += other < held[j] || (other == held[j] && k < at);
    }
    t.indices[rank] = (u32)held[j];
  }
  __syncthreads();
  return total;
}

// Brings the next group of the list, in order, into `indices`; returns how many, 0 behind the last.
__device__ __forceinline__ u32 bring_group(TileRoom &t) {
  Plan p = t.plan;
  u32 size, open = SPLIT ? find_open(t) : ALL_QUARTERS;  // known of keys only where tiles are split
  do {
    const u64 *from = p.list;
    size = p.n;
    if (p.n <= CAPACITY && p.shift < 0) {
      if (p.begin) return 0;
      p.begin = p.n;
    } else {
      if (p.shift < 0) {
        Cut cut = part_list(t, p.list, p.spare, open, p.n);
        p.base = cut.base, p.shift = cut.shift;
      }
      if (p.low > p.high) {
        if (p.begin == p.n) return 0;
        u32 end = end_group(t, p.next, p.begin);
        if (end == p.next) {
          p.low = p.base + ((u64)p.next << p.shift), p.high = p.low + ((1ull << p.shift) - 1);
          p.crowd = p.begin, p.crowd_size = t.ends[p.next] - p.begin;
          p.begin = t.ends[p.next++];
        } else {
          from = p.spare + p.begin, size = t.ends[end - 1] - p.begin;
          p.begin += size, p.next = end;
        }
      }
      if (p.low <= p.high)
        size = pick_group(t, p.spare + p.crowd, p.crowd_size, p.low, p.high), from = t.loose;
    }
    if (size) size = sort_group(t, from, size, open);
  } while (!size);
  if (threadIdx.x == 0) t.plan = p;  // to be seen behind the next barrier
  return size;
}
