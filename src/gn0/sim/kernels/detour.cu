// Round whoever stands in the way: gn0/people/detour.py, function by function.

// Rare things are functions of their own, so that who walks on its path takes no registers for them.

// Nearest point of the path to (x, y), from `way` up to 3 m on: its way, distance, piece.
__device__ __forceinline__ double nearest_way(const Route &r, double way, int piece, int sign,
                                              double x, double y, double &distance, int &where) {
  double best = 1e30, found = way, gone = 0.0;
  where = piece;
#pragma unroll 1
  for (int k = piece; 0 <= k && k <= r.last && gone < 3.0; k += sign) {
    const double *point = point_of(r, k);
    double low = point[4], high = point_of(r, k + 1)[4];
    if (sign > 0) low = most_of(low, way);
    else high = least_of(high, way);
    double tx = point[2], ty = point[3];
    double at = point[4] + (x - point[0]) * tx + (y - point[1]) * ty;
    at = least_of(most_of(at, low), high);
    double left = at - point[4];
    double dx = point[0] + tx * left - x, dy = point[1] + ty * left - y;
    double square = dx * dx + dy * dy;
    if (square < best) {
      best = square;
      found = at;
      where = k;
    }
    gone = sign > 0 ? high - way : way - low;
  }
  distance = sqrt(best);
  return found;
}

// Whether a person looks for room away from everybody: (mx, my) on the path is kept in sight.
__device__ __forceinline__ void look_for_room(Person &q, const Episode &e, const Pace &pace,
                                              Around &a, double mx, double my, Task &t) {
  t.x = q.x0;
  t.y = q.y0;
  a.near = find_near(a, t.x, t.y, 1.2);
  t.here = gap_at(a, t.x, t.y) + 0.01;
  if (t.here > ENOUGH) {
    q.aside_left = 0;
    q.speed = 0.0;
    return;
  }
  t.now = least_of(q.speed + ACCELERATION * pace.seconds * 0.875, 0.5);
  t.step = 0.5 * (q.speed + t.now) * pace.seconds;
  t.hx = q.hx;
  t.hy = q.hy;
  t.home_x = mx;
  t.home_y = my;
  t.kind = PLACES;
  t.count = 12;
}

// A tick away from everybody, where there is room.
__device__ __forceinline__ void make_room(Person &q, const Pace &pace, const Around &a,
                                          const Task &t, int found) {
  q.speed = 0.0;
  if (found < 0) {
    q.aside_left = 0;
    return;
  }
  double bx, by;
  turn_by_30(found, bx, by);
  if (turn_to(q, pace, bx, by, pace.seconds) < SIDEWAYS) return;
  double nx = t.x + bx * t.step, ny = t.y + by * t.step;
  int who;
  if (share_allowed(t.x, t.y, a, nx, ny, who) >= 1.0) {
    q.x = nx;
    q.y = ny;
    q.speed = t.now;
    q.aside_left--;
  } else {
    q.aside_left = 0;
  }
}

// Be on the path again; stops that were passed are left out.
__device__ __forceinline__ void come_home(Person &q, const Route &r, double way, int piece) {
  q.mode = ON_PATH;
  q.piece = piece;
  q.wait = 0;
  q.pressed = 0;
  while (q.hold < r.stops && r.holds[4 * q.hold] < way) q.hold++;
}

// The highest claim of anybody who disputes the way ahead, a tick ago; 0 where nobody does.
__device__ __forceinline__ i64 claim_ahead(const Person &q, const Around &a) {
  i64 most = 0;
#pragma unroll 1
  for (int j = -1; j < a.count; j++) {
    if (j == a.p) continue;
    double dx, dy, reach;
    see(a, j, q.x0, q.y0, dx, dy, reach);
    reach = reach + RIVAL;
    if (dx * q.hx + dy * q.hy <= 0.0 || dx * dx + dy * dy > reach * reach) continue;
    i64 claim = j < 0 || a.claims[j * LANES] < 0 ? 2 * FIRM : a.claims[j * LANES];
    most = claim > most ? claim : most;
  }
  return most;
}

// Yield to a higher claim ahead and walk back with it; who has the highest stays for a time.
__device__ __forceinline__ void turn_back(Person &q, const Route &r, const Pace &pace,
                                          const Around &a, double aside) {
  int sign = q.direction;
  i64 claim = claim_ahead(q, a);
  bool on_way = aside <= HOME;
  if (on_way && 0 < claim && claim <= q.claim0 && q.pressed < PRESS_SECONDS * pace.rate) {
    q.pressed++;
    return;
  }
  if (claim > q.claim0) {
    // who does not move has no claim to lend: one's own goes before all others then
    q.claim = claim == 2 * FIRM ? FIRM + r.right : claim;
    q.lent_left = BACK_SECONDS * pace.rate + r.patience;
  }
  if (q.wait > 0 && (!on_way || q.turned % 2 == 1)) q.aside_left = r.patience;
  q.wait = 0;
  q.pressed = 0;
  q.round_ticks = 0;
  q.side = -q.side;
  q.turned++;
  q.back_left = 0;
  if (r.after != LOOP && (sign > 0 ? q.way : r.length - q.way) <= (on_way ? LEAVE : 0.0)) {
    q.aside_left = r.patience;  // at its end there is no way back
    return;
  }
  q.direction = -sign;
  if (sign > 0 && r.after != BACK) q.back_left = BACK_SECONDS * pace.rate + r.patience;
}

// A tick beside the path in a direction (bx, by).
__device__ __noinline__ void walk_round(Person &q, const Episode &e, const Pace &pace,
                                        const Around &a, const Task &t, double bx, double by) {
  if (turn_to(q, pace, bx, by, pace.seconds) < SIDEWAYS) {
    q.speed = 0.0;
    return;
  }
  int who;
  double nx = t.x + bx * t.step, ny = t.y + by * t.step, now = t.now;
  double share = share_allowed(t.x, t.y, a, nx, ny, who);
  if (share < 1.0) {
    q.blocked_by = who;
    now = 0.0;
    q.wait++;
    share = share * 0.999;
    nx = t.x + bx * t.step * share;
    ny = t.y + by * t.step * share;
    if (!is_free(ground_of(e), nx, ny)) {
      nx = t.x;
      ny = t.y;
    }
  }
  q.x = nx;
  q.y = ny;
  q.speed = now;
}

// A tick beside the path, around whoever is on it: all of it, or up to a choice of directions.
__device__ __noinline__ void go_round(Person &q, const Route &r, const Episode &e,
                                      const Pace &pace, Around &a, Task &t) {
  double dt = pace.seconds, x = q.x0, y = q.y0, v = q.speed;
  bool loops = r.after == LOOP;
  q.round_ticks++;
  if (loops && q.direction > 0 && q.way >= r.length) {  // over the seam
    q.way = 0.0;
    q.piece = 0;
    q.hold = 0;
  } else if (loops && q.direction < 0 && q.way <= 0.0) {
    q.way = r.length;
    q.piece = r.last;
  }
  double aside, way;
  int piece;
  bool shut = q.wait >= NO_WAY_SECONDS * pace.rate;
  bool gives_up = q.round_ticks >= ROUND_SECONDS * pace.rate || shut;
#pragma unroll 1
  while (true) {
    way = nearest_way(r, q.way, q.piece, q.direction, x, y, aside, piece);
    if (!gives_up) break;
    if (!shut && q.round_ticks < ROUND_MOST * pace.rate) {
      int ahead;
      a.near = find_near(a, x, y, aside + 0.7);  // all who may be there
      room_ahead(a, r, way, piece, q.direction, 0.6, ahead);
      if (ahead == NOBODY) break;  // they who were in the way are gone
    }
    turn_back(q, r, pace, a, aside);
    gives_up = false;
  }
  int sign = q.direction;
  Spot home = place_at(r, way, piece);
  if (q.aside_left > 0) {
    look_for_room(q, e, pace, a, home.x, home.y, t);
    return;
  }
  q.way = way;
  q.piece = piece;
  double fastest = least_of(ROUND_SPEED, r.speed);
  double now = least_of(v + ACCELERATION * dt * 0.875, fastest);
  double step = 0.5 * (v + now) * dt;
  t.x = x;
  t.y = y;
  t.now = now;
  t.step = step;
  Ground g = ground_of(e);
  int who;
  a.near = find_near(a, x, y, 1.0);
  if (aside <= HOME) {
    room_ahead(a, r, way, piece, sign, 0.6, who);
    double nx = home.x, ny = home.y;
    piece = home.piece;
    if (who == NOBODY && clear_line(g, x, y, nx, ny)) {
      bool near = aside <= step + 0.005;
      double ux = 0.0, uy = 0.0;
      if (!near) {
        ux = (nx - x) / aside;
        uy = (ny - y) / aside;
        nx = x + ux * step;
        ny = y + uy * step;
      }
      double share = share_allowed(x, y, a, nx, ny, who);
      bool free = near || is_free(g, nx, ny);
      if (share >= 1.0 && free && (near || aside <= SHUFFLE)) {
        q.x = nx;
        q.y = ny;
        q.speed = near ? aside / dt : now;
        turn_to(q, pace, sign * home.tx, sign * home.ty, pace.seconds);
        if (near) come_home(q, r, way, piece);
        return;
      }
      if (share >= 1.0 && free) {  // the path itself, near by and free
        walk_round(q, e, pace, a, t, ux, uy);
        return;
      }
    }
  }
  double carrot = least_of(most_of(aside + 0.3, 0.4), 1.2);
  double at = way + sign * carrot;
  if (loops && at > r.length) at -= r.length;
  else if (loops && at < 0.0) at += r.length;
  at = least_of(most_of(at, 0.0), r.length);
  Spot ahead = place_at(r, at, piece);
  double dx = ahead.x - x, dy = ahead.y - y;
  double size = sqrt(dx * dx + dy * dy);
  if (size < 1e-6) {
    dx = q.hx;
    dy = q.hy;
  } else {
    dx = dx / size;
    dy = dy / size;
  }
  t.ux = dx;
  t.uy = dy;
  t.hx = q.hx;
  t.hy = q.hy;
  t.size = size;
  t.here = gap_at(a, x, y);
  t.squeezes = q.turned % 4 > 1;
  t.space = t.squeezes ? SQUEEZE : ROOM;
  t.side = q.side;
  t.ahead_x = ahead.x;
  t.ahead_y = ahead.y;
  t.home_x = home.x;
  t.home_y = home.y;
  t.kind = DIRECTIONS;
  t.count = t.squeezes ? CANDIDATES_MOST : FEW_TURNS;
}

// The rest of a tick whose choice is made.
__device__ __forceinline__ void do_chosen(Person &q, const Episode &e, const Pace &pace, Around &a,
                                       const Task &t, const double *scores) {
  if (t.kind == SIDES) {
    q.side = choose_side(scores);
    return;
  }
  int found = choose(t, scores);
  a.near = t.near;
  if (t.kind == PLACES) {
    make_room(q, pace, a, t, found);
  } else if (found < 0) {
    q.wait++;  // and stand as one stands: who waits does not turn to and fro
    q.speed = 0.0;
  } else {
    double cos, bx, by;
    turn_by_20(t, found, cos, bx, by);
    walk_round(q, e, pace, a, t, bx, by);
  }
}
