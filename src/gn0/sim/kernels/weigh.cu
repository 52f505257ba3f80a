// What somebody weighs against each other: directions, or sides. A person that chooses alone makes
// all others of its warp wait; so each writes down what it asks, and the threads of a block share
// out the candidates of everybody. What is chosen is what gn0/people/detour.py chooses, one by one.

#define TASKS 32           // people of a block whose candidates are weighed at once
#define CANDIDATES_MOST 13
#define REFUSED -1e30      // a score that no candidate has

#define NO_TASK 0
#define SIDES 1       // which side of the way is freer
#define DIRECTIONS 2  // where to go, around who is on the path
#define PLACES 3      // where to make room

// cosines and sines of 0, 30, ... 180 degrees
__constant__ double cosines[7] = {1.0,  0.8660254037844386,  0.5, 0.0,
                                  -0.5, -0.8660254037844386, -1.0};
__constant__ double sines[7] = {0.0, 0.5, 0.8660254037844386, 1.0, 0.8660254037844386, 0.5, 0.0};
// of 0, 20, ... 120 degrees, and which of them are tried, the straightest first
__constant__ double cosines20[7] = {1.0,
                                    0.9396926207859084,
                                    0.766044443118978,
                                    0.5,
                                    0.17364817766693033,
                                    -0.17364817766693033,
                                    -0.5};
__constant__ double sines20[7] = {0.0,
                                  0.3420201433256687,
                                  0.6427876096865393,
                                  0.8660254037844386,
                                  0.984807753012208,
                                  0.984807753012208,
                                  0.8660254037844386};
__constant__ int turns[13] = {0, 1, -1, 2, -2, 3, 4, 5, 6, -3, -4, -5, -6};

// What a person asks, and what is needed to answer.
struct Task {
  double x, y;              // from where
  double ux, uy;            // unit vector ahead
  double hx, hy;            // heading
  double size;              // m to the place ahead
  double now, step;         // m/s and m, of the coming tick
  double here, space;       // m, the gap here and the one that is kept
  double ahead_x, ahead_y;  // a place ahead on the path
  double home_x, home_y;    // the nearest one on it
  const Episode *episode;
  u32 near;                 // see `find_near`
  int kind, count;          // of candidates
  int p, lane, side;
  int squeezes;
};

// Direction k of those beside the path.
__device__ __forceinline__ void turn_by_20(const Task &t, int k, double &cos, double &ux,
                                           double &uy) {
  int turn = turns[k];
  cos = cosines20[turn < 0 ? -turn : turn];
  double sin = turn >= 0 ? sines20[turn] * t.side : -sines20[-turn] * t.side;
  ux = t.ux * cos - t.uy * sin;
  uy = t.ux * sin + t.uy * cos;
}

// Direction k of twelve, of the plane.
__device__ __forceinline__ void turn_by_30(int k, double &ux, double &uy) {
  int turn = k - 5;
  ux = cosines[turn < 0 ? -turn : turn];
  uy = sines[turn < 0 ? -turn : turn];
  if (turn < 0) uy = -uy;
}

// Free places of a row beside the way ahead, up to a wall: rows 0 to 2 right, 3 to 5 left.
__device__ __forceinline__ double weigh_side(const Task &t, int k, const Ground &g,
                                             const Around &a) {
  int s = k < 3 ? -1 : 1, row = 1 + k % 3, free = 0;
#pragma unroll 1
  for (int b = 0; b < 4; b++) {
    double qx = t.x + t.ux * 0.3 * b - s * t.uy * 0.25 * row;
    double qy = t.y + t.uy * 0.3 * b + s * t.ux * 0.25 * row;
    if (!is_free(g, qx, qy)) break;
    if (gap_at(a, qx, qy) > ROOM) free++;
  }
  return free;
}

// Score of a direction beside the path.
__device__ __forceinline__ double weigh_direction(const Task &t, int k, const Ground &g,
                                                  const Around &a) {
  double cos, ux, uy;
  turn_by_20(t, k, cos, ux, uy);
  double reach = t.size > 0.35 ? 0.35 : t.size;
  double qx = t.x + ux * reach * 1.0, qy = t.y + uy * reach * 1.0;
  const double xs[4] = {t.x + ux * reach * 0.34, t.x + ux * reach * 0.67, qx, t.x + ux * t.step};
  const double ys[4] = {t.y + uy * reach * 0.34, t.y + uy * reach * 0.67, qy, t.y + uy * t.step};
  if (!are_free<4>(g, xs, ys)) return REFUSED;
#pragma unroll 1
  for (int part = 0; part < 3; part++) {
    double share = part == 0 ? 0.34 : part == 1 ? 0.67 : 1.0;
    double clear = gap_at(a, t.x + ux * reach * share, t.y + uy * reach * share);
    if (clear < t.space && clear < t.here + 0.2 * reach * share) return REFUSED;
  }
  bool sees = t.squeezes;  // whence one sees the path, one comes back to it
#pragma unroll 1
  for (int n = 0; n < 2 && !sees; n++)
    sees = clear_line(g, qx, qy, n ? t.home_x : t.ahead_x, n ? t.home_y : t.ahead_y);
  if (!sees) return REFUSED;
  return cos + 0.3 * (ux * t.hx + uy * t.hy);
}

// Score of a direction in which room is made.
__device__ __forceinline__ double weigh_place(const Task &t, int k, const Ground &g,
                                              const Around &a) {
  double ux, uy;
  turn_by_30(k, ux, uy);
  double qx = t.x + ux * 0.2, qy = t.y + uy * 0.2;
  const double xs[3] = {t.x + ux * 0.1, qx, t.x + ux * t.step};
  const double ys[3] = {t.y + uy * 0.1, qy, t.y + uy * t.step};
  if (!are_free<3>(g, xs, ys)) return REFUSED;
  double clear = gap_at(a, qx, qy);
  if (!(clear > t.here)) return REFUSED;
  int who;
  if (share_allowed(t.x, t.y, a, t.x + ux * SHUFFLE, t.y + uy * SHUFFLE, who) < 1.0) return REFUSED;
  int blind = 0;  // there, and here as well
#pragma unroll 1
  while (blind < 2 && !clear_line(g, blind ? t.x : qx, blind ? t.y : qy, t.home_x, t.home_y)) blind++;
  if (blind == 1) return REFUSED;  // the path is kept in sight
  return clear + STEADY * (ux * t.hx + uy * t.hy);
}

// What a candidate of a task is worth.
__device__ __noinline__ double weigh(const Task &t, int k, const Around &a) {
  Ground g = ground_of(*t.episode);
  if (t.kind == DIRECTIONS) return weigh_direction(t, k, g, a);
  if (t.kind == PLACES) return weigh_place(t, k, g, a);
  return weigh_side(t, k, g, a);
}

// The candidate with the highest score, the first of equals; -1 where all are refused.
__device__ __forceinline__ int choose(const Task &t, const double *scores) {
  double best = REFUSED;
  int found = -1;
#pragma unroll 1
  for (int k = 0; k < t.count; k++) {
    if (t.kind == DIRECTIONS && best == 1.0) break;  // as good as the path itself
    if (scores[k] <= best) continue;
    best = scores[k];
    found = k;
  }
  return found;
}

// The side with more free places beside the way ahead: 1 left, -1 right; right of equals.
__device__ __forceinline__ int choose_side(const double *scores) {
  return scores[3] + scores[4] + scores[5] > scores[0] + scores[1] + scores[2] ? 1 : -1;
}
