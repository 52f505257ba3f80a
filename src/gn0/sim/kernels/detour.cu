// Round whoever stands in the way: gn0/people/detour.py, function by function.

#define PARTS 3

// Rare things are functions of their own, so that who walks on its path takes no registers for them.

// The side with more free places beside the way ahead: 1 left, -1 right; right of equals.
__device__ __noinline__ int choose_side(double x, double y, const Episode &e, const Around &a,
                                        double tx, double ty) {
  int best = -1, side = -1;
#pragma unroll 1
  for (int s = -1; s <= 1; s += 2) {
    int free = 0;
#pragma unroll 1
    for (int k = 1; k < 4; k++)
#pragma unroll 1
      for (int b = 0; b < 4; b++) {
        double qx = x + tx * 0.3 * b - s * ty * 0.25 * k;
        double qy = y + ty * 0.3 * b + s * tx * 0.25 * k;
        if (!is_free(e, qx, qy)) break;
        if (gap_at(a, qx, qy) > ROOM) free++;
      }
    if (free > best) {
      best = free;
      side = s;
    }
  }
  return side;
}

// Nearest point of the path to (x, y), from `way` up to 3 m on: its way, distance, piece.
__device__ __forceinline__ double nearest_way(const Route &r, double way, int piece, int sign,
                                              double x, double y, double &distance, int &where) {
  double best = 1e30, found = way, gone = 0.0;
  where = piece;
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

// Whether five places of a short line are free of walls.
__device__ __forceinline__ bool clear_line(const Episode &e, double x, double y, double u, double v) {
#pragma unroll 1
  for (int k = 1; k < 6; k++)
    if (!is_free(e, x + (u - x) * (0.2 * k), y + (v - y) * (0.2 * k))) return false;
  return true;
}

// A tick away from everybody, where there is room; (mx, my) on the path is kept in sight.
__device__ __noinline__ void make_room(Person &q, const Episode &e, const Pace &pace,
                                       const Around &a, double mx, double my) {
  // cosines and sines of 0, 30, ... 180 degrees
  const double cosines[7] = {1.0, 0.8660254037844386, 0.5, 0.0, -0.5, -0.8660254037844386, -1.0};
  const double sines[7] = {0.0, 0.5, 0.8660254037844386, 1.0, 0.8660254037844386, 0.5, 0.0};
  double x = q.x0, y = q.y0, v = q.speed, dt = pace.seconds;
  double now = least_of(v + ACCELERATION * dt * 0.875, 0.5);
  double step = 0.5 * (v + now) * dt;
  double here = gap_at(a, x, y) + 0.01;
  if (here > ENOUGH) {
    q.aside_left = 0;
    q.speed = 0.0;
    return;
  }
  bool sees = clear_line(e, x, y, mx, my);
  double best = -1e30, bx = 0.0, by = 0.0;
  int who;
#pragma unroll 1
  for (int turn = -5; turn < 7; turn++) {  // twelve directions of the plane
    double ux = cosines[turn < 0 ? -turn : turn], uy = sines[turn < 0 ? -turn : turn];
    if (turn < 0) uy = -uy;
    if (!is_free(e, x + ux * 0.1, y + uy * 0.1)) continue;
    if (!is_free(e, x + ux * 0.2, y + uy * 0.2)) continue;
    if (!is_free(e, x + ux * step, y + uy * step)) continue;
    if (share_allowed(q, a, x + ux * SHUFFLE, y + uy * SHUFFLE, who) < 1.0) continue;
    double clear = gap_at(a, x + ux * 0.2, y + uy * 0.2);
    double score = clear + STEADY * (ux * q.hx + uy * q.hy);
    if (clear > here && score > best &&
        (!sees || clear_line(e, x + ux * 0.2, y + uy * 0.2, mx, my))) {
      best = score;
      bx = ux;
      by = uy;
    }
  }
  q.speed = 0.0;
  if (bx == 0.0 && by == 0.0) {
    q.aside_left = 0;
    return;
  }
  if (turn_to(q, pace, bx, by, pace.seconds) < SIDEWAYS) return;
  double nx = x + bx * step, ny = y + by * step;
  if (share_allowed(q, a, nx, ny, who) >= 1.0) {
    q.x = nx;
    q.y = ny;
    q.speed = now;
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
  if (r.after != LOOP && (sign > 0 ? q.way <= 0.0 : q.way >= r.length)) {
    q.aside_left = r.patience;  // at its very end there is no way back
    return;
  }
  q.direction = -sign;
  if (sign > 0 && r.after != BACK) q.back_left = BACK_SECONDS * pace.rate + r.patience;
}

// A tick beside the path, around whoever is on it.
__device__ __noinline__ void go_round(Person &q, const Route &r, const Episode &e,
                                      const Pace &pace, Around &a) {
  // cosines and sines of 0, 20, ... 120 degrees, and which of them are tried, the straightest first
  const double cosines[7] = {1.0, 0.9396926207859084, 0.766044443118978, 0.5, 0.17364817766693033,
                             -0.17364817766693033, -0.5};
  const double sines[7] = {0.0, 0.3420201433256687, 0.6427876096865393, 0.8660254037844386,
                           0.984807753012208, 0.984807753012208, 0.8660254037844386};
  const int turns[13] = {0, 1, -1, 2, -2, 3, 4, 5, 6, -3, -4, -5, -6};
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
  double aside;
  int piece;
  if (q.round_ticks > ROUND_SECONDS * pace.rate || q.wait > NO_WAY_SECONDS * pace.rate) {
    nearest_way(r, q.way, q.piece, q.direction, x, y, aside, piece);
    turn_back(q, r, pace, a, aside);
  }
  int sign = q.direction, side = q.side;
  double way = nearest_way(r, q.way, q.piece, sign, x, y, aside, piece);
  Spot home = place_at(r, way, piece);
  if (q.aside_left > 0) {
    a.near = find_near(a, x, y, 1.2);
    make_room(q, e, pace, a, home.x, home.y);
    return;
  }
  q.way = way;
  q.piece = piece;
  double fastest = least_of(ROUND_SPEED, r.speed);
  double now = least_of(v + ACCELERATION * dt * 0.875, fastest);
  double step = 0.5 * (v + now) * dt;
  double bx = 0.0, by = 0.0, best = -1e30;
  int who;
  a.near = find_near(a, x, y, 1.0);
  if (aside <= HOME) {
    room_ahead(a, r, way, piece, sign, 0.6, who);
    Spot s = place_at(r, way, piece);
    double nx = s.x, ny = s.y;
    piece = s.piece;
    if (who == NOBODY && clear_line(e, x, y, nx, ny)) {
      bool near = aside <= step + 0.005;
      double ux = 0.0, uy = 0.0;
      if (!near) {
        ux = (nx - x) / aside;
        uy = (ny - y) / aside;
        nx = x + ux * step;
        ny = y + uy * step;
      }
      double share = share_allowed(q, a, nx, ny, who);
      bool free = near || is_free(e, nx, ny);
      if (share >= 1.0 && free && (near || aside <= SHUFFLE)) {
        q.x = nx;
        q.y = ny;
        q.speed = near ? aside / dt : now;
        turn_to(q, pace, sign * s.tx, sign * s.ty, pace.seconds);
        if (near) come_home(q, r, way, piece);
        return;
      }
      if (share >= 1.0 && free) {
        bx = ux;
        by = uy;
        best = 1.0;
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
  double here = gap_at(a, x, y);
  bool squeezes = q.turned % 4 > 1;
  double space = squeezes ? SQUEEZE : ROOM;
#pragma unroll 1
  for (int t = 0; t < (squeezes ? 13 : FEW_TURNS); t++) {
    if (best == 1.0) break;  // the path itself, near by and free
    int turn = turns[t];
    double cos = cosines[turn < 0 ? -turn : turn];
    double sin = turn >= 0 ? sines[turn] * side : -sines[-turn] * side;
    double ux = dx * cos - dy * sin, uy = dx * sin + dy * cos;
    double score = cos + 0.3 * (ux * q.hx + uy * q.hy);
    if (score <= best) continue;
    double reach = size > 0.35 ? 0.35 : size;
    bool ok = true;
    double qx, qy;
#pragma unroll 1
    for (int k = 0; ok && k < PARTS; k++) {
      double part = k == 0 ? 0.34 : k == 1 ? 0.67 : 1.0;
      qx = x + ux * reach * part;
      qy = y + uy * reach * part;
      if (!is_free(e, qx, qy)) {
        ok = false;
        break;
      }
      double clear = gap_at(a, qx, qy);
      if (clear < space && clear < here + 0.2 * reach * part) ok = false;
    }
    if (ok && !is_free(e, x + ux * step, y + uy * step)) ok = false;
    if (ok && !squeezes)  // whence one sees the path, one comes back to it
      ok = clear_line(e, qx, qy, ahead.x, ahead.y) || clear_line(e, qx, qy, home.x, home.y);
    if (ok) {
      best = score;
      bx = ux;
      by = uy;
    }
  }
  if (best < -1e29) {
    q.wait++;
    q.speed = 0.0;
    turn_to(q, pace, dx, dy, pace.seconds);
    return;
  }
  if (turn_to(q, pace, bx, by, pace.seconds) < SIDEWAYS) {
    q.speed = 0.0;
    return;
  }
  double nx = x + bx * step, ny = y + by * step;
  double share = share_allowed(q, a, nx, ny, who);
  if (share < 1.0) {
    q.blocked_by = who;
    now = 0.0;
    q.wait++;
    share = share * 0.999;
    nx = x + bx * step * share;
    ny = y + by * step * share;
    if (!is_free(e, nx, ny)) {
      nx = x;
      ny = y;
    }
  }
  q.x = nx;
  q.y = ny;
  q.speed = now;
}
