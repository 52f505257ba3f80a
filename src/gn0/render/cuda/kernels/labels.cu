// Labels of tiles; see `labels.cuh`.

KERNEL_BOUNDED(label_tiles, THREADS, LABEL_BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const u64 *__restrict__ starts,
 const u32 *__restrict__ counts, u64 *entries, u64 capacity, u32 room, u64 *aside,
 u32 split, const u32 *__restrict__ order, const State *__restrict__ state, u32 tiles_x, u32 tiles, int width,
 int height, u32 flags, u32 *semantic, u32 *instance) {
  __shared__ __align__(16) TileRoom t;
  __shared__ Codes codes;
  if (room ? state->longest > room : state->needed > capacity) return;
  Corner c;
  if (!find_corner(c, order, counts, split, tiles_x, tiles)) return;
  label(t, codes, views, clouds, starts, counts, entries, capacity, room, aside, c, width, height, flags,
        semantic, instance, {nullptr, nullptr});
}
