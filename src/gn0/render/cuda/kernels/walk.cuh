// The walk through one tile's list, front to back: what `paint_tiles` and `mark_tiles` share.
//
// A list is cut into buckets by key; the longest run of buckets with at most CAPACITY entries is
// the next group. It is brought into shared memory bucket by bucket and ranked inside each bucket,
// which orders it completely; then it is projected again STAGE splats at a time, with a bit for
// each region of the tile that a splat reaches; then each team of lanes walks the list of its own
// region. What lies behind the last open pixel is never sorted. A bucket with more than CROWDED
// entries (one floor seen from above: all at one depth) is cut into buckets of its own first.

#define THREADS (256 / PIXELS)
#define TEAM (REGION_WIDTH * REGION_HEIGHT / PIXELS)
#define REGION_ROWS (TILE / REGION_HEIGHT)
#define REGION_COLUMNS (TILE / REGION_WIDTH)
#define REGIONS (REGION_ROWS * REGION_COLUMNS)
#define LANES_X (REGION_WIDTH / PIXELS)  // lanes side by side in a region
#define PER (BUCKETS / THREADS)          // buckets a thread adds up
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
  u32 bucket[BUCKETS + 1];
  u32 words[REGIONS][WORDS];
  u32 sums[THREADS / WARP];
  u32 lowest[2], highest[2];  // depth bits, index
  u32 crowded;                // first bucket with more than CROWDED entries
  alignas(8) u16 lists[REGIONS][LIST_ROW];
};

struct Cut {  // how a part of the list was cut; the same in all threads
  u64 base, top;
  int shift;
  u32 total;
};

// Cuts the entries between low and high into buckets; false if there are none.
__device__ __forceinline__ bool cut_list(TileRoom &t, const u64 *__restrict__ list, u32 n, u64 low,
                                         u64 high, Cut &cut) {
  __syncthreads();
  for (u32 k = threadIdx.x; k <= BUCKETS; k += THREADS) t.bucket[k] = 0;
  if (threadIdx.x < 2) t.lowest[threadIdx.x] = NOWHERE, t.highest[threadIdx.x] = 0;
  if (threadIdx.x == 0) t.crowded = BUCKETS;
  __syncthreads();
  u32 d0 = NOWHERE, d1 = 0, i0 = NOWHERE, i1 = 0;
  for (u32 k = threadIdx.x; k < n; k += THREADS) {
    u64 key = list[k];
    if (key < low || key > high) continue;
    u32 d = (u32)(key >> 32), i = (u32)key;
    d0 = min(d0, d), d1 = max(d1, d), i0 = min(i0, i), i1 = max(i1, i);
  }
  __syncwarp();
  d0 = __reduce_min_sync(FULL, d0), d1 = __reduce_max_sync(FULL, d1);
  i0 = __reduce_min_sync(FULL, i0), i1 = __reduce_max_sync(FULL, i1);
  if (lane_id() == 0) {
    atomicMin(&t.lowest[0], d0), atomicMax(&t.highest[0], d1);
    atomicMin(&t.lowest[1], i0), atomicMax(&t.highest[1], i1);
  }
  __syncthreads();
  d0 = t.lowest[0], d1 = t.highest[0], i0 = t.lowest[1], i1 = t.highest[1];
  if (d0 > d1) return false;
  cut.base = max((u64)d0 << 32 | (d0 == d1 ? i0 : 0u), low);
  cut.top = min((u64)d1 << 32 | (d0 == d1 ? i1 : NOWHERE), high);
  int bits = 64 - __clzll((i64)(cut.top - cut.base));
  cut.shift = max(bits - (31 - __clz(BUCKETS)), 0);
  for (u32 k = threadIdx.x; k < n; k += THREADS) {
    u64 key = list[k];
    if (key >= cut.base && key <= cut.top) atomicAdd(&t.bucket[(key - cut.base) >> cut.shift], 1u);
  }
  __syncthreads();
  u32 count[PER], mine = 0;
#pragma unroll
  for (u32 k = 0; k < PER; k++) {
    u32 b = threadIdx.x * PER + k;
    count[k] = t.bucket[b];
    if (count[k] > CROWDED && cut.shift) atomicMin(&t.crowded, b);
    mine += count[k];
  }
  u32 sum = mine;
  for (u32 d = 1; d < WARP; d <<= 1) {
    u32 other = __shfl_up_sync(FULL, sum, d);
    if (lane_id() >= d) sum += other;
  }
  if (lane_id() == WARP - 1) t.sums[threadIdx.x / WARP] = sum;
  __syncthreads();
  u32 before = sum - mine;
  cut.total = 0;
  for (u32 w = 0; w < THREADS / WARP; w++) {
    if (w < threadIdx.x / WARP) before += t.sums[w];
    cut.total += t.sums[w];
  }
#pragma unroll
  for (u32 k = 0; k < PER; k++) {
    t.bucket[threadIdx.x * PER + k] = before;
    before += count[k];
  }
  if (threadIdx.x == 0) t.bucket[BUCKETS] = cut.total;
  __syncthreads();
  return true;
}

// Past-the-last bucket of the group that begins with `next`.
__device__ __forceinline__ u32 end_group(const TileRoom &t, u32 next) {
  u32 begin = t.bucket[next], low = next, high = min(t.crowded, (u32)BUCKETS);
  while (low < high) {
    u32 middle = (low + high + 1) / 2;
    if (t.bucket[middle] - begin <= CAPACITY) low = middle;
    else high = middle - 1;
  }
  return low;
}

// Brings buckets next to end into `keys`, in order; returns how many entries they hold. Their
// bucket words then hold ends instead of starts.
__device__ __forceinline__ u32 sort_group(TileRoom &t, const u64 *__restrict__ list, u32 n,
                                          const Cut &cut, u32 next, u32 end) {
  u32 begin = t.bucket[next], size = min(t.bucket[end] - begin, (u32)CAPACITY);
  __syncthreads();
  for (u32 k = threadIdx.x; k < n; k += THREADS) {
    u64 key = list[k];
    if (key < cut.base || key > cut.top) continue;
    u32 b = (u32)((key - cut.base) >> cut.shift);
    if (b < next || b >= end) continue;
    u32 at = atomicAdd(&t.bucket[b], 1u) - begin;
    if (at < CAPACITY) t.loose[at] = key;
  }
  __syncthreads();
  for (u32 k = threadIdx.x; k < size; k += THREADS) {
    u64 key = t.loose[k];
    u32 b = (u32)((key - cut.base) >> cut.shift);
    u32 first = b > next ? t.bucket[b - 1] - begin : 0, last = min(t.bucket[b] - begin, size);
    u32 rank = first;
    for (u32 j = first; j < last; j++) {
      u64 other = t.loose[j];
      rank += other < key || (other == key && j < k);
    }
    t.keys[rank] = key;
  }
  __syncthreads();
  return size;
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

// Stages one entry at `at`; returns its regions. left, top: the tile's first pixel centre.
template <bool COLOUR>
__device__ __forceinline__ u32 stage_splat(TileRoom &t, u32 at, u64 key, u32 flags, float left,
                                           float top) {
  u32 index = (u32)key;
  const Cloud &cloud = t.cloud[index >> 31];
  index &= ~TAIL;
  u32 slot = cloud.places ? __ldg(cloud.places + index) : index;
  if (slot >= cloud.rows) return 0;
  const float4 *from = cloud.splats + (u64)slot * 4;
  Splat s = load_splat(from);
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
                                          const u64 *__restrict__ entries, u32 view, int x_px,
                                          int y_px, u32 flags) {
  const u64 *list = entries + starts[blockIdx.x];
  u32 n = (u32)(starts[blockIdx.x + 1] - starts[blockIdx.x]);
  if (!n) return;
  if (threadIdx.x < sizeof(View) / 4) ((u32 *)&t.view)[threadIdx.x] = ((const u32 *)(views + view))[threadIdx.x];
  if (threadIdx.x >= WARP && threadIdx.x < 2 * WARP) {
    u32 k = threadIdx.x - WARP, words = sizeof(Cloud) / 4;
    u32 cloud = k < words ? views[view].cloud : views[view].tail;
    ((u32 *)t.cloud)[k] = cloud == NOWHERE ? 0 : ((const u32 *)(clouds + cloud))[k % words];
  }
  u32 region = threadIdx.x / TEAM, lane = threadIdx.x % TEAM;
  float x = (float)(region / REGION_ROWS * REGION_WIDTH + lane % LANES_X);
  float y = (float)(region % REGION_ROWS * REGION_HEIGHT + lane / LANES_X);
  float left = (float)x_px + 0.5f, top = (float)y_px + 0.5f;
  bool open = __any_sync(FULL, painter.open());  // of the warp
  u64 low = 0, high = ~0ull;
  while (true) {
    Cut cut;
    u32 next = 0;
    bool any = cut_list(t, list, n, low, high, cut);
    while (any && next < BUCKETS && t.bucket[next] < cut.total) {
      u32 end = end_group(t, next);
      if (end == next) {
        if (next == t.crowded) break;
        end = next + 1;  // only if one entry were listed many times
      }
      u32 size = sort_group(t, list, n, cut, next, end);
      next = end;
      for (u32 first = 0; first < size; first += STAGE) {
        for (u32 k = threadIdx.x; k < STAGE; k += THREADS) {
          u32 mask = 0;
          if (first + k < size)
            mask = stage_splat<Painter::COLOUR>(t, k, t.keys[first + k], flags, left, top);
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
    }
    if (any && next < BUCKETS && t.bucket[next] < cut.total) {  // a crowded bucket: only it
      low = cut.base + ((u64)next << cut.shift);
      high = min(low + ((1ull << cut.shift) - 1), cut.top);
    } else if (high == ~0ull) {
      return;
    } else {  // all that is behind
      low = high + 1, high = ~0ull;
    }
  }
}
