// Views with instances: other entries of what `list.cu` and `paint.cu` do, compiled with INSTANCES.

KERNEL_BOUNDED(count_parts, CHUNK, COVER_BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const Group *__restrict__ groups,
 u32 group_count, const u32 *__restrict__ members, u32 tiles_x, u32 tiles, u32 flags, u32 each,
 u32 *counts, u32 stride) {
  Lists to = {counts, nullptr, 0, 0};
  list_chunks<false>(views, clouds, groups, group_count, members, tiles_x, tiles, flags, each, stride, to);
}

KERNEL_BOUNDED(emit_parts, CHUNK, COVER_BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const Group *__restrict__ groups,
 u32 group_count, const u32 *__restrict__ members, u32 tiles_x, u32 tiles, u32 flags, u32 each,
 u32 *counts, const u64 *__restrict__ needed, u64 *entries, u64 capacity, u32 room) {
  if (!room && *needed > capacity) return;  // the host sees it too, and repeats with more room
  Lists to = {counts, entries, capacity, room};
  list_chunks<true>(views, clouds, groups, group_count, members, tiles_x, tiles, flags, each, 1, to);
}

KERNEL_BOUNDED(paint_parts, THREADS, BLOCKS)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, const u64 *__restrict__ starts,
 const u32 *__restrict__ counts, u64 *entries, u64 capacity, u32 room, u64 *aside,
 u32 split, const u32 *__restrict__ order, const State *__restrict__ state, u32 tiles_x, u32 tiles, int width,
 int height, u32 flags, const Target *__restrict__ listed, Target given,
 const View *__restrict__ part_views, const Part *__restrict__ parts) {
  __shared__ __align__(16) TileRoom t;
  if (room ? state->longest > room : state->needed > capacity) return;
  Corner c;
  if (!find_corner(c, order, counts, split, tiles_x, tiles)) return;
  paint(t, views, clouds, starts, counts, entries, capacity, room, aside, c, width, height, flags,
        listed, given, {part_views, parts});
}

// What is wrong with an instance, or with the instances of a view; see `gn0.render.cuda.replay`.
#define WRONG_PART 0x80000000u
#define PART_NOT_FINITE 0u
#define PART_NOT_RIGID 1u
#define PART_NOT_HERE 2u
#define PART_GAIN 3u
#define PART_OFFSETS 4u
#define PART_NEARER 5u
#define PARTS_MAX 32
#define NEARER_MOST 1.f
#define NO_PART -1  // instead of a cloud: nothing stands there

// Which view instance `i` belongs to, and how many of that view come before it. All views have
// `each` instances, or view v those from firsts[v] to firsts[v + 1]; whatever `firsts` holds, it is
// one of the views.
__device__ __forceinline__ u32 find_whose(const int *__restrict__ firsts, u32 each, u32 all, u32 i,
                                          u32 &before) {
  if (!firsts) {
    before = i % each;
    return i / each;
  }
  u32 low = 0, high = all;
  while (high - low > 1) {
    u32 middle = (low + high) / 2;
    if (firsts[middle] <= (int)i) low = middle;
    else high = middle;
  }
  before = i - (u32)firsts[low];
  return low;
}

// Behind `write_views`, which has written views `first` to `first + count` of `all`, or of `order`
// [2, all], whose second row is the place of each view in the first one: the views
// [instances] of instances behind them, from world-to-camera `matrices` [all, 4, 4] and part-to-world
// `poses` [instances, 4, 4]; and what painting needs of each. `chosen` numbers their clouds, `known`
// ones from `clouds + base` on, with normals at `normals`, in `bounds` (null: anywhere). With `brought`
// these are brought there from it. `gains` [instances, 4, 3] and `nearer` [instances] may be null.
// Double precision, operation for operation as `gn0.render.cuda.instances` does it.
KERNEL(write_parts)(const double *__restrict__ matrices, const double *__restrict__ poses,
                    const float *__restrict__ gains, const float *__restrict__ nearer,
                    const int *__restrict__ chosen,
                    const int *__restrict__ firsts, u32 each, Cloud *clouds,
                    const Cloud *brought, u32 base, u32 known, const u64 *__restrict__ normals,
                    const float *__restrict__ bounds, double tolerance, const int *__restrict__ order,
                    u32 first, u32 count, u32 all, u32 instances, u32 flags, View like, View *views,
                    Part *parts) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  const Cloud *named = brought ? brought : clouds + base;
  for (u32 k = i; brought && k < known * (sizeof(Cloud) / 4); k += gridDim.x * blockDim.x)
    ((u32 *)(clouds + base))[k] = ((const u32 *)brought)[k];
  if (i < count) {
    u32 of = order ? (u32)order[first + i] : first + i;
    int begin = firsts ? firsts[of] : (int)(of * each);
    int end = firsts ? firsts[of + 1] : begin + (int)each;
    bool sound = begin >= 0 && begin <= end && end - begin <= PARTS_MAX && end <= (int)instances &&
                 (of > 0 || begin == 0) && (of + 1 < all || end == (int)instances);
    views[i].spare[IS_PART] = 0, views[i].spare[WHOSE] = (u32)begin;
    if (!sound && views[i].spare[0] == NOWHERE) views[i].spare[0] = WRONG_PART | of << 3 | PART_OFFSETS;
  }
  if (i >= instances) return;
  u32 before, whose = find_whose(firsts, each, all, i, before);
  u32 at = order ? (u32)order[all + whose] : whose;  // among those that are written
  const double *p = poses + (u64)i * 16;
  int number = chosen[i];
  float near = like.near, far = like.far;
  Part part = {};
  like.spare[0] = NOWHERE, like.spare[IS_PART] = TAIL | before << PART_SHIFT;
  like.spare[WHOSE] = at - first;
  like.near = 1.f, like.far = 0.f;
  like.cloud = like.tail = NOWHERE, like.row = 0;
  bool here = at >= first && at - first < count && before < PARTS_MAX && number != NO_PART;
  here = here && views[at - first].cloud != NOWHERE;  // a view that is none is told of alone
  u32 why = !is_finite(p, 16) ? PART_NOT_FINITE : !is_rigid(p, tolerance) ? PART_NOT_RIGID
            : number < 0 || (u32)number >= known || named[number].rows == NOWHERE
                ? PART_NOT_HERE : NOWHERE;
  if (here && why == NOWHERE && gains)
    for (int k = 0; k < 12; k++)
      if (!(fabsf(gains[(u64)i * 12 + k]) <= 3.4028234e38f)) why = PART_GAIN;
  if (here && why == NOWHERE && nearer) {
    like.row = __float_as_uint(nearer[i]);
    if (!(nearer[i] >= 0.f && nearer[i] <= NEARER_MOST)) why = PART_NEARER;
  }
  if (here && why != NOWHERE) like.spare[0] = WRONG_PART | i << 3 | why;
  if (here && why == NOWHERE) {
    const double *m = matrices + (u64)whose * 16;
    double r[9], t[3];
    for (int a = 0; a < 3; a++) {
      for (int k = 0; k < 3; k++)
        r[3 * a + k] = m[4 * a] * p[k] + m[4 * a + 1] * p[4 + k] + m[4 * a + 2] * p[8 + k];
      t[a] = m[4 * a] * p[3] + m[4 * a + 1] * p[7] + m[4 * a + 2] * p[11] + m[4 * a + 3];
    }
    for (int k = 0; k < 9; k++) like.r[k] = (float)r[k];
    for (int k = 0; k < 3; k++) like.eye[k] = (float)-(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]);
    like.near = near, like.far = far;
    // whose capsule is out of sight is listed nowhere
    bool sight = !bounds || is_in_sight(bounds + (u64)number * 7, like, flags);
    like.cloud = sight ? base + (u32)number : NOWHERE;
    part.cloud = named[number];
    if (gains) {
      const float *g = gains + (u64)i * 12;
      part.normals = (const u32 *)normals[number];
      for (int c = 0; c < 3; c++) {
        part.gain[c] = g[c];
        for (int k = 0; k < 3; k++)
          part.gain[3 + 3 * k + c] =
              (float)(p[k] * (double)g[3 + c] + p[4 + k] * (double)g[6 + c] + p[8 + k] * (double)g[9 + c]);
      }
    }
  }
  views[count + i] = like;
  parts[i] = part;
}
