// Views whose poses, and whose clouds, only the device knows: the tables that the host else makes.

#define NO_CLOUD 0xffffffffu  // rows of a cloud that no view may show
#define NOT_FINITE 0u         // what is wrong with a view
#define NOT_RIGID 1u
#define NOT_HERE 2u
#define NOT_HELD 3u
#define NO_PLACE -1  // what a floor says instead of a number of a cloud
#define NO_SET -2

struct Floor {  // where the eyes of a scene have visible sets; null numbers: nowhere
  const int *numbers;  // [rows, columns] clouds that are sets, of cells of the floor
  double cell, height, tolerance;  // m
  int column, row, columns, rows;  // of the first cell, and how many
};

// The cloud that a view of `cloud` is drawn from, its eye at (x, y, z); negative without its set.
__device__ __forceinline__ int find_set(const Floor &f, int cloud, double x, double y, double z) {
  if (!f.numbers || !(fabs(z - f.height) <= f.tolerance)) return cloud;
  double column = floor(x / f.cell) - f.column, row = floor(y / f.cell) - f.row;
  if (!(column >= 0.0 && column < f.columns && row >= 0.0 && row < f.rows)) return cloud;
  int number = f.numbers[(i64)row * f.columns + (i64)column];
  return number == NO_PLACE ? cloud : number;
}

// Views [count] from world-to-camera matrices [count, 4, 4]; `like` is any view of their camera.
// `chosen` numbers their clouds, the first `named`; null means all show the first. With `floors`,
// of each of those, they are drawn from visible sets, which are clouds behind them. A view that is none
// sees nothing, and holds its number times four and what is wrong. With `order` [all] they are those
// that it names, from `first` on. Beside that, `zeros` become zeros, and the words of `sent` (on the
// host) are `here`.
KERNEL(write_views)(const double *__restrict__ matrices, const int *__restrict__ chosen,
                    const Cloud *__restrict__ clouds, u32 named, const Floor *__restrict__ floors,
                    double tolerance, const int *__restrict__ order, u32 first, u32 count, View like,
                    View *views, u32 *zeros, u32 zero_count, const u32 *__restrict__ sent, u32 *here, u32 words) {
  u32 v = blockIdx.x * blockDim.x + threadIdx.x;
  for (u32 k = v; k < zero_count; k += gridDim.x * blockDim.x) zeros[k] = 0;
  if (v < words) here[v] = sent[v];
  if (v >= count) return;
  u32 of = order ? (u32)order[first + v] : first + v;
  const double *m = matrices + (u64)of * 16;
  bool finite = is_finite(m, 16), rigid = is_rigid(m, tolerance);
  u32 cloud = chosen ? (u32)chosen[of] : 0;
  bool known = cloud < named && clouds[cloud].rows != NO_CLOUD, held = true;
  if (finite && rigid && known) {
    double eye[3];
    for (int k = 0; k < 3; k++)  // operation for operation as `tables.find_eyes` does it
      eye[k] = -(m[k] * m[3] + m[4 + k] * m[7] + m[8 + k] * m[11]);
    int from = floors ? find_set(floors[cloud], (int)cloud, eye[0], eye[1], eye[2]) : (int)cloud;
    held = from >= 0;
    cloud = (u32)from;
    for (int i = 0; i < 3; i++)
      for (int k = 0; k < 3; k++) like.r[3 * i + k] = (float)m[4 * i + k];
    for (int k = 0; k < 3; k++) like.eye[k] = (float)eye[k];
    like.cloud = cloud;
  }
  like.spare[0] = NOWHERE;
  if (!(finite && rigid && known && held)) {
    u32 why = !finite ? NOT_FINITE : !rigid ? NOT_RIGID : !known ? NOT_HERE : NOT_HELD;
    like.spare[0] = of << 2 | why;
    for (int k = 0; k < 9; k++) like.r[k] = 0.f;
    for (int k = 0; k < 3; k++) like.eye[k] = 0.f;
    like.near = 1.f, like.far = 0.f;
    like.cloud = NOWHERE;
  }
  like.tail = NOWHERE;
  like.row = of;
  views[v] = like;
}

#define RANKERS 256  // threads that rank views

// Views [count] as `write_views` wrote them in the order in which they are to be drawn: those that are
// not `late` [count], then the others, views of one cloud one after another. `order` [2, count] gets
// them, then the place of each in them.
KERNEL_BOUNDED(rank_views, RANKERS, 1)
(const View *__restrict__ views, const int *__restrict__ late, u32 count, int *order) {
  __shared__ u64 keys[RANKERS];
  u32 v = blockIdx.x * RANKERS + threadIdx.x, place = 0;
  u64 mine = v < count ? (u64)late[v] << 32 | views[v].cloud : 0;
  for (u32 base = 0; base < count; base += RANKERS) {
    u32 other = base + threadIdx.x, many = min(count - base, RANKERS);
    keys[threadIdx.x] = other < count ? (u64)late[other] << 32 | views[other].cloud : 0;
    __syncthreads();
    for (u32 k = 0; k < many; k++) place += keys[k] < mine || (keys[k] == mine && base + k < v);
    __syncthreads();
  }
  if (v >= count) return;
  order[place] = (int)v, order[count + v] = (int)place;
}

#define GROUPERS 1024  // threads that group views

// Groups of the views from `first` to `count` that show each cloud from `begin` to `end`, as they all
// do, and their members, in the places of these views; one block. A group may be empty; the one behind
// them begins where their blocks end. In what order a group lists its members is the atomics' business,
// and cannot show.
KERNEL_BOUNDED(group_views, GROUPERS, 1)
(const View *__restrict__ views, const Cloud *__restrict__ clouds, u32 first, u32 count, u32 begin,
 u32 end, u32 each, u32 *counts, Group *groups, u32 *members) {
  __shared__ u64 held[GROUPERS / WARP];
  for (u32 c = begin + threadIdx.x; c < end; c += GROUPERS) counts[c] = 0;
  __syncthreads();
  for (u32 v = first + threadIdx.x; v < count; v += GROUPERS)
    if (views[v].cloud != NOWHERE) atomicAdd(counts + views[v].cloud, 1u);
  __syncthreads();
  u64 done = (u64)first << 32;  // of the clouds before: members over blocks
  for (u32 base = begin; base < end; base += GROUPERS) {
    u32 c = base + threadIdx.x;
    u32 mine = c < end ? counts[c] : 0, chunks = c < end ? clouds[c].chunks : 0;
    u32 rows = (chunks + each - 1) / each;
    u64 both = (u64)mine << 32 | (u64)rows * ((mine + VIEWS - 1) / VIEWS), sum = both;
    for (u32 d = 1; d < WARP; d <<= 1) {
      u64 other = __shfl_up_sync(FULL, sum, d);
      if (lane_id() >= d) sum += other;
    }
    if (lane_id() == WARP - 1) held[threadIdx.x / WARP] = sum;
    __syncthreads();
    u64 before = done + sum - both;
    for (u32 w = 0; w < GROUPERS / WARP; w++) {
      if (w < threadIdx.x / WARP) before += held[w];
      done += held[w];
    }
    if (c < end) {
      Group g = {c, 0, (u32)before, max(chunks, 1u), (u32)(before >> 32), mine, {0, 0}};
      groups[c] = g;
      counts[c] = (u32)(before >> 32);  // from here on: where its next member goes
    }
    __syncthreads();
  }
  if (!threadIdx.x) groups[end].first_block = (u32)done;
  for (u32 v = first + threadIdx.x; v < count; v += GROUPERS)
    if (views[v].cloud != NOWHERE) members[atomicAdd(counts + views[v].cloud, 1u)] = v;
}
