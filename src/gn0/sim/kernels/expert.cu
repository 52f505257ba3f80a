// What the field expert says of every agent: the arithmetic of maps/field_kernels.py and of
// maps/way_kernels.py, operation by operation. A warp an agent: lanes look along headings.

#define TURN_PRICE 0.48  // the numbers of maps/field_kernels.py
#define GAIN 0.16
#define GAIN_TWO 0.48
#define STEPS_ON 4  // AHEAD
#define ENTERED 64
#define WALK 8
#define LITTLE 0.004
#define CUT 4.0
#define STRAY 16.0
#define FAR_POINTS 256  // of maps/way_kernels.py
#define LABEL_WARPS 4   // agents a block
#define FAR_AWAY ((double)INFINITY)

// A bend of a distance field as an agent passes it: device_labels.BEND.
struct Bend {
  double x, y;  // m; NaN for the inside of an area
  int parent, via_begin, via_end, unused;
};
static_assert(sizeof(Bend) == BEND_BYTES, "device_labels.BEND differs from Bend");

// What labels need of the goal of a resident episode, beside its field: device_labels.WAYS.
struct Ways {
  const Bend *bends;     // [roots and more] by root of the field
  const double2 *vias;   // m, on the way from a bend to its parent
  const double2 *stops;  // [stop_count] m, places to stop beside
  int stop_count, unused;
};
static_assert(sizeof(Ways) == WAYS_BYTES, "device_labels.WAYS differs from Ways");

// An agent's body and ground, and where it stops.
struct Walker {
  const Episode &e;
  const Ways &ways;
  double step, near, price;
  int circle, lane;
};

__device__ __forceinline__ int turns_of(int j) { return j % 2 ? (j + 1) / 2 : -(j / 2); }

__device__ __forceinline__ int heading_after(const Walker &a, int turn, int j) {
  return (turn + turns_of(j) + a.circle) % a.circle;
}

__device__ __forceinline__ u32 label_of(const Episode &e, i64 cell) {
  int at = e.compact[cell];
  return e.wide ? ((const u32 *)e.labels)[at] : ((const u16 *)e.labels)[at];
}

// Geodesic distance [m] of a free point, and whether the expert stops there.
__device__ __noinline__ double look_around(const Walker &a, double x, double y, bool &there) {
  const Episode &e = a.e;
  double u = (x - e.x) / e.resolution, v = (y - e.y) / e.resolution;
  const double *root = e.roots + (i64)label_of(e, (i64)v * e.cols + (i64)u) * 3;
  double dx = u - root[0], dy = v - root[1];
  double away = fmax(root[2] + sqrt(dx * dx + dy * dy), 0.0) * e.resolution;
  there = root[2] == -FAR_AWAY;
  if (there || !(away <= a.near)) return away;
  for (int g = 0; g < a.ways.stop_count && !there; g++) {
    double gx = x - a.ways.stops[g].x, gy = y - a.ways.stops[g].y;
    if (!(sqrt(gx * gx + gy * gy) <= a.near)) continue;
    double px = x, py = y;
    there = !trace(e, px, py, a.ways.stops[g].x, a.ways.stops[g].y);
  }
  return away;
}

struct Landing {
  double x, y, left;  // m; inf left where the step is cut short, less than nothing at a stop
};

__device__ __forceinline__ Landing try_step(const Walker &a, double x, double y, int k) {
  const double *heading = a.e.headings + k * 3;
  Landing out;
  out.x = x + a.step * heading[1];
  out.y = y + a.step * heading[2];
  out.left = FAR_AWAY;
  double px = x, py = y;
  if (trace(a.e, px, py, out.x, out.y)) return out;
  bool there;
  double away = look_around(a, out.x, out.y, there);
  out.left = there ? -a.step : away;
  return out;
}

// The least cost of all lanes and its heading's number, the lower one of equals.
__device__ __forceinline__ void take_least(double &cost, int &j) {
  for (int d = WARP / 2; d; d >>= 1) {
    double other = __shfl_xor_sync(FULL, cost, d);
    int other_j = __shfl_xor_sync(FULL, j, d);
    if (other < cost || (other == cost && other_j < j)) {
      cost = other;
      j = other_j;
    }
  }
}

// Whether whole steps lead on from a place, each nearer to the goal.
__device__ __noinline__ bool goes_on(const Walker &a, Landing place, int turn) {
  if (place.left < 0.0) return true;
  double xs[STEPS_ON], ys[STEPS_ON], lefts[STEPS_ON];
  int turns[STEPS_ON], next[STEPS_ON];
  int depth = 0, entered = 1;
  xs[0] = place.x, ys[0] = place.y, lefts[0] = place.left, turns[0] = turn, next[0] = 0;
  while (depth >= 0) {
    int first = next[depth];
    if (first >= a.circle) {
      depth--;
      continue;
    }
    int j = first + a.lane, k = 0;
    Landing after = {0.0, 0.0, FAR_AWAY};
    bool good = false;
    if (j < a.circle) {
      k = heading_after(a, turns[depth], j);
      after = try_step(a, xs[depth], ys[depth], k);
      good = after.left <= lefts[depth] - GAIN * a.step;
    }
    u32 found = __ballot_sync(FULL, good);
    if (!found) {
      next[depth] = first + WARP;
      continue;
    }
    int from = __ffs(found) - 1;
    next[depth] = first + from + 1;
    after.left = __shfl_sync(FULL, after.left, from);
    if (after.left < 0.0 || depth == STEPS_ON - 1) return true;
    if (entered == ENTERED) return false;
    entered++;
    depth++;
    xs[depth] = __shfl_sync(FULL, after.x, from);
    ys[depth] = __shfl_sync(FULL, after.y, from);
    turns[depth] = __shfl_sync(FULL, k, from);
    lefts[depth] = after.left;
    next[depth] = 0;
  }
  return false;
}

// Cost of the cheapest whole step to a place with `most` left from which it goes on.
__device__ __noinline__ double look_one_ahead(const Walker &a, double x, double y, int turn,
                                              double most, bool any_end, int &chosen) {
  double last = -FAR_AWAY;
  int last_j = -1;
  while (true) {
    double best = FAR_AWAY;
    int best_j = a.circle;
    for (int j = a.lane; j < a.circle; j += WARP) {
      int turns = turns_of(j);
      double left = try_step(a, x, y, heading_after(a, turn, j)).left;
      double cost = left <= most ? left + a.price * (double)(turns < 0 ? -turns : turns) : FAR_AWAY;
      if ((cost > last || (cost == last && j > last_j)) && cost < best) {
        best = cost;
        best_j = j;
      }
    }
    take_least(best, best_j);
    chosen = best < FAR_AWAY ? best_j : 0;
    if (best == FAR_AWAY || any_end) return best;
    int k = heading_after(a, turn, best_j);
    if (goes_on(a, try_step(a, x, y, k), k)) return best;
    last = best;
    last_j = best_j;
  }
}

__device__ __noinline__ double look_two_ahead(const Walker &a, double x, double y, int turn,
                                              double here, int &chosen) {
  double best = look_one_ahead(a, x, y, turn, here - GAIN * a.step, false, chosen);
  if (best < FAR_AWAY) return best;
  double most = here - GAIN_TWO * a.step;
  for (int j = 0; j < a.circle; j++) {
    int turns = turns_of(j), k = heading_after(a, turn, j), any;
    Landing to = try_step(a, x, y, k);
    if (to.left == FAR_AWAY) continue;
    double cost = look_one_ahead(a, to.x, to.y, k, most, false, any);
    cost += a.price * (double)(turns < 0 ? -turns : turns);
    if (cost < best) {
      best = cost;
      chosen = j;
    }
  }
  return best;
}

// Metres to the goal by way of a first step and what is done from there on.
__device__ __forceinline__ double try_walk(const Walker &a, double x, double y, int turn,
                                           double here) {
  Landing at = try_step(a, x, y, turn);
  for (int count = 1; count < WALK; count++) {
    if (at.left == FAR_AWAY) break;
    if (count > 1 && at.left <= here - GAIN * a.step) return at.left + (double)count * a.step;
    int chosen;
    if (look_two_ahead(a, at.x, at.y, turn, at.left, chosen) == FAR_AWAY) break;
    turn = heading_after(a, turn, chosen);
    at = try_step(a, at.x, at.y, turn);
  }
  return FAR_AWAY;
}

// Turns, left positive, before the next FORWARD of an expert that is `here` [m] from the goal.
template <bool SLIDES>
__device__ __forceinline__ int choose_turns(const Walker &a, double x, double y, int turn,
                                            double here) {
  int chosen;
  double best = look_two_ahead(a, x, y, turn, here, chosen);
  if (best < FAR_AWAY) return turns_of(chosen);
  for (int j = 0; j < a.circle; j++) {  // back, and at it again
    int turns = turns_of(j);
    double cost = try_walk(a, x, y, heading_after(a, turn, j), here);
    cost += a.price * (double)(turns < 0 ? -turns : turns);
    if (cost < best) {
      best = cost;
      chosen = j;
    }
  }
  if (best < FAR_AWAY) return turns_of(chosen);
  best = look_one_ahead(a, x, y, turn, here - GAIN * a.step, true, chosen);  // into a nook
  if (best < FAR_AWAY) return turns_of(chosen);
  int best_j = a.circle;
  for (int j = a.lane; j < a.circle; j += WARP) {  // out of a nook, cut short or not
    int turns = turns_of(j);
    const double *heading = a.e.headings + heading_after(a, turn, j) * 3;
    double px = x, py = y, x1 = x + a.step * heading[1], y1 = y + a.step * heading[2];
    bool hit = SLIDES ? slide(a.e, px, py, x1, y1) : trace(a.e, px, py, x1, y1), there;
    if (px == x && py == y) continue;
    double away = look_around(a, px, py, there);
    double cost = (there ? -a.step : away) + a.price * (double)(turns < 0 ? -turns : turns);
    if (hit) cost += CUT * a.step;
    if (!there && away > here - LITTLE * a.step) cost += STRAY * a.step;
    if (cost < best) {
      best = cost;
      best_j = j;
    }
  }
  take_least(best, best_j);
  return best < FAR_AWAY ? turns_of(best_j) : 0;
}

template <bool SLIDES>
__device__ __forceinline__ void follow_field(const World &w, const Ways *ways, double near,
                                             int ahead, signed char *actions, double *distance) {
  int i = (int)((blockIdx.x * blockDim.x + threadIdx.x) / WARP), lane = threadIdx.x % WARP;
  if (i >= w.count) return;
  const Episode &e = w.episodes[w.slot[i]];
  double price = TURN_PRICE * w.forward / (double)w.circle;
  Walker a = {e, ways[w.slot[i]], w.forward, near, price, w.circle, lane};
  signed char *out = actions + (i64)i * ahead;
  double x = w.position[i].x, y = w.position[i].y;
  int turn = w.turns[i], count = 0;
  bool there;
  double here = look_around(a, x, y, there);
  if (lane == 0) distance[i] = here;
  while (!there && here < FAR_AWAY && count < ahead) {
    int turns = choose_turns<SLIDES>(a, x, y, turn, here);
    for (int t = turns < 0 ? -turns : turns; t > 0 && count < ahead; t--) {
      if (lane == 0) out[count] = turns > 0 ? LEFT : RIGHT;
      count++;
    }
    turn = (turn + turns + a.circle) % a.circle;
    if (count == ahead) break;
    if (lane == 0) out[count] = FORWARD;
    count++;
    const double *heading = e.headings + turn * 3;
    double x1 = x + a.step * heading[1], y1 = y + a.step * heading[2];
    if (SLIDES) slide(e, x, y, x1, y1);
    else trace(e, x, y, x1, y1);
    here = look_around(a, x, y, there);
  }
  for (int k = count + lane; k < ahead; k += WARP) out[k] = STOP;
}

// The next `ahead` actions of each agent [N, ahead], and its distance to the goal [N] m.
KERNEL(label_actions)(World w, const Ways *ways, double near, int ahead, signed char *actions,
                      double *distance) {
  follow_field<false>(w, ways, near, ahead, actions, distance);
}

KERNEL(label_sliding)(World w, const Ways *ways, double near, int ahead, signed char *actions,
                      double *distance) {
  follow_field<true>(w, ways, near, ahead, actions, distance);
}

// Whether no point of a straight line lies in a blocked cell: `is_clear` of maps/way_kernels.py.
__device__ __noinline__ bool is_clear(const Episode &e, double2 from, double2 to) {
  double u = (from.x - e.x) / e.resolution, v = (from.y - e.y) / e.resolution;
  double du = (to.x - e.x) / e.resolution - u, dv = (to.y - e.y) / e.resolution - v;
  i64 col = (i64)floor(u), row = (i64)floor(v);
  i64 last_col = (i64)floor(u + du), last_row = (i64)floor(v + dv);
  if (is_blocked(e, row, col) || is_blocked(e, last_row, last_col)) return false;
  i64 right = du > 0 ? 1 : -1, up = dv > 0 ? 1 : -1;
  double per_col = du != 0 ? fabs(1.0 / du) : FAR_AWAY;
  double per_row = dv != 0 ? fabs(1.0 / dv) : FAR_AWAY;
  double next_col = du != 0 ? (du > 0 ? (double)(col + 1) - u : u - (double)col) * per_col : FAR_AWAY;
  double next_row = dv != 0 ? (dv > 0 ? (double)(row + 1) - v : v - (double)row) * per_row : FAR_AWAY;
  i64 cells = (last_col > col ? last_col - col : col - last_col) +
              (last_row > row ? last_row - row : row - last_row) + 2;
  for (i64 n = 0; n < cells; n++) {
    if (col == last_col && row == last_row) return true;
    if (fabs(next_col - next_row) < 1e-9) {  // through a corner: all that meet there
      if (is_blocked(e, row, col + right) || is_blocked(e, row + up, col)) return false;
      col += right;
      row += up;
      next_col += per_col;
      next_row += per_row;
    } else if (next_col < next_row) {
      col += right;
      next_col += per_col;
    } else {
      row += up;
      next_row += per_row;
    }
    if (is_blocked(e, row, col)) return false;
  }
  return true;
}

// Cells to the goal from the middle of a cell, by the root that the cell has.
__device__ __forceinline__ double measure_cell(const Episode &e, i64 row, i64 col) {
  const double *root = e.roots + (i64)label_of(e, row * e.cols + col) * 3;
  double dx = (double)col + 0.5 - root[0], dy = (double)row + 0.5 - root[1];
  return root[2] + sqrt(dx * dx + dy * dy);
}

// The cell beside a cell whose centre is nearest the goal, and how near that is.
__device__ __forceinline__ double lower_cell(const Episode &e, i64 &row, i64 &col, double away) {
  double best = away;
  i64 best_row = row, best_col = col;
#pragma unroll 1
  for (int i = -1; i < 2; i++) {
#pragma unroll 1
    for (int j = -1; j < 2; j++) {
      if (is_blocked(e, row + i, col + j) || !label_of(e, (row + i) * e.cols + col + j)) continue;
      if (is_blocked(e, row + i, col) || is_blocked(e, row, col + j)) continue;
      double left = fmax(measure_cell(e, row + i, col + j), 0.0);
      if (left < best) {
        best = left;
        best_row = row + i;
        best_col = col + j;
      }
    }
  }
  row = best_row;
  col = best_col;
  return best;
}

// Points of a way that all lanes see; lane 0 writes them.
struct Way {
  double2 *points;
  double2 last;
  int count, lane;
  __device__ __forceinline__ void add(double2 p) {
    if (lane == 0) points[count] = p;
    last = p;
    count++;
  }
};

// The bends from a root to the goal behind the points of a way.
__device__ __forceinline__ void gather_bends(const Ways &ways, u32 root, Way &way) {
  while (true) {
    const Bend &bend = ways.bends[root];
    if (bend.x != way.last.x || bend.y != way.last.y) way.add(make_double2(bend.x, bend.y));
    if (bend.parent < 0 || way.count == FAR_POINTS) return;
    for (int k = bend.via_begin; k < bend.via_end && way.count < FAR_POINTS; k++)
      way.add(ways.vias[k]);
    if (way.count == FAR_POINTS) return;
    root = (u32)bend.parent;
  }
}

// The way from a place to the goal: `gather_way` of maps/field_kernels.py.
__device__ __forceinline__ void gather_way(const Episode &e, const Ways &ways, double2 place,
                                           Way &way) {
  i64 col = (i64)floor((place.x - e.x) / e.resolution);
  i64 row = (i64)floor((place.y - e.y) / e.resolution);
  way.add(place);
  double away = FAR_AWAY;
  while (true) {
    u32 root = label_of(e, row * e.cols + col);
    double2 bend = make_double2(ways.bends[root].x, ways.bends[root].y);
    if (bend.x != bend.x) return;  // in the goal's area the way ends here
    if (is_clear(e, way.last, bend)) {
      gather_bends(ways, root, way);
      return;
    }
    double before = away;
    if (way.count == 1) away = measure_cell(e, row, col);
    else away = lower_cell(e, row, col, away);
    if (away >= before || way.count == FAR_POINTS - 1) return;
    way.add(make_double2(e.x + ((double)col + 0.5) * e.resolution,
                         e.y + ((double)row + 0.5) * e.resolution));
  }
}

// The farthest point of a way in clear sight of one of them: lanes look at 32 at a time.
__device__ __forceinline__ int look_far(const Episode &e, const Way &way, int here) {
  for (int first = way.count - 1; first > here + 1; first -= WARP) {
    int there = first - way.lane;
    bool clear = there > here + 1 && is_clear(e, way.points[here], way.points[there]);
    u32 found = __ballot_sync(FULL, clear);
    if (found) return first - (__ffs(found) - 1);
  }
  return here + 1;
}

// Points at equal arcs along the way of each agent [N, slots, 2] m in its frame, and how many are
// no repetitions [N].
KERNEL(label_ways)(World w, const Ways *ways, double spacing, int slots, float2 *waypoints,
                   signed char *valid) {
  __shared__ double2 room[LABEL_WARPS][FAR_POINTS];
  int i = (int)((blockIdx.x * blockDim.x + threadIdx.x) / WARP), lane = threadIdx.x % WARP;
  if (i >= w.count) return;
  const Episode &e = w.episodes[w.slot[i]];
  const double *heading = e.headings + w.turns[i] * 3;
  double cosine = heading[1], sine = heading[2];
  double2 begin = w.position[i];
  float2 *out = waypoints + (i64)i * slots, last = make_float2(0.f, 0.f);
  Way way = {room[threadIdx.x / WARP], begin, 0, lane};
  bool there;
  Walker a = {e, ways[w.slot[i]], w.forward, 0.0, 0.0, w.circle, lane};
  if (look_around(a, begin.x, begin.y, there) == FAR_AWAY) {
    for (int k = lane; k < slots; k += WARP) out[k] = last;
    if (lane == 0) valid[i] = 0;
    return;
  }
  gather_way(e, ways[w.slot[i]], begin, way);
  __syncwarp();
  if (lane == 0) out[0] = last;
  int k = 1, here = 0;
  double arc = 0.0;
  double2 end = begin;
  while (k < slots && here < way.count - 1) {
    double2 from = way.points[here];
    int far = look_far(e, way, here);
    end = way.points[far];
    double dx = end.x - from.x, dy = end.y - from.y, length = sqrt(dx * dx + dy * dy);
    while (k < slots && spacing * (double)k <= arc + length + 1e-9 && length > 0.0) {
      double t = fmin((spacing * (double)k - arc) / length, 1.0);
      double x = from.x + t * dx - begin.x, y = from.y + t * dy - begin.y;
      last = make_float2((float)(cosine * x + sine * y), (float)(-sine * x + cosine * y));
      if (lane == 0) out[k] = last;
      k++;
    }
    arc += length;
    here = far;
  }
  if (k < slots && arc - spacing * (double)(k - 1) > 1e-6) {  // the end itself, a shorter step away
    double x = end.x - begin.x, y = end.y - begin.y;
    last = make_float2((float)(cosine * x + sine * y), (float)(-sine * x + cosine * y));
    if (lane == 0) out[k] = last;
    k++;
  }
  if (lane == 0) valid[i] = (signed char)k;
  for (int j = k + lane; j < slots; j += WARP) out[j] = last;
}
