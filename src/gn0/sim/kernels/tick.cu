// One tick of one person: gn0/people/tick.py, function by function.

// Stand at a stop for so long, or begin to; the seconds that are left after it.
__device__ __forceinline__ double hold_on(Person &q, const Route &r, const Pace &pace, double seconds) {
#pragma unroll 1
  while (seconds > 0.0) {
    const double *stop = r.holds + 4 * q.hold;
    if (q.hold_left <= 0.0) {
      if (q.hold >= r.stops || q.way < stop[0] - CLOSE) break;
      q.hold_left = stop[1];
    }
    double use = least_of(q.hold_left, seconds);
    turn_to(q, pace, stop[2], stop[3], use);
    q.hold_left -= use;
    seconds -= use;
    if (q.hold_left <= 1e-9) {
      q.hold_left = 0.0;
      q.hold++;
    }
    if (seconds < 1e-9) seconds = 0.0;
  }
  return seconds;
}

// Walk, turn or stand on the path for a part of a tick, `ahead` [m] of it being free.
__device__ __forceinline__ double advance(Person &q, const Route &r, const Pace &pace, double dt,
                                          double ahead) {
  int sign = q.direction;
  double way = q.way, v = q.speed, length = r.length;
  // who came here backwards, over the seam of a loop, is past these
  while (sign > 0 && q.hold < r.stops && r.holds[4 * q.hold] < way - 0.01) q.hold++;
  bool holds = sign > 0 && q.hold < r.stops;
  if (q.hold_left > 0.0 || (holds && way >= r.holds[4 * q.hold] - CLOSE && v < 0.09)) {
    q.speed = v = 0.0;
    dt = hold_on(q, r, pace, dt);
    if (dt <= 0.0) return 0.0;
    holds = q.hold < r.stops;
  }
  int hold = q.hold;
  if (sign > 0 && way >= length) {
    if (r.after == LOOP) {
      way = way - length;
      q.piece = 0;
      q.hold = hold = 0;
      holds = hold < r.stops;
    } else if (r.after == BACK) {
      q.direction = sign = -1;
      holds = false;
    } else {
      q.mode = ARRIVED;
      q.speed = 0.0;
      return 0.0;
    }
  } else if (sign < 0 && way <= 0.0 && r.after == BACK) {
    q.direction = sign = 1;
    q.hold = hold = 0;
    holds = hold < r.stops;
  } else if (sign < 0 && way <= 0.0 && r.after == LOOP) {
    way = way + length;
    q.piece = r.last;
  } else if (sign < 0 && way <= 0.0) {  // turned back to the very start
    q.direction = 1;
    q.back_left = 0;
    q.speed = 0.0;
    return 0.0;
  }
  int piece = piece_at(r, way, q.piece);
  if (sign < 0 && piece > 0 && way <= point_of(r, piece)[4])
    piece--;  // at a point that one walks away from backwards
  double tx = sign * point_of(r, piece)[2], ty = sign * point_of(r, piece)[3];
  double before = q.hx * tx + q.hy * ty;
  double aligned = turn_to(q, pace, tx, ty, dt);
  double want = aligned >= ALIGNED ? r.speed : 0.0;
  if (before < ALIGNED && ALIGNED <= aligned)  // who comes to face its way goes for what is left
    dt = dt * ((aligned - ALIGNED) / (aligned - before));
  // bends: the next points
  int points = r.last + 2;
#pragma unroll 1
  for (int k = sign > 0 ? piece + 1 : piece; 0 <= k && k < points; k += sign) {
    const double *point = point_of(r, k);
    double room = sign * (point[4] - way);
    if (room > 0.0) {
      double limit = sign > 0 ? point[5] : point[6];
      if (0.5 * (v + limit) * dt < room) {  // limits there are such that all later ones are kept
        want = least_of(want, cap_speed(v, limit, room, dt));
        break;
      }
      want = least_of(want, limit);  // passed by then
    }
  }
  double end = sign > 0 ? length : 0.0;
  if (holds) end = r.holds[4 * hold];
  bool stands = holds || r.after != LOOP;
  double left = most_of(sign * (end - way), 0.0);
  if (stands) want = least_of(want, cap_speed(v, 0.0, left, dt));
  if (ahead < SIGHT) want = least_of(want, cap_speed(v, 0.0, most_of(ahead - COMFORT, 0.0), dt));
  double now = least_of(want, v + ACCELERATION * dt * 0.875);
  now = most_of(most_of(now, v - ACCELERATION * dt), 0.0);
  double step = 0.5 * (v + now) * dt;
  double there = way + sign * step, spare = 0.0;
  if (stands && step >= left - CLOSE) {
    step = left;
    there = end;
    now = most_of(v - ACCELERATION * dt, 0.0);
    if (v + now > 0.0) spare = most_of(dt - 2.0 * step / (v + now), 0.0);
  } else if (sign > 0 && there > length) {  // around a loop again
    there = there - length;
    q.hold = 0;
    piece = 0;
  } else if (there < 0.0) {
    there = there + length;
    piece = r.last;
  }
  q.way = there;
  q.speed = now;
  int after = piece_at(r, there, piece);
  q.piece = after;
  if (spare > 0.0 && now <= 0.0 && there == end) {
    if (holds) hold_on(q, r, pace, spare);
    else if (r.after == BACK) turn_to(q, pace, -tx, -ty, spare);
  } else if (after != piece && now > 0.0) {
    tx = sign * point_of(r, after)[2];
    ty = sign * point_of(r, after)[3];
    if (q.hx * tx + q.hy * ty < ALIGNED) {
      // a sharp bend: turn for what is left of the time after it
      double bend = sign * (there - point_of(r, sign > 0 ? after : after + 1)[4]);
      turn_to(q, pace, tx, ty, least_of(most_of(bend, 0.0) / now, dt));
    }
  }
  return step;
}

// A tick straight on at full speed, where nothing else is to be done; whether it was.
__device__ __forceinline__ bool cruise(Person &q, const Route &r, const Pace &pace) {
  double v = q.speed;
  if (v != r.speed || q.hold_left > 0.0) return false;
  int sign = q.direction;
  double way = q.way;
  const double *point = point_of(r, q.piece), *next = point + 7;
  double tx = sign * point[2], ty = sign * point[3];
  if (q.hx != tx || q.hy != ty) return false;
  double step = v * pace.seconds;
  double room = sign > 0 ? next[4] - way : way - point[4];
  double limit = sign > 0 ? next[5] : point[6];
  if (room <= step || limit * limit + 2.0 * BRAKE * (room - step) < v * v) return false;
  if (sign > 0 && q.hold < r.stops) {
    room = r.holds[4 * q.hold] - way;
    if (room <= step || 2.0 * BRAKE * (room - step) < v * v) return false;
  }
  q.way = way = way + sign * step;
  double left = way - point[4];
  q.x = point[0] + point[2] * left;
  q.y = point[1] + point[3] * left;
  q.wait = 0;
  q.blocked_by = NOBODY;
  return true;
}

// Whether somebody has the right of way over a person, as of a tick ago.
__device__ __forceinline__ bool yields_to(const Person &q, const Around &a, int who) {
  if (who < 0) return false;
  i64 claim = a.claims[who * LANES];
  return (claim < 0 ? ~claim : claim) > q.claim0;
}

// A tick on the path.
__device__ __forceinline__ void go_on(Person &q, const Route &r, const Pace &pace,
                                      Around &a, Task &t) {
  int sign = q.direction, piece = q.piece, held = q.hold, mode = q.mode;
  double way = q.way, hold_left = q.hold_left, v = q.speed;
  double ahead = SIGHT;
  int blocker = NOBODY;
  double reach = least_of(0.5 + v * v / (2.0 * BRAKE) + 0.25, SIGHT - 0.01);
  a.near = 0;
  if (mode == ON_PATH && hold_left <= 0.0) {
    a.near = find_near(a, q.x0, q.y0, reach + 0.1);
    if (a.near == 1 && a.agent_radius > a.radius) {  // by its middle, as people are
      double dx = a.agent_x - q.x0, dy = a.agent_y - q.y0, within = reach + 2.0 * a.radius + 0.1;
      if (dx * dx + dy * dy >= within * within) a.near = 0;
    }
  }
  bool near = a.near != 0;
  if (near) {
    ahead = room_ahead(a, r, way, piece, sign, reach, blocker);
    if (blocker == NOBODY) ahead = SIGHT;
    else if (yields_to(q, a, blocker)) ahead = most_of(ahead - LEAVE, 0.0);
  }
  double gone = 0.0;
  // by the same sums as with nobody near, so that only who is in the way changes a bit
  double room = ahead - COMFORT - v * pace.seconds;
  bool clear = blocker == NOBODY || (room > 0.0 && 2.0 * BRAKE * room >= v * v);
  if (clear && v > 0.0 && cruise(q, r, pace)) {
    int who;
    if (!near || share_allowed(q.x0, q.y0, a, q.x, q.y, who) >= 1.0) return;
    q.way = way;
    q.x = q.x0;
    q.y = q.y0;
  }
#pragma unroll 1
  for (int part = 0; part < pace.parts; part++) {
    if (q.mode == ARRIVED) break;
    gone += advance(q, r, pace, pace.seconds / pace.parts, ahead < SIGHT ? ahead - gone : ahead);
  }
  Spot s = place_at(r, q.way, q.piece);
  if (near && gone > 0.0) {
    int who;
    double share = share_allowed(q.x0, q.y0, a, s.x, s.y, who);
    if (share < 1.0) {  // less of the way, as if the tick had brought no more
      blocker = who;
      gone = gone * share * 0.999;
      double there = way + sign * gone;
      if (!(0.0 <= there && there <= r.length) || q.direction != sign) {
        gone = 0.0;
        there = way;
      }
      s = place_at(r, there, piece);
      share = share_allowed(q.x0, q.y0, a, s.x, s.y, who);
      if (share < 1.0) {
        gone = 0.0;
        there = way;
        s = place_at(r, way, piece);
      }
      if (q.direction == sign) q.hold = held;
      sign = q.direction;
      q.mode = mode;
      q.hold_left = hold_left;
      q.piece = s.piece;
      q.way = there;
      q.speed = gone / pace.seconds;
    }
  }
  if (gone > 0.0) {
    q.x = s.x;
    q.y = s.y;
  }
  q.blocked_by = blocker;
  if (blocker != NOBODY && gone < MOVED * pace.seconds) {
    q.wait++;
    if (q.wait > (yields_to(q, a, blocker) ? r.patience / 2 : r.patience)) {
      q.mode = ROUND;
      q.round_ticks = 0;
      q.wait = 0;
      a.near = find_near(a, q.x0, q.y0, 1.2 + ROOM);
      q.speed = 0.0;
      t.x = q.x;
      t.y = q.y;
      t.ux = sign * s.tx;
      t.uy = sign * s.ty;
      t.kind = SIDES;
      t.count = 6;
    }
  } else {
    q.wait = 0;
  }
}

// Which way feet stand after a tick that began with a heading; decides on nothing but looks.
__device__ __forceinline__ void place_feet(Person &q, double hx, double hy) {
  double x = q.hx, y = q.hy;
  if (q.clip == WALK) {
    if (q.clip_since >= PIVOT_LAG) {
      q.fx = x;
      q.fy = y;
      q.turn_since = SETTLE;
    }
    return;
  }
  if (x != hx || y != hy) {
    if (q.turn_since >= SETTLE / 2) {
      q.fx = hx;
      q.fy = hy;
    }
    q.turn_since = 0;
  } else if (q.turn_since < SETTLE) {
    q.turn_since++;
    if (q.turn_since == SETTLE) {
      q.fx = x;
      q.fy = y;
    }
  }
  double fx = q.fx, fy = q.fy;
#pragma unroll 1
  for (int k = 0; k < 4; k++) {
    if (fx * x + fy * y > PIVOT_COS) break;
    double side = fx * y - fy * x >= 0.0 ? PIVOT_COS : -PIVOT_COS;
    double2 turned = turn_vector(fx, fy, PIVOT_COS, side);
    q.fx = fx = turned.x;
    q.fy = fy = turned.y;
  }
}

// One person's next tick, up to a choice that `t` tells of; its own last place is set already.
__device__ __forceinline__ void begin_tick(Person &q, const Route &r, const Episode &e,
                                           const Pace &pace, Around &a, Task &t) {
  t.kind = NO_TASK;
  if (r.behaviour != SCRIPT) return;
  q.blocked_by = NOBODY;
  if (q.back_left > 0) {
    q.back_left--;
    if (q.back_left == 0 && q.mode == ON_PATH) q.direction = 1;
    else if (q.back_left == 0) q.back_left = 1;
  }
  if (q.lent_left > 0) {
    q.lent_left--;
    if (q.lent_left == 0) q.claim = r.right;
  }
  if (q.mode == ROUND) {
    Person copy = q;  // whose address is taken lies in memory: not the one in registers
    go_round(copy, r, e, pace, a, t);
    q = copy;
  } else {
    go_on(q, r, pace, a, t);
  }
  t.near = a.near;
  t.p = a.p;
  t.episode = &e;
}

// What a tick was for looks, of one that began with a heading.
__device__ __forceinline__ void end_tick(Person &q, const Route &r, const Pace &pace, double hx,
                                         double hy) {
  int was = q.clip;
  if (r.behaviour == SCRIPT) {
    double dx = q.x - q.x0, dy = q.y - q.y0;
    double gone = sqrt(dx * dx + dy * dy);
    q.walked += gone;
    q.clip = gone > MOVED * pace.seconds ? WALK : STILL;
  }
  if (q.clip != was) q.clip_since = 0;
  else q.clip_since++;
  place_feet(q, hx, hy);
}
