// The same of views with instances, compiled with INSTANCES.

KERNEL_BOUNDED(label_parts, THREADS, LABEL_BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const u64 *__restrict__ starts,
 const u32 *__restrict__ counts, u64 *entries, u64 capacity, u32 room, u64 *aside,
 u32 split, const u32 *__restrict__ order, const State *__restrict__ state, u32 tiles_x, u32 tiles, int width,
 int height, u32 flags, u32 *semantic, u32 *instance, const View *__restrict__ part_views,
 const Part *__restrict__ parts) {
  __shared__ __align__(16) TileRoom t;
  __shared__ Codes codes;
  if (room ? state->longest > room : state->needed > capacity) return;
  Corner c;
  if (!find_corner(c, order, counts, split, tiles_x, tiles)) return;
  label(t, codes, views, clouds, starts, counts, entries, capacity, room, aside, c, width, height, flags,
        semantic, instance, {part_views, parts});
}

// What labelling needs to know of instances: their clouds in `clouds`, and no light; with WHO the
// number of each in its view.
KERNEL(find_parts)(const View *__restrict__ part_views, u32 count, const Cloud *__restrict__ clouds,
                   Part *parts) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count) return;
  Part part = {};
  u32 number = part_views[i].cloud;
  if (number != NOWHERE) part.cloud = clouds[number];
  if (WHO) part.cloud.sh = (const u16 *)(u64)(1 + (part_views[i].spare[IS_PART] >> PART_SHIFT & 31u));
  parts[i] = part;
}
