// The walk through one tile's list, front to back: what `paint_tiles` and `mark_tiles` share.
//
// A list that fits a group (CAPACITY) is sorted at once. A longer one is first parted by key into
// PARTS, by one pass that counts and one that moves its entries to the spare list; a run of parts
// that fits is the next group. So each entry is moved once, however long the list is, and what lies
// behind the last open pixel is never sorted. A part that does not fit (one floor seen from above:
// all at one depth) gives its lowest entries a group at a time. A sorted group is projected again
// STAGE splats at a time, with a bit for each region of the tile that a splat reaches; then each
// team of lanes walks the list of its own region.

#define THREADS (TILE * TILE / PIXELS)
#define TEAM (REGION_WIDTH * REGION_HEIGHT / PIXELS)
#define REGION_ROWS (TILE / REGION_HEIGHT)
#define REGION_COLUMNS (TILE / REGION_WIDTH)
#define REGIONS (REGION_ROWS * REGION_COLUMNS)
#define LANES_X (REGION_WIDTH / PIXELS)  // lanes side by side in a region
#define PARTS (2 * CAPACITY)
#define HOLD (CAPACITY / THREADS)  // entries of a group that a thread holds
#define AHEAD 4                    // loads of a list under way
#define WORDS (STAGE / WARP)
#define RECORD 48  // bytes of a staged splat; lists hold multiples of it
#define LIST_ROW (STAGE + 8)
#define LOG2_ALPHA_MIN (LOG_ALPHA_MIN * LOG2_E)
#define SQRT_LOG2_E 1.2011224087864498f

struct Staged {
  float4 a;  // qx, qy, c, k: q = qx x + qy y + c
  float4 b;  // s, log2 opacity, red, green: exponent = log2 o - (k y + s)^2 - q^2
  float2 c;  // blue, depth
  float2 spare;  // 16-byte loads need the room, and lists need no other arithmetic
};

struct TileRoom {
  union {
    u64 loose[CAPACITY];
    Staged staged[STAGE + 1];  // the last shows nowhere
    u8 picture[TILE * TILE * 3];
  };
  u64 keys[CAPACITY];  // of the group, in order
  View view;
  Cloud cloud[2];  // the view's own, and its tail
  u32 bucket[BUCKETS];
  u32 ends[PARTS];
  u32 words[REGIONS][WORDS];
  u32 sums[THREADS / WARP];
  u32 lowest[2], highest[2];  // depth bits, index
  u32 over;                   // first bucket by which more entries have come than fit a group
  u32 taken;
  alignas(8) u16 lists[REGIONS][LIST_ROW];
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

// Moves a list to `spare`, part by part; `ends` then says where each part ends.
__device__ __forceinline__ Cut part_list(TileRoom &t, const u64 *list, u64 *spare, u32 n) {
  for (u32 k = threadIdx.x; k < PARTS; k += THREADS) t.ends[k] = 0;
  Bounds bounds = {NOWHERE, 0, NOWHERE, 0};
  for_each(list, n, [&](u64 key) { bounds.widen(key); });
  __syncwarp();
  Cut cut = find_cut(t, bounds, PARTS);
  for_each(list, n, [&](u64 key) { atomicAdd(&t.ends[(key - cut.base) >> cut.shift], 1u); });
  __syncthreads();
  sum_before<PARTS>(t, t.ends);
  for_each(list, n, [&](u64 key) {
    spare[atomicAdd(&t.ends[(key - cut.base) >> cut.shift], 1u)] = key;
  });
  __syncthreads();
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

// Orders the `size` entries at `from` into `keys`.
__device__ __forceinline__ void sort_group(TileRoom &t, const u64 *from, u32 size) {
  u64 held[HOLD];
  u32 place[HOLD];  // bucket, and place in it
  Bounds bounds = {NOWHERE, 0, NOWHERE, 0};
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    u32 k = threadIdx.x + j * THREADS;
    held[j] = k < size ? from[k] : 0;
  }
#pragma unroll
  for (u32 j = 0; j < HOLD; j++)
    if (threadIdx.x + j * THREADS < size) bounds.widen(held[j]);
  for (u32 k = threadIdx.x; k < BUCKETS; k += THREADS) t.bucket[k] = 0;
  __syncwarp();
  Cut cut = find_cut(t, bounds, BUCKETS);
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    if (threadIdx.x + j * THREADS >= size) break;
    u32 b = (u32)((held[j] - cut.base) >> cut.shift);
    place[j] = atomicAdd(&t.bucket[b], 1u) << 16 | b;
  }
  __syncthreads();
  sum_before<BUCKETS>(t, t.bucket);
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    if (threadIdx.x + j * THREADS >= size) break;
    t.loose[t.bucket[place[j] & 0xffff] + (place[j] >> 16)] = held[j];
  }
  __syncthreads();
#pragma unroll
  for (u32 j = 0; j < HOLD; j++) {
    if (threadIdx.x + j * THREADS >= size) break;
    u32 b = place[j] & 0xffff, first = t.bucket[b], at = first + (place[j] >> 16), rank = first;
    u32 last = b + 1 < BUCKETS ? t.bucket[b + 1] : size;
    for (u32 k = first; k < last; k++) {
      u64 other = t.loose[k];
      rank += other < held[j] || (other == held[j] && k < at);
    }
    t.keys[rank] = held[j];
  }
  __syncthreads();
}

// Regions that a footprint reaches, a bit each, column by column. x, y: of its centre, from the
// tile's first pixel centre.
__device__ __forceinline__ u32 find_regions(const Footprint &f, float x, float y) {
  Ellipse e = outline(f);
  u32 mask = 0;
#pragma unroll
  for (int column = 0; column < REGION_COLUMNS; column++) {
    float dx0 = (float)(column * REGION_WIDTH) - x, dx1 = dx0 + (float)(REGION_WIDTH - 1);
    float2 cut = cut_rows(e, dx0, dx1);
    float y0 = fmaxf(ceilf(y + cut.x - EDGE), 0.f);
    float y1 = fminf(floorf(y + cut.y + EDGE) + 1.f, (float)TILE);
    if (y0 < y1 && dx0 <= f.rx + EDGE && dx1 >= -f.rx - EDGE) {
      u32 r0 = (u32)y0 / REGION_HEIGHT, r1 = ((u32)y1 + REGION_HEIGHT - 1) / REGION_HEIGHT;
      mask |= ((1u << r1) - (1u << r0)) << (column * REGION_ROWS);
    }
  }
  return mask;
}

// Stages a splat at `at`; returns its regions. left, top: the tile's first pixel centre.
template <bool COLOUR>
__device__ __forceinline__ u32 stage_splat(TileRoom &t, u32 at, const Splat &s, const Cloud &cloud,
                                           u32 slot, u32 flags, float left, float top) {
  Footprint f;
  const View w = load_view(t.view);
  if (!project(s, w, flags, f)) return 0;
  float x = f.u - left, y = f.v - top;
  float qx = f.qx * SQRT_LOG2_E, qy = f.qy * SQRT_LOG2_E, k = root(f.qk * LOG2_E);
  Staged &to = t.staged[at];
  to.a = make_float4(qx, qy, -fmaf(qx, x, qy * y), k);
  float3 colour = make_float3(0.f, 0.f, 0.f);
  u32 mask = find_regions(f, x, y);
  if (COLOUR) colour = find_colour(cloud, s, slot, w);
  to.b = make_float4(-k * y, f.log_o * LOG2_E, colour.x, colour.y);
  to.c = make_float2(colour.z, f.z);
  return mask;
}

// Where the splat of an entry lies in its cloud; NOWHERE if it is not there.
__device__ __forceinline__ u32 find_slot(const TileRoom &t, u64 key) {
  const Cloud &cloud = t.cloud[(u32)key >> 31];
  u32 index = (u32)key & ~TAIL, slot = cloud.places ? __ldg(cloud.places + index) : index;
  return slot < cloud.rows ? slot : NOWHERE;
}

// Stages the entry of a key at `at`; returns its regions.
template <bool COLOUR>
__device__ __forceinline__ u32 stage_entry(TileRoom &t, u32 at, u64 key, u32 flags, float left,
                                           float top) {
  const Cloud &cloud = t.cloud[(u32)key >> 31];
  u32 slot = find_slot(t, key);
  if (slot == NOWHERE) return 0;
  Splat s = load_splat(cloud.splats + (u64)slot * 4);
  return stage_splat<COLOUR>(t, at, s, cloud, slot, flags, left, top);
}

#if EARLY
struct Fetched {  // of one entry
  Splat splat;
  u32 cloud, slot;
};

// The splat of entry `at` of a group of `size`.
__device__ __forceinline__ Fetched fetch_splat(const TileRoom &t, u32 at, u32 size) {
  Fetched f;
  f.slot = NOWHERE;
  if (at >= size) return f;
  f.cloud = (u32)t.keys[at] >> 31, f.slot = find_slot(t, t.keys[at]);
  if (f.slot != NOWHERE) f.splat = load_splat(t.cloud[f.cloud].splats + (u64)f.slot * 4);
  return f;
}
#endif

// The list of a team's region among the staged splats, as offsets in bytes, padded to the longest
// of the warp's. Returns its length.
__device__ __forceinline__ u32 list_region(TileRoom &t, u32 region) {
  u32 lane = threadIdx.x % TEAM, n = 0;
#pragma unroll
  for (u32 w = 0; w < WORDS; w++) {
    u32 word = t.words[region][w];
    for (u32 bit = lane; bit < WARP; bit += TEAM)
      if (word >> bit & 1)
        t.lists[region][n + __popc(word & ((1u << bit) - 1))] =
            (u16)((w * WARP + bit) * RECORD);
    n += __popc(word);
  }
  u32 longest = (__reduce_max_sync(FULL, n) + 3) & ~3u;
  for (u32 k = n + lane; k < longest; k += TEAM) t.lists[region][k] = STAGE * RECORD;
  __syncwarp();
  return longest;
}

// Walks the list of this block's tile. A Painter has
//   static const bool COLOUR         whether colours are wanted
//   void pixel(int i, float alpha, float red, float green, float blue, float depth)
//                                    alpha is 0 where it would be under 1/255
//   void splat(room, u32 first, u32 at)   after the pixels of a lane; the splat's key is
//                                    room.keys[first + at / RECORD]
//   bool open() const                whether a pixel of the lane can still change
template <class Painter>
__device__ __forceinline__ void walk_tile(TileRoom &t, Painter &painter, const View *__restrict__ views,
                                          const Cloud *__restrict__ clouds,
                                          const u64 *__restrict__ starts,
                                          const u32 *__restrict__ counts, u64 *entries,
                                          u64 capacity, u32 room, u32 tile, u32 view, int x_px, int y_px,
                                          u32 flags) {
  u64 start = room ? (u64)tile * room : starts[tile];
  const u64 *list = entries + start;
  u64 *spare = entries + capacity + start;
  u32 n = room ? counts[tile] : (u32)(starts[tile + 1] - start);
  if (!n) return;
  if (threadIdx.x < WARP) {
    const u32 words = sizeof(Cloud) / 4;
    u32 k = threadIdx.x, cloud = k < words ? views[view].cloud : views[view].tail;
    ((u32 *)&t.view)[k] = ((const u32 *)(views + view))[k];
    ((u32 *)t.cloud)[k] = cloud == NOWHERE ? 0 : ((const u32 *)(clouds + cloud))[k % words];
  }
  u32 region = threadIdx.x / TEAM, lane = threadIdx.x % TEAM;
  float x = (float)(region / REGION_ROWS * REGION_WIDTH + lane % LANES_X);
  float y = (float)(region % REGION_ROWS * REGION_HEIGHT + lane / LANES_X);
  float left = (float)x_px + 0.5f, top = (float)y_px + 0.5f;
  bool open = __any_sync(FULL, painter.open());  // of the warp
  bool parted = n > CAPACITY;
  const u64 *from = list;            // the next group
  u32 size = n, next = 0, begin = 0;  // of it; the first part behind it, and where that begins
  const u64 *crowd = list;           // a part that does not fit: its entries, how many, which of
  u32 crowd_size = 0;                // them are still to come
  u64 low = 1, high = 0;
  Cut cut = {0, 0};
  if (parted) cut = part_list(t, list, spare, n);
  while (true) {
    if (parted) {
      if (low > high) {
        if (begin == n) return;
        u32 end = end_group(t, next, begin);
        if (end == next) {
          low = cut.base + ((u64)next << cut.shift), high = low + ((1ull << cut.shift) - 1);
          crowd = spare + begin, crowd_size = t.ends[next] - begin;
          begin = t.ends[next++];
        } else {
          from = spare + begin, size = t.ends[end - 1] - begin;
          begin += size, next = end;
        }
      }
      if (low <= high) size = pick_group(t, crowd, crowd_size, low, high), from = t.loose;
      if (!size) continue;
    }
    sort_group(t, from, size);
#if EARLY
    Fetched next_splat = fetch_splat(t, threadIdx.x, size);
#endif
    for (u32 first = 0; first < size; first += STAGE) {
      for (u32 k = threadIdx.x; k < STAGE; k += THREADS) {
        u32 mask = 0;
#if EARLY
        const Fetched &one = next_splat;
        if (one.slot != NOWHERE)
          mask = stage_splat<Painter::COLOUR>(t, k, one.splat, t.cloud[one.cloud], one.slot, flags,
                                              left, top);
#else
        if (first + k < size)
          mask = stage_entry<Painter::COLOUR>(t, k, t.keys[first + k], flags, left, top);
#endif
        __syncwarp();
        u32 mine = 0;
#pragma unroll
        for (u32 r = 0; r < REGIONS; r++) {
          u32 word = __ballot_sync(FULL, mask >> r & 1);
          if (lane_id() == r) mine = word;
        }
        if (lane_id() < REGIONS) t.words[lane_id()][k / WARP] = mine;
      }
      if (threadIdx.x == 0) {
        t.staged[STAGE].a = make_float4(0.f, 0.f, 0.f, 0.f);
        t.staged[STAGE].b = make_float4(0.f, -1e30f, 0.f, 0.f);
        t.staged[STAGE].c = make_float2(0.f, 0.f);
      }
      __syncthreads();
#if EARLY  // under way while this stage is blended
      next_splat = fetch_splat(t, first + STAGE + threadIdx.x, size);
#endif
      if (open) {
        u32 length = list_region(t, region);
        const u16 *mine = t.lists[region];
        for (u32 k = 0; k < length; k += 4) {
          ushort4 four = *(const ushort4 *)(mine + k);
#pragma unroll
          for (int j = 0; j < 4; j++) {
            u32 at = j == 0 ? four.x : j == 1 ? four.y : j == 2 ? four.z : four.w;
            const Staged &one = *(const Staged *)((const u8 *)t.staged + at);
            float4 a = one.a, b = one.b;
            float2 c = one.c;
            float across = fmaf(a.y, y, a.z), s = fmaf(a.w, y, b.x), most = fmaf(-s, s, b.y);
#pragma unroll
            for (int i = 0; i < PIXELS; i++) {
              float q = fmaf(a.x, x + (float)(i * LANES_X), across);
              float p = fmaf(-q, q, most), alpha = fminf(fast_exp2(p), ALPHA_CAP);
              painter.pixel(i, p >= LOG2_ALPHA_MIN ? alpha : 0.f, b.z, b.w, c.x, c.y);
            }
            painter.splat(t, first, at);
          }
          if ((k & 4) && !__any_sync(FULL, painter.open())) break;
        }
        open = __any_sync(FULL, painter.open());
      }
      if (!__syncthreads_or(open)) return;
    }
    if (!parted) return;
  }
}
