// Following a person: the rules of sim/follow_tally.py, operation by operation.

#define GOING 0
#define TOUCHED 1
#define LOST 2
#define STEPS 3
#define OVER 4

// What N episodes of following have come to, and the rules.
struct Following {
  int *far;         // [N] steps too far away since the last one that followed
  double *over_at;  // [N] s, when the person had arrived
  double *gap;      // [N] m to the reference place
  u8 *follows, *faced;  // [N] the last step did so
  double *distance;     // [N] m of the centres of agent and person
  i64 *end;             // [N] what ended the episode
  u8 *final_follows, *final_faced;  // the same of episodes that ended, 0 elsewhere
  double *final_distance;
  i64 *final_end;
  double reach, aligned, nearest, lost_beyond, linger, touch_within, same_time, step_seconds;
  double following, touch;  // what a step earns
  int lost_after, unused;
};
static_assert(sizeof(Following) == FOLLOWING_BYTES, "device_layout.FOLLOWING differs from Following");

#define AT_ONCE 8  // cells of a line

// Whether a wall is in a cell; beyond the map is one.
__device__ __forceinline__ bool is_wall(const Episode &e, int row, int col) {
  bool inside = row >= 0 && col >= 0 && row < e.rows && col < e.cols;
  return !inside | (e.walls[inside ? row * e.cols + col : 0] & WALL);
}

// Whether no wall is between two places: along the line of `trace_over`. Only that is asked of it, so
// that no cell has to wait for the one before. Both are on the map, whose cells 32 bits count.
__device__ __noinline__ bool see_through(const Episode &e, double x, double y, double x1,
                                         double y1) {
  int col = (int)cell_index(x, e.x, e.resolution), row = (int)cell_index(y, e.y, e.resolution);
  int col1 = (int)cell_index(x1, e.x, e.resolution), row1 = (int)cell_index(y1, e.y, e.resolution);
  int across = col1 > col ? col1 - col : col - col1, down = row1 > row ? row1 - row : row - row1;
  int right = col1 > col ? 1 : -1, up = row1 > row ? 1 : -1, error = across - down;
  bool hit = is_wall(e, row, col);
#pragma unroll 1
  while (!hit && (row != row1 || col != col1)) {
#pragma unroll
    for (int k = 0; k < AT_ONCE; k++) {  // at the end it stays there
      int twice = 2 * error;
      bool goes = row != row1 || col != col1;
      bool sideways = goes && twice > -down, upwards = goes && twice < across;
      if (sideways) error -= down;
      if (upwards) error += across;
      int next_row = upwards ? row + up : row, next_col = sideways ? col + right : col;
      bool between = is_wall(e, row, next_col) & is_wall(e, next_row, col);
      hit |= is_wall(e, next_row, next_col) | (sideways & upwards & between);
      row = next_row;
      col = next_col;
    }
  }
  return !hit;
}

// How far an agent at (x, y) is from its reference place [m], for a person [4].
__device__ __forceinline__ double measure_gap(const Episode &e, double x, double y,
                                              const double *person) {
  double rx = person[0] - e.keep_distance * person[2] + e.keep_lateral * person[3];
  double ry = person[1] - e.keep_distance * person[3] - e.keep_lateral * person[2];
  double dx = rx - x, dy = ry - y;
  return sqrt(dx * dx + dy * dy);
}

__device__ __forceinline__ const double *person_of(const Crowd &c, const Episode &e, int i) {
  return c.people + ((i64)i * c.places + e.followed) * 4;
}

__device__ __forceinline__ void begin_following(const Crowd &c, const Following &f,
                                                const Episode &e, int i) {
  const double *person = person_of(c, e, i);
  double dx = person[0] - e.start_x, dy = person[1] - e.start_y;
  f.far[i] = 0;
  f.over_at[i] = (double)INFINITY;
  f.gap[i] = measure_gap(e, e.start_x, e.start_y, person);
  f.follows[i] = f.faced[i] = 0;
  f.distance[i] = sqrt(dx * dx + dy * dy);
  f.end[i] = GOING;
}

// `FollowTally.step`: what an action earned, and whether it was the last.
__device__ __forceinline__ void judge_following(const World &w, const Crowd &c, const Following &f,
                                                const Episode &e, int i, Acted &a) {
  const double *person = person_of(c, e, i), *heading = e.headings + a.turns * 3;
  double dx = person[0] - a.p.x, dy = person[1] - a.p.y;
  double distance = sqrt(dx * dx + dy * dy);
  double ahead = dx * heading[1] + dy * heading[2];
  bool faced = ahead >= f.aligned * distance && see_through(e, a.p.x, a.p.y, person[0], person[1]);
  bool follows = faced && distance <= f.reach;
  int far = follows ? 0 : f.far[i];
  if (distance > f.lost_beyond) far++;
  double now = a.steps * f.step_seconds, over_at = f.over_at[i];
  bool arrived = c.whole[column_at(w, c, MODE, e.followed, i)] == ARRIVED;
  if (arrived) over_at = least_of(over_at, now);
  int end = now >= over_at + f.linger - f.same_time ? OVER : GOING;
  if (a.steps >= w.max_steps) end = STEPS;
  if (far > f.lost_after) end = LOST;
  bool touched = f.touch_within > 0.0 ? distance < f.touch_within
                                      : c.hit_person[i] > 0 && c.hit_by[i] == BY_AGENT;
  if (touched) end = TOUCHED;
  double gap = measure_gap(e, a.p.x, a.p.y, person);
  a.reward = f.following * follows + (f.gap[i] - gap) + f.touch * touched;
  a.terminated = end != GOING && end != STEPS;
  a.truncated = end == STEPS;
  bool kept = follows && distance >= f.nearest;
  a.success = (end == STEPS && follows) || (end == OVER && kept);
  f.far[i] = far;
  f.over_at[i] = over_at;
  f.gap[i] = gap;
  f.follows[i] = follows;
  f.faced[i] = faced;
  f.distance[i] = distance;
  f.end[i] = end;
}

__device__ __forceinline__ void keep_following(const Following &f, int i, bool ended) {
  f.final_follows[i] = ended ? f.follows[i] : 0;
  f.final_faced[i] = ended ? f.faced[i] : 0;
  f.final_distance[i] = ended ? f.distance[i] : 0.0;
  f.final_end[i] = ended ? f.end[i] : 0;
}

// `step_people` where somebody is followed; `move_people` comes before.
KERNEL_BOUNDED(step_following, CROWD_THREADS, 2)(World w, Crowd c, Following f,
                                                       const u8 *codes, Outputs out) {
  __shared__ int nexts[WARP];
  __shared__ u8 ends[WARP];
  if (w.status[0] != CLEAR) return;  // all threads alike
  int lane = threadIdx.x, p = threadIdx.y, i = blockIdx.x * LANES + lane;
  bool leads = p == 0 && i < w.count;
  if (leads) {
    int slot = w.slot[i];
    const Episode &e = w.episodes[slot];
    Acted a = act_among(w, c, e, i, codes[i]);
    judge_following(w, c, f, e, i, a);
    write_step(w, e, i, slot, a, out);
    ends[lane] = a.terminated || a.truncated;
    keep_following(f, i, ends[lane]);
    nexts[lane] = go_on_to(w, c, i, a);
  }
  __syncthreads();
  int next = i < w.count ? nexts[lane] : -1;
  if (i < w.count) keep_person(c, p, i, ends[lane]);
  if (next >= 0) begin_person(w, c, w.episodes[next], p, i);
  __syncthreads();  // everybody is where they begin
  if (!leads) return;
  if (next >= 0) begin_following(c, f, w.episodes[next], i);
  tell(w, i, out);
}

// `place_people`, and those who follow have not begun to.
KERNEL_BOUNDED(place_following, CROWD_THREADS, 2)(World w, Crowd c, Following f,
                                                        const int *slots, Outputs out) {
  __shared__ int nexts[WARP];
  int lane = threadIdx.x, p = threadIdx.y, i = blockIdx.x * LANES + lane;
  bool leads = p == 0 && i < w.count;
  if (leads) nexts[lane] = place_agent(w, c, slots, i);
  __syncthreads();
  int next = i < w.count ? nexts[lane] : -1;
  if (next >= 0) begin_person(w, c, w.episodes[next], p, i);
  __syncthreads();  // everybody is where they begin
  if (!leads) return;
  if (next >= 0) begin_following(c, f, w.episodes[next], i);
  tell(w, i, out);
}
