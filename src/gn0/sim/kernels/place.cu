// Agents put anywhere: ground that is free, states gathered and put back, free places at random.

#define GROUND_FREE 0
#define GROUND_BLOCKED 1
#define GROUND_APART 2  // free, but no way leads from there to the goal

// Whether an agent may stand in a cell of its episode.
__device__ __forceinline__ int judge_cell(const Episode &e, i64 row, i64 col) {
  if (is_blocked(e, row, col)) return GROUND_BLOCKED;
  int at = e.compact[row * e.cols + col];
  u32 label = e.wide ? ((const u32 *)e.labels)[at] : ((const u16 *)e.labels)[at];
  return e.roots[(i64)label * 3 + 2] < (double)INFINITY ? GROUND_FREE : GROUND_APART;
}

// What the ground is like at positions [K, 2] m of the episodes at `slots` [K].
KERNEL(judge_places)(World w, const int *slots, const double *positions, int count, u8 *verdicts) {
  int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= count) return;
  const Episode &e = w.episodes[slots[k]];
  i64 col = cell_index(positions[2 * k], e.x, e.resolution);
  i64 row = cell_index(positions[2 * k + 1], e.y, e.resolution);
  verdicts[k] = (u8)judge_cell(e, row, col);
}

// Whether the goal can be reached from a cell, and the way from its middle is not `reach` [m] long.
__device__ __forceinline__ bool is_place(const Episode &e, i64 at, double reach) {
  if (judge_cell(e, at / e.cols, at % e.cols) != GROUND_FREE) return false;
  if (reach == (double)INFINITY) return true;
  double x = e.x + ((double)(at % e.cols) + 0.5) * e.resolution;
  double y = e.y + ((double)(at / e.cols) + 0.5) * e.resolution;
  return measure(e, x, y) < reach;
}

// A place [K, 2] m for each of `slots` [K], uniform over all ground from which the goal can be
// reached, within `reaches` [K] m of way. `chances` [K, 3] in [0, 1): which cell, and where in it.
// A block an entry.
KERNEL(find_places)(World w, const int *slots, const double *chances, const double *reaches,
                    double *positions) {
  __shared__ int counts[1024];
  __shared__ int wanted;
  int k = blockIdx.x, t = threadIdx.x, threads = blockDim.x;
  const Episode &e = w.episodes[slots[k]];
  double reach = reaches[k];
  i64 cells = (i64)e.rows * e.cols, strip = (cells + threads - 1) / threads;
  i64 begin = t * strip, end = begin + strip < cells ? begin + strip : cells;
  int own = 0;
  for (i64 at = begin; at < end; at++) own += is_place(e, at, reach);
  counts[t] = own;
  __syncthreads();
  if (t == 0) {
    int total = 0;
    for (int j = 0; j < threads; j++) {  // cells before each strip
      int here = counts[j];
      counts[j] = total;
      total += here;
    }
    wanted = min((int)(chances[3 * k] * (double)total), total - 1);
  }
  __syncthreads();
  int left = wanted - counts[t];
  if (left < 0 || left >= own) return;
  for (i64 at = begin; at < end; at++) {
    if (!is_place(e, at, reach) || left--) continue;
    i64 row = at / e.cols, col = at % e.cols;
    double x = e.x + ((double)col + chances[3 * k + 1]) * e.resolution;
    double y = e.y + ((double)row + chances[3 * k + 2]) * e.resolution;
    if (cell_index(x, e.x, e.resolution) != col) x = e.x + ((double)col + 0.5) * e.resolution;
    if (cell_index(y, e.y, e.resolution) != row) y = e.y + ((double)row + 0.5) * e.resolution;
    positions[2 * k] = x;
    positions[2 * k + 1] = y;
    return;
  }
}

// Agents `agents` [K] stand at positions [K, 2] m in the episodes at `slots` [K].
KERNEL(put_agents)(World w, const int *agents, const int *slots, const double *positions,
                   const int *turns, const int *steps, const int *views, const u8 *collided,
                   int count) {
  int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= count) return;
  int i = agents[k];
  double x = positions[2 * k], y = positions[2 * k + 1];
  w.slot[i] = slots[k];
  w.position[i] = make_double2(x, y);
  w.turns[i] = turns[k];
  w.steps[i] = steps[k];
  w.collided[i] = collided[k];
  w.distance[i] = measure(w.episodes[slots[k]], x, y);
  if (w.views) w.views[i] = views[k];
}

// All agents turn on the spot by so many whole turns [N], to the left where positive.
KERNEL(turn_agents)(World w, const int *turns) {
  int i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= w.count) return;
  i64 turned = ((i64)w.turns[i] + turns[i]) % w.circle;
  w.turns[i] = (int)(turned < 0 ? turned + w.circle : turned);
}

// Rows `from` [K] of an array to rows `to` [K] of another, `size` bytes each; null: row k.
KERNEL(move_rows)(const u8 *in, const int *from, const int *to, u64 size, int count, u8 *out) {
  u64 at = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= size * count) return;
  u64 k = at / size, byte = at % size;
  out[(u64)(to ? to[k] : (int)k) * size + byte] = in[(u64)(from ? from[k] : (int)k) * size + byte];
}

// Tiles [K, views, size] bytes, newest first, into the rings of `agents`, who have seen so many.
KERNEL(keep_tiles)(const u8 *tiles, const int *agents, int views, u64 size, int count, u8 *rings) {
  u64 at = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= size * views * count) return;
  u64 row = at / size, k = row / views, back = row % views;
  rings[((u64)agents[k] * TILES + (views - 1 - back)) * size + at % size] = tiles[at];
}

// Plans [K, length] of actions from the places at `rows` [K] of all places (`slots`, `positions` m,
// `turns`): x, y, yaw [K, length, 3] behind each action, and whether it was cut short. Behind a STOP
// nothing moves. No agent is touched.
template <bool SLIDES>
__device__ __forceinline__ void walk_plan(const World &w, const i64 *rows, const int *slots,
                                          const double *positions, const int *turns,
                                          const u8 *actions, int length, int count, double *poses,
                                          u8 *cut) {
  int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= count) return;
  i64 row = rows[k];
  const Episode &e = w.episodes[slots[row]];
  double x = positions[2 * row], y = positions[2 * row + 1];
  int turned = turns[row];
  bool over = false;
  for (int step = 0; step < length; step++) {
    i64 at = (i64)k * length + step;
    int action = actions[at];
    bool hit = false;
    over = over || action == STOP;
    if (!over && action == FORWARD) {
      const double *heading = e.headings + turned * 3;
      double x1 = x + w.forward * heading[1], y1 = y + w.forward * heading[2];
      hit = SLIDES ? slide(e, x, y, x1, y1) : trace(e, x, y, x1, y1);
    } else if (!over && action == LEFT) {
      turned = (turned + 1) % w.circle;
    } else if (!over && action == RIGHT) {
      turned = (turned + w.circle - 1) % w.circle;
    }
    poses[3 * at] = x;
    poses[3 * at + 1] = y;
    poses[3 * at + 2] = e.headings[turned * 3];
    cut[at] = hit;
  }
}

KERNEL(walk_plans)(World w, const i64 *rows, const int *slots, const double *positions,
                   const int *turns, const u8 *actions, int length, int count, double *poses,
                   u8 *cut) {
  walk_plan<false>(w, rows, slots, positions, turns, actions, length, count, poses, cut);
}

KERNEL(slide_plans)(World w, const i64 *rows, const int *slots, const double *positions,
                    const int *turns, const u8 *actions, int length, int count, double *poses,
                    u8 *cut) {
  walk_plan<true>(w, rows, slots, positions, turns, actions, length, count, poses, cut);
}
