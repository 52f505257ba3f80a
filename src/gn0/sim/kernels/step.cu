// All agents take a step: the arithmetic of sim/batch_kernels.py, operation by operation.

// Geodesic distance [m] of a free point.
__device__ __forceinline__ double measure(const Episode &e, double x, double y) {
  double u = (x - e.x) / e.resolution, v = (y - e.y) / e.resolution;
  i64 cell = (i64)v * e.cols + (i64)u;
  int at = e.compact[cell];
  u32 label = e.wide ? ((const u32 *)e.labels)[at] : ((const u16 *)e.labels)[at];
  const double *root = e.roots + (i64)label * 3;
  double dx = u - root[0], dy = v - root[1];
  return fmax(root[2] + sqrt(dx * dx + dy * dy), 0.0) * e.resolution;  // -inf in an area
}

// Whether an agent so far from the goal [m] is there.
__device__ __forceinline__ bool is_there(const Episode &e, const World &w, double distance) {
  return distance < (e.reach > 0.0 ? e.reach : w.success_distance);
}

__device__ __forceinline__ i64 cell_index(double at, double origin, double resolution) {
  return (i64)floor(fmin(fmax((at - origin) / resolution, -2147483648.0), 2147483648.0));
}

// Bresenham's line from (x, y) to the target; the move ends before the first blocked cell.
template <class Blocked>
__device__ __forceinline__ bool trace_over(const Episode &e, Blocked blocked, double &x, double &y,
                                           double x1, double y1) {
  i64 col = cell_index(x, e.x, e.resolution), row = cell_index(y, e.y, e.resolution);
  i64 col1 = cell_index(x1, e.x, e.resolution), row1 = cell_index(y1, e.y, e.resolution);
  i64 across = col1 > col ? col1 - col : col - col1, down = row1 > row ? row1 - row : row - row1;
  i64 right = col1 > col ? 1 : -1, up = row1 > row ? 1 : -1;
  i64 error = across - down, steps = 0;
  bool hit = blocked(e, row, col);
  if (hit) steps = -1;
  while (!hit && (row != row1 || col != col1)) {
    i64 twice = 2 * error, next_row = row, next_col = col;
    if (twice > -down) {
      error -= down;
      next_col += right;
    }
    if (twice < across) {
      error += across;
      next_row += up;
    }
    hit = blocked(e, next_row, next_col);
    if (!hit && next_row != row && next_col != col)
      hit = blocked(e, row, next_col) && blocked(e, next_row, col);
    if (hit) break;
    row = next_row;
    col = next_col;
    steps++;
  }
  if (!hit) {
    x = x1;
    y = y1;
  } else if (steps > 0) {
    x = e.x + ((double)col + 0.5) * e.resolution;
    y = e.y + ((double)row + 0.5) * e.resolution;
  }
  return hit;
}

struct Blocked {
  __device__ __forceinline__ bool operator()(const Episode &e, i64 row, i64 col) const {
    return is_blocked(e, row, col);
  }
};

__device__ __forceinline__ bool trace(const Episode &e, double &x, double &y, double x1, double y1) {
  return trace_over(e, Blocked(), x, y, x1, y1);
}

#define PROJECTIONS 2      // the numbers of maps/slide.py
#define AROUND 3           // cells each way that tell how a wall runs
#define LEAST 1e-9         // m of progress that is worth a projection

// Unit vector towards the blocked cells around, near ones first; zero if undecided.
__device__ __forceinline__ double2 face_wall(const Episode &e, i64 row, i64 col) {
  double nx = 0.0, ny = 0.0;
#pragma unroll 1  // 28 cells side by side would be half of the kernel
  for (int dr = -AROUND; dr <= AROUND; dr++) {
#pragma unroll 1
    for (int dc = -AROUND; dc <= AROUND; dc++) {
      int square = dr * dr + dc * dc;
      if (square > 0 && square <= AROUND * AROUND && is_blocked(e, row + dr, col + dc)) {
        nx += (double)dc / (double)square;
        ny += (double)dr / (double)square;
      }
    }
  }
  double length = sqrt(nx * nx + ny * ny);
  return length < 1e-9 ? make_double2(0.0, 0.0) : make_double2(nx / length, ny / length);
}

// `trace`, going on along the wall where the move is cut: `slide_points` of maps/slide.py.
__device__ __forceinline__ bool slide(const Episode &e, double &x, double &y, double x1, double y1) {
  if (!trace(e, x, y, x1, y1)) return false;
  double rx = x1 - x, ry = y1 - y;
  for (int time = 0; time < PROJECTIONS; time++) {
    i64 row = (i64)floor((y - e.y) / e.resolution), col = (i64)floor((x - e.x) / e.resolution);
    double2 n = face_wall(e, row, col);
    double into = rx * n.x + ry * n.y, tx = rx, ty = ry;
    if (into > 0.0) {
      tx = rx - into * n.x;
      ty = ry - into * n.y;
    }
    double length = sqrt(tx * tx + ty * ty);
    double best = 0.0, best_x = x, best_y = y, end_x = x, end_y = y;
    bool best_hit = true;
    // along the tangent; the same one or two cells off the wall, over a stair; bent off it; and
    // along an axis where all of these stand still
    for (int way = 0; way < 6; way++) {
      if (way >= 4 && best > LEAST) break;
      if (way < 4 && length <= LEAST) continue;
      double px = x, py = y, dx = tx, dy = ty;
      if (way == 1 || way == 2) {
        double lift = fmin((double)way * e.resolution, 0.5 * length);
        trace(e, px, py, x - lift * n.x, y - lift * n.y);
        dx = tx * (1.0 - lift / length);
        dy = ty * (1.0 - lift / length);
      } else if (way == 3) {
        dx = tx - n.x * e.resolution;
        dy = ty - n.y * e.resolution;
        double size = sqrt(dx * dx + dy * dy);
        dx = dx * length / size;
        dy = dy * length / size;
      } else if (way == 4) {
        dx = rx;
        dy = 0.0;
      } else if (way == 5) {
        dx = 0.0;
        dy = ry;
      }
      double qx = px, qy = py;
      bool cut = trace(e, qx, qy, px + dx, py + dy);
      double gain = way < 4 ? ((qx - x) * tx + (qy - y) * ty) / length
                            : sqrt((qx - x) * (qx - x) + (qy - y) * (qy - y));
      if (gain > best + LEAST) {
        best = gain;
        best_x = qx;
        best_y = qy;
        best_hit = cut;
        end_x = px + dx;
        end_y = py + dy;
      }
    }
    if (best <= LEAST) break;
    x = best_x;
    y = best_y;
    if (!best_hit) break;
    rx = end_x - x;
    ry = end_y - y;
  }
  return true;
}

__device__ __forceinline__ float2 see_goal(const Episode &e, double x, double y, int turns) {
  const double *heading = e.headings + turns * 3;
  double dx = e.goal_x - x, dy = e.goal_y - y, c = heading[1], s = heading[2];
  float forward = (float)(c * dx + s * dy), left = (float)(-s * dx + c * dy);
  return make_float2(fminf(fmaxf(forward, -VECTOR_LIMIT), VECTOR_LIMIT),
                     fminf(fmaxf(left, -VECTOR_LIMIT), VECTOR_LIMIT));
}

__device__ __forceinline__ void begin(const World &w, int i, int slot) {
  const Episode &e = w.episodes[slot];
  w.slot[i] = slot;
  w.position[i] = make_double2(e.start_x, e.start_y);
  w.turns[i] = 0;
  w.steps[i] = 0;
  w.collided[i] = 0;
  w.distance[i] = measure(e, e.start_x, e.start_y);
  if (w.views) w.views[i] = 0;
}

// The slot of an agent's next episode; -1, and a word to the host, when it has none.
__device__ __forceinline__ int draw(const World &w, int i) {
  int cursor = w.cursor[i];
  if (cursor >= w.filled[i]) {
    atomicMin(w.status + 1, i);
    return -1;
  }
  w.cursor[i] = cursor + 1;
  return w.queue[(i64)i * w.ahead + cursor % w.ahead];
}

// What an agent senses and what is told of it, where it stands now.
__device__ __forceinline__ void tell(const World &w, int i, const Outputs &out) {
  const Episode &e = w.episodes[w.slot[i]];
  double2 p = w.position[i];
  int turns = w.turns[i];
  if (out.goal_vector) out.goal_vector[i] = see_goal(e, p.x, p.y, turns);
  out.collided[i] = w.collided[i];
  out.pose[3 * i] = p.x;
  out.pose[3 * i + 1] = p.y;
  out.pose[3 * i + 2] = e.headings[turns * 3];
  out.distance[i] = w.distance[i];
  out.episode[i] = e.number;
  out.scene[i] = e.scene;
}

// Actions of any integer type [N] as codes; the first agent with a bad one stops the world.
KERNEL(read_actions)(World w, const void *actions, int width, int step, u8 *codes) {
  int i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= w.count || read_stale(w.status + 2) < step) return;
  i64 action;
  if (width == 8) action = ((const i64 *)actions)[i];
  else if (width == 4) action = ((const int *)actions)[i];
  else if (width == 2) action = ((const short *)actions)[i];
  else action = ((const signed char *)actions)[i];
  if (action < 0 || action > 3) {  // an unsigned number that reads as negative is as bad
    atomicMin(w.status, i);
    atomicMin(w.status + 2, step);
  }
  codes[i] = (u8)action;
}

// What an action of an agent led to.
struct Acted {
  double2 p;  // where it ended
  int turns, steps;
  double distance;  // m to the goal
  double reward;
  bool hit, terminated, truncated, success;
};

__device__ __forceinline__ int turn_by(const World &w, int turns, int action) {
  if (action == LEFT) return (turns + 1) % w.circle;
  if (action == RIGHT) return (turns + w.circle - 1) % w.circle;
  return turns;
}

// A move ahead through the map of an episode, by the body's rule; whether it was cut.
template <bool SLIDES>
__device__ __forceinline__ bool go_ahead(const World &w, const Episode &e, int turns, double2 &p) {
  const double *heading = e.headings + turns * 3;
  double x1 = p.x + w.forward * heading[1], y1 = p.y + w.forward * heading[2];
  return SLIDES ? slide(e, p.x, p.y, x1, y1) : trace(e, p.x, p.y, x1, y1);
}

// Goal navigation: what an action earned, and whether it was the last.
__device__ __forceinline__ void judge(const World &w, const Episode &e, int action, double before,
                                      Acted &a) {
  a.terminated = action == STOP && !e.stays;
  a.truncated = !a.terminated && a.steps >= w.max_steps;
  a.success = a.terminated && is_there(e, w, a.distance);
  a.reward = before - a.distance - w.step_cost;
  if (a.success) a.reward += w.success_reward;
}

// Write what an action led to, and the last of an episode that ended.
__device__ __forceinline__ void write_step(const World &w, const Episode &e, int i, int slot,
                                           const Acted &a, const Outputs &out) {
  bool ended = a.terminated || a.truncated;
  out.rewards[i] = a.reward;
  out.terminated[i] = a.terminated;
  out.truncated[i] = a.truncated;
  out.ended[i] = ended;
  if (out.final_goal_vector)
    out.final_goal_vector[i] = ended ? see_goal(e, a.p.x, a.p.y, a.turns) : make_float2(0.f, 0.f);
  out.final_collided[i] = ended && a.hit;
  out.final_pose[3 * i] = ended ? a.p.x : 0.0;
  out.final_pose[3 * i + 1] = ended ? a.p.y : 0.0;
  out.final_pose[3 * i + 2] = ended ? e.headings[a.turns * 3] : 0.0;
  out.final_distance[i] = ended ? a.distance : 0.0;
  out.final_success[i] = a.success;
  out.final_episode[i] = ended ? e.number : -1;
  out.final_slot[i] = ended ? slot : -1;
  out.final_turns[i] = a.turns;
  if (w.views) out.final_views[i] = ended ? w.views[i] + 1 : 0;
}

// An episode goes on where an action led to.
__device__ __forceinline__ void stay_in(const World &w, int i, const Acted &a) {
  w.position[i] = a.p;
  w.turns[i] = a.turns;
  w.steps[i] = a.steps;
  w.collided[i] = a.hit;
  w.distance[i] = a.distance;
  if (w.views) w.views[i]++;
}

// One action each (0..3), rewards and ends, and the next episode for those that ended.
template <bool SLIDES>
__device__ __forceinline__ void step_agent(const World &w, const u8 *codes, const Outputs &out) {
  int i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= w.count || w.status[0] != CLEAR) return;
  int slot = w.slot[i], action = codes[i], turns = w.turns[i];
  const Episode &e = w.episodes[slot];
  double before = w.distance[i];
  Acted a = {w.position[i], turn_by(w, turns, action), w.steps[i] + 1, before};
  if (action == FORWARD) {
    a.hit = go_ahead<SLIDES>(w, e, turns, a.p);
    a.distance = measure(e, a.p.x, a.p.y);
  }
  judge(w, e, action, before, a);
  write_step(w, e, i, slot, a, out);
  int next = a.terminated || a.truncated ? draw(w, i) : -1;
  if (next >= 0) begin(w, i, next);
  else stay_in(w, i, a);
  tell(w, i, out);
}

KERNEL(step_agents)(World w, const u8 *codes, Outputs out) { step_agent<false>(w, codes, out); }

// The same for bodies that slide: a kernel of its own, so that others take no registers for it.
KERNEL(slide_agents)(World w, const u8 *codes, Outputs out) { step_agent<true>(w, codes, out); }

// Begin episodes: slot >= 0 that one, -1 none, -2 the next in the agent's queue.
KERNEL(place_agents)(World w, const int *slots, Outputs out) {
  int i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= w.count) return;
  int slot = slots[i] == -2 ? draw(w, i) : slots[i];
  if (slot >= 0) begin(w, i, slot);
  tell(w, i, out);
}

// Range rings [N, rays] m from poses [N, 3] with `turns` turns; 0 where an agent has no slot.
KERNEL(read_ranges)(World w, const int *slots, const double *poses, const int *turns, int rays,
                    double limit, float *out) {
  i64 k = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= (i64)w.count * rays) return;
  int i = (int)(k / rays), slot = slots[i];
  if (slot < 0) {
    out[k] = 0.f;
    return;
  }
  const Episode &e = w.episodes[slot];
  const double *ray = e.directions + ((i64)turns[i] * rays + k % rays) * 2;
  double dx = ray[0], dy = ray[1], far = limit / e.resolution;
  double u = (poses[3 * i] - e.x) / e.resolution, v = (poses[3 * i + 1] - e.y) / e.resolution;
  i64 col = (i64)floor(u), row = (i64)floor(v);
  if (is_blocked(e, row, col)) {
    out[k] = 0.f;
    return;
  }
  int step_x = dx > 0 ? 1 : -1, step_y = dy > 0 ? 1 : -1;
  double per_x = dx != 0 ? fabs(1.0 / dx) : (double)INFINITY;
  double per_y = dy != 0 ? fabs(1.0 / dy) : (double)INFINITY;
  double next_x = dx != 0 ? (dx > 0 ? (double)(col + 1) - u : u - (double)col) * per_x : per_x;
  double next_y = dy != 0 ? (dy > 0 ? (double)(row + 1) - v : v - (double)row) * per_y : per_y;
  double distance = 0.0;
  while (true) {
    if (next_x < next_y) {
      distance = next_x;
      next_x += per_x;
      col += step_x;
    } else {
      distance = next_y;
      next_y += per_y;
      row += step_y;
    }
    if (distance >= far) {
      distance = far;
      break;
    }
    if (is_blocked(e, row, col)) break;
  }
  out[k] = (float)(distance * e.resolution);
}

// `list` is [N] draws in the queue after this, then [entries, 2] cells of the queue and their slots.
KERNEL(fill_queue)(World w, const int *list, int entries, int *queue, int *filled) {
  int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k < w.count) filled[k] = list[k];
  if (k < entries) queue[list[w.count + 2 * k]] = list[w.count + 2 * k + 1];
}

KERNEL(copy_words)(const u32 *in, u64 words, u32 *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k < words) out[k] = in[k];
}

KERNEL(copy_bytes)(const u8 *in, u64 size, u8 *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k < size) out[k] = in[k];
}

// Rows of `words` 16-byte words into a table at `slots`.
KERNEL(store_rows)(const uint4 *rows, const int *slots, uint4 *table, int words, int count) {
  int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k < count * words) table[(i64)slots[k / words] * words + k % words] = rows[k];
}
