// The walk through one tile's list, front to back: what `paint_tiles` and `mark_tiles` share.
//
// A sorted group is projected again STAGE splats at a time; then each thread blends those that reach
// its own pixels.

// The same value, from where the compiler cannot find it anew each turn of a loop.
__device__ __forceinline__ float hold(float value) { return __shfl_sync(FULL, value, lane_id()); }

// The instance that a key's low word, or a slot with TAIL, tells of.
__device__ __forceinline__ u32 find_part(const TileRoom &t, u32 word) {
  return t.view.spare[WHOSE] + (word >> PART_SHIFT & 31u);
}

// The cloud of a slot of a group in which something moves.
__device__ __forceinline__ const Cloud &find_cloud(const TileRoom &t, u32 slot, const Moving &moving) {
  return slot & TAIL ? moving.parts[find_part(t, slot)].cloud : t.cloud[slot & TAIL_SLOT ? 1 : 0];
}

// Where the splat that is number `at` of a group of `size` lies in its cloud, with TAIL for one of a
// tail; NOWHERE if there is none. Where there are instances and something MOVES in the group, with what
// tells whose it is: TAIL and the number of an instance, or TAIL_SLOT.
template <bool MOVES>
__device__ __forceinline__ u32 find_slot(const TileRoom &t, u32 at, u32 size, const Moving &moving) {
  if (at >= size) return NOWHERE;
  if (MOVES) {
    u32 word = t.indices[at], index = word >> QUARTER_BITS, whose = 0;
    const Cloud *cloud = t.cloud;
    if (word & TAIL) {
      whose = word & ~((1u << PART_SHIFT) - 1), index &= PART_INDEX;
      cloud = &moving.parts[find_part(t, word)].cloud;
    } else if (index >= TAIL_INDEX && t.view.tail != NOWHERE) {
      whose = TAIL_SLOT, index -= TAIL_INDEX, cloud = t.cloud + 1;
    }
    u32 slot = cloud->places ? __ldg(cloud->places + index) : index;
    return slot < cloud->rows ? slot | whose : NOWHERE;
  }
  u32 word = t.indices[at], tail = word & TAIL, index = (word & ~TAIL) >> QUARTER_BITS;
  const Cloud &cloud = t.cloud[word >> 31];
  u32 slot = cloud.places ? __ldg(cloud.places + index) : index;
  return slot < cloud.rows ? slot | tail : NOWHERE;
}

// Whether the group may hold what moves. Most do not, and are walked as if none could.
__device__ __forceinline__ bool may_move(const TileRoom &t) {
  return INSTANCES && (t.highest[1] & TAIL || t.view.tail != NOWHERE);
}

// Stages what lies in `slot` as number `k`, and marks its reach.
template <bool COLOUR, bool MOVES>
__device__ __forceinline__ void stage_splat(TileRoom &t, u32 k, u32 slot, u32 flags,
                                            const Moving &moving) {
  const u32 whose = slot;
  const Cloud &cloud = MOVES ? find_cloud(t, whose, moving) : t.cloud[slot >> 31];
  slot &= !MOVES ? ~TAIL : whose & TAIL ? PART_INDEX : TAIL_SLOT - 1;
  const Splat s = MOVES && cloud.degree == PACKED ? load_posed(cloud, slot)
                                                  : load_splat(cloud.splats + (u64)slot * 4);
  Footprint f;
  const View w = load_view(MOVES && whose & TAIL ? moving.views[find_part(t, whose)] : t.view);
  if (!project(s, w, flags, f)) return;
  float x = f.u - ((float)t.corner.x + 0.5f), y = f.v - ((float)t.corner.y + 0.5f);
  float qx = f.qx * SQRT_LOG2_E, qy = f.qy * SQRT_LOG2_E, down = root(f.qk * LOG2_E);
  Staged one;
  one.a = make_float4(qx, qy, -fmaf(qx, x, qy * y), down);
  float3 colour = make_float3(0.f, 0.f, 0.f);
  // the cloud is found again: kept since above, it would be spilled
  if (COLOUR) colour = find_colour(MOVES ? find_cloud(t, whose, moving) : cloud, s, slot, w);
  one.b = make_float4(-down * y, f.log_o * LOG2_E, colour.x, colour.y);
  one.c = make_float2(colour.z, f.z);
  Staged &to = t.staged[k / WARP * SPAN + k % WARP];
  to.a = one.a, to.b = one.b, to.c = one.c;
  find_reach(t, one, y);
}

// Blends the `count` splats of a stage; the first is number `first` of its group.
template <class Painter>
__device__ __forceinline__ void blend_stage(TileRoom &t, Painter &painter, u32 first, u32 count,
                                            float x, float x1, float y) {
  const u32 *words = t.reach[threadIdx.x / WARP] + lane_id();  // of this thread's splats
  const u8 *of = (const u8 *)(t.staged + WARP - 1);            // the last that a word tells of
  u32 left = painter.open() ? (count - 1) / WARP : 0;          // words to come
  u32 word = painter.open() ? *words : 0;
  do {
#pragma unroll
    for (int turn = 0; turn < TURNS; turn++) {
      if (!word && left) words += WARP, of += SPAN * sizeof(Staged), left--, word = *words;
      int bit = 31 - __clz((int)word);  // -1: the one behind that shows nowhere
      word &= bits_below((u32)bit);
      const Staged &one = *(const Staged *)(of - bit * (int)sizeof(Staged));
      float4 a = one.a, b = one.b;
      float2 c = one.c;
      float across = fmaf(a.y, y, a.z), s = fmaf(a.w, y, b.x), most = fmaf(-s, s, b.y);
#pragma unroll
      for (int i = 0; i < PIXELS; i++) {
        float q = fmaf(a.x, i ? x1 : x, across);
        float p = fmaf(-q, q, most), alpha = fminf(fast_exp2(p), ALPHA_CAP);
        painter.pixel(i, p >= LOG2_ALPHA_MIN ? alpha : 0.f, b.z, b.w, c.x, c.y);
      }
      u32 place = (u32)(&one - t.staged);
      painter.splat(t, first + place - place / SPAN);
    }
  } while (__any_sync(FULL, (word || left) && painter.open()));
}

#define NO_PIXEL (1 << 30)  // behind every picture: of a thread that blends none

// Finds what this block draws. Blocks are tiles in the order given; of the first `split`, four blocks
// each have a quarter, or all where the list is short, and then three have nothing to do.
__device__ __forceinline__ bool find_corner(Corner &c, const u32 *__restrict__ order,
                                            const u32 *__restrict__ counts, u32 split, u32 tiles_x,
                                            u32 tiles) {
  bool first = blockIdx.x < 4 * split;
  u32 quarter = first ? blockIdx.x % 4 : 0;
  c.all = order[first ? blockIdx.x / 4 : blockIdx.x - 3 * split];
  bool apart = first && counts[c.all] > 2 * CAPACITY;
  if (quarter && !apart) return false;
  u32 tile = c.all % tiles;
  c.view = c.all / tiles, c.quarter = apart ? quarter : NOWHERE;
  c.x = (int)(tile % tiles_x * TILE), c.y = (int)(tile / tiles_x * TILE);
  return true;
}

// The picture's pixel that is this thread's first.
__device__ __forceinline__ int2 find_first(const Corner &c) {
  uint2 pixel = find_pixel();
  bool none = threadIdx.x >= BLENDERS || (c.quarter != NOWHERE && threadIdx.x / WARP != c.quarter);
  return none ? make_int2(NO_PIXEL, NO_PIXEL) : make_int2(c.x + (int)pixel.x, c.y + (int)pixel.y);
}

// Notes whether this warp has a pixel that can still change, to be seen behind the next barrier.
__device__ __forceinline__ void tell_open(TileRoom &t, bool open) {
  if (!SPLIT) return;
  bool any = __any_sync(FULL, open);
  if (threadIdx.x < BLENDERS && lane_id() == 0) t.open[threadIdx.x / WARP] = any;
}

// Stages and blends the `size` splats of a group; returns whether no pixel can still change.
template <bool MOVES, class Painter>
__device__ __forceinline__ bool walk_group(TileRoom &t, Painter &painter, u32 size, u32 flags,
                                           const Moving &moving, float x, float x1, float y) {
  u32 slot = find_slot<MOVES>(t, threadIdx.x, size, moving);
  for (u32 first = 0; first < size; first += STAGE) {
    for (u32 k = threadIdx.x; k < STAGE; k += THREADS) {
      if (first + k / WARP * WARP >= size) break;  // none for this warp
      if (k >= THREADS) slot = find_slot<MOVES>(t, first + k, size, moving);
#pragma unroll
      for (int w = 0; w < WARPS; w++) ((u32 *)t.rows[threadIdx.x])[w] = 0;
      if (slot != NOWHERE) stage_splat<Painter::COLOUR, MOVES>(t, k, slot, flags, moving);
      if (lane_id() == WARP - 1) {
        Staged &none = t.staged[k / WARP * SPAN + WARP];
        none.a = make_float4(0.f, 0.f, 0.f, 0.f), none.b = make_float4(0.f, -1e30f, 0.f, 0.f);
        none.c = make_float2(0.f, 0.f);
      }
      __syncwarp();
      tell_reach(t, k);
      if (Painter::COLOUR && MOVES && slot != NOWHERE && slot & TAIL)
        light_splat(t.staged[k / WARP * SPAN + k % WARP], moving.parts[find_part(t, slot)],
                    slot & PART_INDEX);
    }
    __syncthreads();
    if (__any_sync(FULL, painter.open()))
      blend_stage(t, painter, first, min(size - first, (u32)STAGE), x, x1, y);
    tell_open(t, painter.open());
    slot = find_slot<MOVES>(t, first + STAGE + threadIdx.x, size, moving);  // while others still blend
    if (!__syncthreads_or(painter.open())) return true;
  }
  return false;
}

// Walks the list of this block's tile, or of a quarter of it. A Painter has
//   static const bool COLOUR         whether colours are wanted
//   void pixel(int i, float alpha, float red, float green, float blue, float depth)
//                                    alpha is 0 where it would be under 1/255
//   void splat(room, u32 at)         after the pixels of a lane; it is number `at` of the group
//   bool open() const                whether a pixel of the lane can still change
template <class Painter>
__device__ __forceinline__ void walk_tile(TileRoom &t, Painter &painter, const View *__restrict__ views,
                                          const Cloud *__restrict__ clouds,
                                          const u64 *__restrict__ starts,
                                          const u32 *__restrict__ counts, u64 *entries,
                                          u64 capacity, u32 room, u64 *aside, const Corner &corner,
                                          u32 flags, const Moving &moving) {
  if (threadIdx.x == 0) t.corner = corner;  // to be found again behind the walk
  u32 tile = corner.all, view = corner.view;
  u64 start = room ? (u64)tile * room : starts[tile];
  u64 *spare = corner.quarter != NOWHERE ? aside + (u64)blockIdx.x * room : entries + capacity + start;
  u32 n = room ? counts[tile] : counts[tile] - (u32)start;
  if (!n) return;
  if (threadIdx.x == 0) t.plan = {entries + start, spare, 1, 0, 0, -1, n, 0, 0, 0, 0};
  if (threadIdx.x < WARP) {
    const u32 words = sizeof(Cloud) / 4;
    u32 k = threadIdx.x, cloud = k < words ? views[view].cloud : views[view].tail;
    ((u32 *)&t.view)[k] = ((const u32 *)(views + view))[k];
    ((u32 *)t.cloud)[k] = cloud == NOWHERE ? 0 : ((const u32 *)(clouds + cloud))[k % words];
  }
  uint2 pixel = find_pixel();
  float x = hold((float)pixel.x), y = hold((float)pixel.y);
  float x1 = hold(x + (float)(PIXELS - 1));
  tell_open(t, painter.open());
  __syncthreads();
  while (u32 size = bring_group(t)) {
    bool done = may_move(t) ? walk_group<true>(t, painter, size, flags, moving, x, x1, y)
                            : walk_group<false>(t, painter, size, flags, moving, x, x1, y);
    if (done) return;
  }
}
