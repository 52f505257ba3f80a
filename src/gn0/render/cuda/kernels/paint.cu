// Pictures of tiles, and marks of what shows in them. A block a (view, tile).

KERNEL_BOUNDED(paint_tiles, THREADS, BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const u64 *__restrict__ starts,
 const u32 *__restrict__ counts, u64 *entries, u64 capacity, u32 room, u64 *aside,
 u32 split, const u32 *__restrict__ order, const State *__restrict__ state, u32 tiles_x, u32 tiles, int width,
 int height, u32 flags, const Target *__restrict__ listed, Target given) {
  __shared__ __align__(16) TileRoom t;
  if (room ? state->longest > room : state->needed > capacity) return;
  Corner c;
  if (!find_corner(c, order, counts, split, tiles_x, tiles)) return;
  paint(t, views, clouds, starts, counts, entries, capacity, room, aside, c, width, height, flags,
        listed, given, {nullptr, nullptr});
}

struct Marks {  // bits of splats that weigh more than a threshold somewhere
  static const bool COLOUR = false;
  float through[PIXELS], threshold;
  u32 *row;
  bool shows;

  __device__ __forceinline__ void pixel(int i, float alpha, float, float, float, float) {
    float weight = alpha * through[i], after = through[i] - weight;
    bool keep = after > TRANSMITTANCE_STOP;
    shows = shows || (keep && weight > threshold);
    through[i] = keep ? after : 0.f;
  }
  __device__ __forceinline__ void splat(const TileRoom &t, u32 at) {
    if (!shows) return;
    shows = false;
    u32 index = t.indices[at];
    if (index & TAIL) return;
    index >>= QUARTER_BITS;
    if (!t.cloud[0].places) index = __ldg(t.cloud[0].order + index);
    // as np.packbits lays them: the first splat is the highest bit of the first byte
    u32 bit = 1u << ((index & 24u) | (7u - (index & 7u)));
    if (!(read_stale(row + (index >> 5)) & bit)) atomicOr(row + (index >> 5), bit);
  }
  __device__ __forceinline__ bool open() const {
    bool any = false;
#pragma unroll
    for (int i = 0; i < PIXELS; i++) any = any || through[i] > threshold;
    return any;
  }
};

KERNEL_BOUNDED(mark_tiles, THREADS, BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const u64 *__restrict__ starts,
 const u32 *__restrict__ counts, u64 *entries, u64 capacity, u32 room, u64 *aside,
 u32 split, const u32 *__restrict__ order, const State *__restrict__ state, u32 tiles_x, u32 tiles, int width,
 int height, u32 flags, float threshold, u32 *marks, u64 words) {
  __shared__ __align__(16) TileRoom t;
  if (room ? state->longest > room : state->needed > capacity) return;
  Corner c;
  if (!find_corner(c, order, counts, split, tiles_x, tiles)) return;
  int2 at = find_first(c);
  Marks p;
  p.threshold = threshold, p.row = marks + views[c.view].row * words, p.shows = false;
#pragma unroll
  for (int i = 0; i < PIXELS; i++)
    p.through[i] = at.x + i < width && at.y < height ? 1.f : 0.f;
  walk_tile(t, p, views, clouds, starts, counts, entries, capacity, room, aside, c, flags,
            {nullptr, nullptr});
}
