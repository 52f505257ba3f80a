// How people look: people/shown.py of all that stand around agents, as codes of posed clouds, poses
// and gains of instances. Only angles by `atan2`, a head's and that of feet, may differ from the host
// in their last bit: a look or a row of a turn is the next one where that falls on its edge.

// What a person of an episode brings to its looks; the layout of device_layout.ROLE.
struct Role {
  double stride;   // m, of its walk
  double forward;  // m, of who sits
  double lasts;    // s, of its gesture; 0 without
  double still;    // m, how far from its place its body is seen while it idles or turns
  double reach;    // m, in all other clips
  double shadow;   // m, how far its shadow on the floor is seen
  double stands[OUTLINE], walks[OUTLINE];  // m, how far its body reaches that idles, or walks
  double coarser[LEVELS_MOST];  // m, how much farther at each level of detail
  int number;      // of who it is
  int offset;      // ticks by which its time is ahead
  int gait;        // class of the walk
  int idle, idle_rows;
  int clip, clip_rows, clip_loops;  // of who stands or sits
  int clip_rowed;  // a frame of the clip is a row of it; not of a gesture
  int unused;
};
static_assert(sizeof(Role) == ROLE_BYTES, "device_layout.ROLE differs from Role");

#define CLIP_WALK 0   // number of the clip `walk`
#define CLIP_PIVOT 1  // of `pivot_left`; to the right is the next
#define CLIP_SETTLE 3
#define CLIP_NONE 63
#define STRAIGHT 2    // class of a look ahead
#define PHASES 64
#define FPS 30.0
#define CLIP_STEP 12
#define BLEND 4
#define PAUSE 5.0
#define RIGHT_SWINGS 0.33  // phase
#define STOOD_LEAST -48    // mm
#define STOOD_MOST 15
#define NEAR_EYE 2.5
#define SIDE_EYE 1.3
#define PIVOT 0.7853981633974483  // rad, 45 degrees
#define PIVOT_ROWS 60
#define SETTLE_ROWS 8
#define FLAT_SIDE 1e6  // slope of a side that is none
#define PROBE_CELL 0.5  // m, of the grid of probes

__device__ __forceinline__ int frame_at(double seconds) {
  return (int)(seconds * FPS) / CLIP_STEP * CLIP_STEP;
}

__device__ __forceinline__ int row_of(int frame, int rows, bool loops) {
  return loops ? frame % rows : min(frame, rows - 1);
}

// `_pivot` of people/shown.py: the row of a turn that who stands is in on feet that stand another
// way, and to which side; 0 where feet are under the body.
__device__ __forceinline__ int pivot_of(const Person &q, int &side) {
  double turned = atan2(q.fx * q.hy - q.fy * q.hx, q.fx * q.hx + q.fy * q.hy);
  side = turned < 0.0;
  return min((int)rint(fabs(turned) / PIVOT * PIVOT_ROWS), PIVOT_ROWS);
}

// Number of the class of looks nearest to a yaw [rad].
__device__ __forceinline__ int look_class(double yaw) {
  double degrees = yaw * (180.0 / 3.141592653589793), best = 1e9;
  int found = 0;
  for (int k = 0; k < 5; k++) {
    double away = fabs(degrees - (-60.0 + 30.0 * k));
    if (away < best) {
      best = away;
      found = k;
    }
  }
  return found;
}

// Whether no wall is between two places: `LightProbes._sees`.
__device__ bool sees_probe(const Episode &e, double x, double y, double u, double v) {
  int steps = (int)(fmax(fabs(u - x), fabs(v - y)) / e.resolution) + 1;
  double part = 1.0 / (double)steps;
  for (int k = 1; k <= steps; k++) {
    double t = k < steps ? k * part : 1.0;
    i64 col = (i64)floor((x + t * (u - x) - e.x) / e.resolution);
    i64 row = (i64)floor((y + t * (v - y) - e.y) / e.resolution);
    row = row < 0 ? 0 : row >= e.rows ? e.rows - 1 : row;
    col = col < 0 ? 0 : col >= e.cols ? e.cols - 1 : col;
    if (e.walls[row * e.cols + col] & WALL) return false;
  }
  return true;
}

// Colour gain [4, 3] of who stands at (x, y): `LightProbes.gain_at`.
__device__ void find_gain(const Episode &e, double x, double y, float *gain) {
  double u = (x - e.x) / PROBE_CELL - 0.5, v = (y - e.y) / PROBE_CELL - 0.5;
  int a = (int)floor(u), b = (int)floor(v), found = 0, columns[4];
  double shares[4], total = 0.0;
  for (int k = 0; k < 4; k++) {
    int i = a + (k & 1), j = b + (k >> 1);
    if (i < 0 || j < 0 || i >= e.light_cols || j >= e.light_rows) continue;
    int number = e.light_column[(i64)i * e.light_rows + j];
    double share = (1.0 - fabs(u - i)) * (1.0 - fabs(v - j));
    if (number < 0 || share <= 1e-6) continue;
    const double *place = e.light_places + 2 * number;
    if (!sees_probe(e, x, y, place[0], place[1])) continue;
    columns[found] = number;
    shares[found++] = share;
    total += share;
  }
  if (!found) {
    double best = (double)INFINITY;
    for (int k = 0; k < e.light_count; k++) {
      double dx = e.light_places[2 * k] - x, dy = e.light_places[2 * k + 1] - y;
      double square = dx * dx + dy * dy;
      if (square < best) {
        best = square;
        columns[0] = k;
      }
    }
    shares[0] = total = 1.0;
    found = 1;
  }
  for (int k = 0; k < 12; k++) {
    double sum = 0.0;
    for (int j = 0; j < found; j++) sum += shares[j] / total * e.light_gains[(i64)columns[j] * 12 + k];
    gain[k] = (float)sum;
  }
}

// How far a body reaches in a direction (x, y) of length 1, of what it does in OUTLINE of them.
__device__ __forceinline__ double reach_to(const double *body, double x, double y) {
  double at = atan2(y, x) * (OUTLINE / (2.0 * 3.141592653589793));
  double part = at - floor(at);
  int k = ((int)floor(at) + OUTLINE) % OUTLINE;
  // the corner of two lines across these directions is a little farther than a mean of both
  return 1.03 * ((1.0 - part) * body[k] + part * body[(k + 1) % OUTLINE]);
}

// Codes [N, places] of what is seen, 0 for nobody; poses [N, places, 4, 4] m; gains [N, places, 4, 3].
// The floor is seen at depths from `ground` [m] on. `from` [levels] are the distances [m] from which each level of detail is taken, `turns`
// [PIVOT_ROWS + 1, 2] cosine and sine of the angle turned in each row of a pivot.
KERNEL(show_people)(World w, Crowd c, const double *from, int levels, const double *turns,
                    double across, double deeper, double ground, u64 *codes, double *poses,
                    float *gains) {
  i64 k = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= (i64)w.count * c.places) return;
  int i = (int)(k / c.places), p = (int)(k % c.places);
  const Episode &e = w.episodes[w.slot[i]];
  codes[k] = 0;
  if (p >= e.persons) return;
  Person q = load_person(w, c, p, i);
  const double *ahead = e.headings + w.turns[i] * 3;
  double2 eye = w.position[i];
  double dx = eye.x - q.x, dy = eye.y - q.y, square = dx * dx + dy * dy;
  const Role &role = ((const Role *)e.roles)[p];
  Route r = route_of(e, p);
  int clip = CLIP_NONE, frame = 0, other = CLIP_NONE, other_frame = 0, quarter = BLEND;
  int early = 0, stood = STOOD_LEAST;
  double forward = 0.0, gone = 0.0, at_x = q.x, at_y = q.y;
  if (r.behaviour != SCRIPT) {
    double seconds = 0.1 * q.clip_since + 0.1 * role.offset;
    clip = role.clip;
    if (role.lasts > 0.0) {  // an idle, or a gesture now and then
      double at = fmod(seconds, role.lasts + PAUSE);
      if (at < role.lasts) {
        frame = (int)(at * FPS) / 3 * 3;
        if (role.clip_rowed) frame = row_of(frame, role.clip_rows, role.clip_loops);
      } else {
        clip = role.idle;
        frame = row_of(frame_at(at - role.lasts), role.idle_rows, true);
      }
    } else {
      frame = row_of(frame_at(seconds), role.clip_rows, role.clip_loops);
    }
    forward = role.forward;
  } else {
    double cycles = q.walked / role.stride;
    int phase = (int)rint(cycles * PHASES), side, row = pivot_of(q, side), still = role.idle;
    if (row > 0 && q.turn_since == 0) {
      still = CLIP_PIVOT + side;
    } else if (row > 0) {
      still = CLIP_SETTLE + side;
      row = row * SETTLE_ROWS + min(q.turn_since, SETTLE_ROWS) - 1;
    }
    if (q.clip == WALK) {
      clip = CLIP_WALK;
      frame = phase % PHASES;
      other = still;
      other_frame = row;
    } else {
      clip = still;
      frame = row;
      if (clip == role.idle)
        frame = row_of(frame_at(0.1 * max(q.clip_since - BLEND, 0)), role.idle_rows, true);
      other = CLIP_WALK;
      other_frame = phase % PHASES;
    }
    if (q.clip_since < BLEND - 1) {
      quarter = q.clip_since + 1;
    } else {
      other = CLIP_NONE;
      other_frame = 0;
    }
    // who stands is where it is: what the phase of a walk was off by would turn with it
    int part = min(q.clip_since + 1, BLEND);
    int walks = min(q.clip == WALK ? part : BLEND - part, 2);
    forward = 0.5 * walks * ((double)phase / PHASES - cycles) * role.stride;
    if (other != CLIP_NONE) {
      gone = clip == CLIP_WALK ? q.speed * q.speed / (2.0 * BRAKE) : 0.0;
      double at = cycles - gone / role.stride - RIGHT_SWINGS;
      early = fabs(at - floor(at) - 0.5) > 0.25;
      stood = min(max((int)rint(-1e3 * (gone + forward)), STOOD_LEAST), STOOD_MOST);
    } else if (clip != CLIP_WALK) {
      forward = 0.0;
      at_x = q.x0;
      at_y = q.y0;
    }
  }
  double away = sqrt(square);
  int level = 0;
  for (int n = 1; n < levels; n++)
    if (away >= from[n]) level = n;
  int look = STRAIGHT;
  double yaw = atan2(q.hx * dy - q.hy * dx, q.hx * dx + q.hy * dy);
  if (square < NEAR_EYE * NEAR_EYE && fabs(yaw) < SIDE_EYE) look = look_class(yaw);
  double hx = q.hx, hy = q.hy, ax = hx, ay = hy;
  int stands = clip != CLIP_WALK ? clip : other;
  if (stands >= CLIP_PIVOT && stands < CLIP_SETTLE + 2) {  // feet stand as they stood, to the row
    bool pivots = stands < CLIP_SETTLE;
    int row = clip != CLIP_WALK ? frame : other_frame;
    const double *turn = turns + 2 * (pivots ? row : row / SETTLE_ROWS);
    double cos = turn[0], sin = (stands - (pivots ? CLIP_PIVOT : CLIP_SETTLE)) ? -turn[1] : turn[1];
    hx = q.fx * cos - q.fy * sin;
    hy = q.fx * sin + q.fy * cos;
    ax = clip == CLIP_WALK ? hx : q.fx;
    ay = clip == CLIP_WALK ? hy : q.fy;
  }
  double sx = q.x - q.x0, sy = q.y - q.y0, step = sqrt(sx * sx + sy * sy);
  if (gone > 0.0 && step > 0.0 && sx * ax + sy * ay >= ALIGNED * step) {
    // who still turns as he sets off is drawn before his feet, not aside of them
    at_x = at_x + gone * (ax - sx / step);
    at_y = at_y + gone * (ay - sy / step);
  }
  // nobody who is outside of the wedge that the widest picture shows, whose tip is `deeper` behind the
  // eye, nor has a shadow in it where the floor is seen
  double ox = at_x + ax * forward - eye.x, oy = at_y + ay * forward - eye.y;
  double before = ox * ahead[1] + oy * ahead[2] + deeper, left = oy * ahead[1] - ox * ahead[2];
  if (across < FLAT_SIDE) {
    bool steps = clip >= CLIP_PIVOT && clip < CLIP_SETTLE + 2, whole = other == CLIP_NONE;
    bool idles = whole && clip == role.idle, rests = whole && (steps || idles);
    bool known = whole ? idles || clip == CLIP_WALK : r.behaviour == SCRIPT;  // by its outline
    const double *body = idles ? role.stands : role.walks;
    double uf = hx * ahead[1] + hy * ahead[2], ul = hy * ahead[1] - hx * ahead[2];
    double slope = sqrt(1.0 + across * across), least = whole ? 0.0 : role.still;
    bool out = false, dark = false;
    for (int k = -1; k <= 1; k++) {  // inwards from the left side, the tip, the right side
      double nf = k ? across / slope : 1.0, nl = k / slope, inside = nf * before + nl * left;
      double far = rests ? role.still : role.reach;
      if (known) far = fmax(reach_to(body, nf * uf + nl * ul, nl * uf - nf * ul), least);
      out = out || inside + far + role.coarser[level] < 0.0;
      dark = dark || (k ? inside : before - deeper - ground) + role.shadow < 0.0;
    }
    if (out && dark) return;
  }
  u64 code = (u64)role.number;
  code |= (u64)level << 15;
  code |= (u64)clip << 18;
  code |= (u64)frame << 24;
  code |= (u64)role.gait << 34;
  code |= (u64)look << 37;
  code |= (u64)other << 40;
  code |= (u64)other_frame << 46;
  code |= (u64)(quarter & 3) << 55;
  code |= (u64)early << 57;
  code |= (u64)(stood - STOOD_LEAST) << 58;
  codes[k] = code + 1;
  double *pose = poses + 16 * k;
  double rows[16] = {hx,  -hy, 0.0, at_x + ax * forward, hy,  hx,  0.0, at_y + ay * forward,
                     0.0, 0.0, 1.0, 0.0,                0.0, 0.0, 0.0, 1.0};
  for (int n = 0; n < 16; n++) pose[n] = rows[n];
  find_gain(e, q.x, q.y, gains + 12 * k);
}
