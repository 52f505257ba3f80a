// What a person of an episode is doing, and what is in its reach: gn0/people/reach.py, function by
// function and operation by operation. Numbers are those of that file and of route.py.

#define LANES ((int)blockDim.x)  // environments a block: neighbours in memory, one to a lane

#define BRAKE 0.7
#define ACCELERATION 0.8
#define COMFORT 0.10
#define SAFE_GAP 1e-3
#define SIGHT 2.5
#define SAMPLE 0.25
#define ALIGNED 0.9
#define SIDEWAYS 0.5
#define ROUND_SPEED 0.6
#define ROUND_SECONDS 4.1
#define ROUND_MOST 6.1
#define NO_WAY_SECONDS 0.6
#define PRESS_SECONDS 1
#define BACK_SECONDS 5
#define PIVOT_COS 0.7071067811865476
#define PIVOT_LAG 4
#define SETTLE 8
#define FIRM 1099511627776
#define ENOUGH 0.4
#define LEAVE 0.5
#define STEADY 0.15
#define RIVAL 0.45
#define ROOM 0.06
#define SQUEEZE 0.01
#define FEW_TURNS 9
#define HOME 0.3
#define SHUFFLE 0.1
#define CLOSE 1e-4
#define MOVED 0.05
#define LONG_AGO 1000

#define ON_PATH 0
#define ROUND 1
#define ARRIVED 2
#define STILL 0
#define WALK 1
#define NOBODY (-2)
#define AGENT (-1)
#define SCRIPT 0
#define BACK 1
#define LOOP 2

// The columns of a person as reach.py numbers them, by name and type.
#define REAL_COLUMNS(f)                                                                        \
  f(0, x, double) f(1, y, double) f(2, x0, double) f(3, y0, double) f(4, hx, double)           \
  f(5, hy, double) f(6, speed, double) f(7, way, double) f(8, walked, double)                  \
  f(9, hold_left, double) f(10, fx, double) f(11, fy, double)
#define WHOLE_COLUMNS(f)                                                                       \
  f(0, mode, int) f(1, piece, int) f(2, direction, int) f(3, hold, int) f(4, wait, int)        \
  f(5, side, int) f(6, round_ticks, int) f(7, back_left, int) f(8, clip, int)                  \
  f(9, clip_since, int) f(10, blocked_by, int) f(11, turned, int) f(12, aside_left, int)       \
  f(13, pressed, int) f(14, claim, i64) f(15, claim0, i64) f(16, lent_left, int)       \
  f(17, turn_since, int)

struct Person {
#define HOLD_COLUMN(k, name, type) type name;
  REAL_COLUMNS(HOLD_COLUMN)
  WHOLE_COLUMNS(HOLD_COLUMN)
};
#define COUNT_COLUMN(k, name, type) +1
static_assert(0 REAL_COLUMNS(COUNT_COLUMN) == REALS, "reach.py has other real columns");
static_assert(0 WHOLE_COLUMNS(COUNT_COLUMN) == WHOLES, "reach.py has other whole columns");

// A route: its own rows of `Routes`.
struct Route {
  const double *points;  // [N, 7]
  const double *holds;   // [K, 4]
  double speed, length;
  int last;   // piece
  int stops;  // K
  int after, behaviour, patience, right;
};

// How long a tick is.
struct Pace {
  double seconds, cos, sin;
  int rate, parts;
};

// Who is around one person, by last tick's places and claims; person j is at j * LANES.
struct Around {
  const double *x0, *y0;
  const i64 *claims;  // ~claim of who stands or sits
  double agent_x, agent_y;
  double agent_radius, radius;  // m, of the agent and of people
  int count, p;                 // people, and who is looking
  u32 near;                     // who is looked at, see `find_near`
};

// As Numba has them: which zero is kept shows in the bits.
__device__ __forceinline__ double least_of(double a, double b) { return b < a ? b : a; }
__device__ __forceinline__ double most_of(double a, double b) { return b > a ? b : a; }

__device__ __forceinline__ const double *point_of(const Route &r, int k) { return r.points + 7 * k; }

// Where somebody is, seen from (x, y), and the sum of radii; -1 is the agent.
__device__ __forceinline__ void see(const Around &a, int j, double x, double y, double &dx,
                                    double &dy, double &reach) {
  if (j < 0) {
    dx = a.agent_x - x;
    dy = a.agent_y - y;
    reach = a.radius + a.agent_radius;
  } else {
    dx = a.x0[j * LANES] - x;
    dy = a.y0[j * LANES] - y;
    reach = 2.0 * a.radius;
  }
}

// Cosine and sine of so much of the arc of a tick, along its chord. These two are called, not
// written out where they are wanted: roots and quotients are long, and code must come from somewhere.
__device__ __noinline__ double2 share_arc(double cos, double sin, double share) {
  cos = 1.0 - share + share * cos;
  sin = share * sin;
  double size = sqrt(cos * cos + sin * sin);
  return make_double2(cos / size, sin / size);
}

// A unit vector turned.
__device__ __noinline__ double2 turn_vector(double hx, double hy, double cos, double sin) {
  double nx = hx * cos - hy * sin, ny = hx * sin + hy * cos;
  double size = sqrt(nx * nx + ny * ny);
  return make_double2(nx / size, ny / size);
}

// Turn towards a unit vector, by as much as a body may; the cosine that is left.
__device__ __forceinline__ double turn_to(Person &q, const Pace &pace, double tx, double ty,
                                          double seconds) {
  double hx = q.hx, hy = q.hy;
  if (hx == tx && hy == ty) return 1.0;
  double cosine = hx * tx + hy * ty;
  double cos = pace.cos, sin = pace.sin;
  if (seconds < pace.seconds) {
    double2 arc = share_arc(cos, sin, seconds / pace.seconds);
    cos = arc.x;
    sin = arc.y;
  }
  if (cosine >= cos) {
    q.hx = tx;
    q.hy = ty;
    return 1.0;
  }
  if (hx * ty - hy * tx < 0.0) sin = -sin;
  double2 turned = turn_vector(hx, hy, cos, sin);
  q.hx = turned.x;
  q.hy = turned.y;
  return turned.x * tx + turned.y * ty;
}

// Fastest speed after a tick that still brakes to `after` [m/s] within `room` [m].
__device__ __forceinline__ double cap_speed(double v, double after, double room, double dt) {
  double half = 0.5 * BRAKE * dt;
  double inside = half * half + after * after + 2.0 * BRAKE * room - BRAKE * dt * v;
  return inside > 0.0 ? most_of(sqrt(inside) - half, 0.0) : 0.0;
}

// Whose bodies are nearer than `gap` [m], in bits: 1 the agent, 2 << j person j. What is farther
// costs time and changes nothing, as in reach.py.
__device__ __forceinline__ u32 find_near(const Around &a, double x, double y, double gap) {
  double dx = a.agent_x - x, dy = a.agent_y - y, reach = a.radius + a.agent_radius + gap;
  u32 near = dx * dx + dy * dy < reach * reach ? 1u : 0u;
  reach = 2.0 * a.radius + gap;
  reach = reach * reach;
#pragma unroll 4  // nobody's place waits for another's
  for (int j = 0; j < a.count; j++) {
    double ox = a.x0[j * LANES] - x, oy = a.y0[j * LANES] - y;
    if (ox * ox + oy * oy < reach) near |= 2u << j;
  }
  return near & ~(2u << a.p);
}

// Share of the step from (x, y) to (nx, ny) that half of every gap allows, 1 all; and who allows least.
__device__ __forceinline__ double share_allowed(double x, double y, const Around &a, double nx,
                                                double ny, int &who) {
  double sx = nx - x, sy = ny - y, share = 1.0;
  who = NOBODY;
#pragma unroll 1
  for (u32 near = a.near; near; near &= near - 1) {
    int j = __ffs((int)near) - 2;
    double dx, dy, reach;
    see(a, j, x, y, dx, dy, reach);
    double square = dx * dx + dy * dy, seen = reach + 0.5;
    if (square > seen * seen) continue;
    double along = sx * dx + sy * dy;
    if (along <= 0.0) continue;
    double apart = sqrt(square);
    if (apart <= 0.0) {
      who = j;
      return 0.0;
    }
    double gap = apart - reach - SAFE_GAP;
    along = along / apart;
    double half = 0.5 * gap;
    if (along > half) {
      double part = half > 0.0 ? half / along : 0.0;
      if (part < share) {
        share = part;
        who = j;
      }
    }
  }
  return share;
}

// The piece of a path that a way is on.
__device__ __forceinline__ int piece_at(const Route &r, double way, int piece) {
  int k = piece;
#pragma unroll 1
  while (k < r.last && way >= point_of(r, k + 1)[4]) k++;
#pragma unroll 1
  while (k > 0 && way < point_of(r, k)[4]) k--;
  return k;
}

// A place on a path.
struct Spot {
  double x, y, tx, ty;
  int piece;
};

// (x, y) of a way along a path, the piece that it is on, and its tangent.
__device__ __forceinline__ Spot place_at(const Route &r, double way, int piece) {
  int k = piece_at(r, way, piece);
  const double *point = point_of(r, k);
  double left = way - point[4], tx = point[2], ty = point[3];
  Spot found = {point[0] + tx * left, point[1] + ty * left, tx, ty, k};
  return found;
}

// Way [m] until somebody, on the path from `way` on, at most `reach`; and who it is.
__device__ __forceinline__ double room_ahead(const Around &a, const Route &r, double way,
                                             int piece, int sign, double reach, int &who) {
  double gone = 0.0;
  who = NOBODY;
#pragma unroll 1
  while (gone < reach && a.near) {
    double at = way + sign * gone;
    if (at > r.length) {
      if (r.after != LOOP) break;
      at -= r.length;
      piece = 0;
    } else if (at < 0.0) {
      if (r.after != LOOP) break;
      at += r.length;
      piece = r.last;
    }
    Spot s = place_at(r, at, piece);
    piece = s.piece;
    double tx = sign * s.tx, ty = sign * s.ty, best = reach;
#pragma unroll 1
    for (u32 near = a.near; near; near &= near - 1) {
      int j = __ffs((int)near) - 2;
      double dx, dy, body;
      see(a, j, s.x, s.y, dx, dy, body);
      body = body + 0.02;
      double along = dx * tx + dy * ty, aside = dx * ty - dy * tx;
      double under = body * body - aside * aside;
      if (along <= 0.0 || under <= 0.0) continue;
      double room = along - sqrt(under);
      if (room < SAMPLE) {  // of this sample's own; what is farther, later ones find
        double found = gone + most_of(room, 0.0);
        if (found < best) {
          best = found;
          who = j;
        }
      }
    }
    if (who != NOBODY) return best;
    gone += SAMPLE;
  }
  return reach;
}

// Where walls are.
struct Ground {
  const Episode *episode;
  const u8 *walls;
  double x, y, per;  // of the map: its origin [m], cells a metre
  int rows, cols;
};

__device__ __forceinline__ Ground ground_of(const Episode &e) {
  Ground g = {&e, e.walls, e.x, e.y, 1.0 / e.resolution, e.rows, e.cols};
  return g;
}

// Number of the cell of a place, -1 beyond the map, as reach.py divides.
__device__ __noinline__ int find_cell(const Episode *e, double x, double y) {
  i64 col = (i64)floor((x - e->x) / e->resolution), row = (i64)floor((y - e->y) / e->resolution);
  if (row < 0 || col < 0 || row >= e->rows || col >= e->cols) return -1;
  return (int)(row * e->cols + col);
}

#define UNSURE 1e-6  // cells: a product and a quotient of numbers below 1e6 are nearer by far

// The same by a product, which is quicker; `sure` turns false where it may be another cell's.
__device__ __forceinline__ int guess_cell(const Ground &g, double x, double y, bool &sure) {
  double u = (x - g.x) * g.per, v = (y - g.y) * g.per;
  double left = floor(u), low = floor(v), a = u - left, b = v - low;
  sure = sure && fabs(u) < 1e6 && fabs(v) < 1e6 && a > UNSURE && a < 1.0 - UNSURE && b > UNSURE &&
         b < 1.0 - UNSURE;
  int col = sure ? (int)left : -1, row = sure ? (int)low : -1;
  return row >= 0 && col >= 0 && row < g.rows && col < g.cols ? row * g.cols + col : -1;
}

// Whether a person's centre may be at all of some places, as far as walls go. None waits for another.
template <int N>
__device__ __forceinline__ bool are_free(const Ground &g, const double *x, const double *y) {
  int cells[N];
  bool sure = true, inside = true;
#pragma unroll
  for (int k = 0; k < N; k++) cells[k] = guess_cell(g, x[k], y[k], sure);
  if (!sure) {
#pragma unroll
    for (int k = 0; k < N; k++) cells[k] = find_cell(g.episode, x[k], y[k]);
  }
  u8 walls = 0;
#pragma unroll
  for (int k = 0; k < N; k++) {
    inside = inside && cells[k] >= 0;
    walls |= g.walls[cells[k] < 0 ? 0 : cells[k]];
  }
  return inside && !(walls & WALL_NEAR);
}

__device__ __forceinline__ bool is_free(const Ground &g, double x, double y) {
  return are_free<1>(g, &x, &y);
}

// Whether five places of a short line are free of walls.
__device__ __forceinline__ bool clear_line(const Ground &g, double x, double y, double u, double v) {
  double xs[5], ys[5];
#pragma unroll
  for (int k = 0; k < 5; k++) {
    xs[k] = x + (u - x) * (0.2 * (k + 1));
    ys[k] = y + (v - y) * (0.2 * (k + 1));
  }
  return are_free<5>(g, xs, ys);
}

// Least gap [m] to anybody near from a place.
__device__ __forceinline__ double gap_at(const Around &a, double x, double y) {
  double least = SIGHT;
#pragma unroll 1
  for (u32 near = a.near; near; near &= near - 1) {
    double dx, dy, body;
    see(a, __ffs((int)near) - 2, x, y, dx, dy, body);
    double square = dx * dx + dy * dy;
    if (square < (least + body) * (least + body)) least = sqrt(square) - body;
  }
  return least;
}
