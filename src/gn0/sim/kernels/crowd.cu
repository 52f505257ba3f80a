// Agents among people: each action in its ticks, as sim/batch_people_kernels.py has it, and what
// begins, ends, is told and is kept of people.

// The people of N environments. Columns come first and environments last, so that neighbours
// in a warp read and write whole sectors.
struct Crowd {
  double *real;        // [REALS, places, N]
  i64 *whole;          // [WHOLES, places, N]
  u8 *cut;             // [N] the last move was cut short, by a wall or by somebody
  double *people;      // [N, places, 4] x, y [m], unit vector of the heading; NaN for nobody
  i64 *hit_person;     // [N] number of the person for whom a move was cut; 0 none
  i64 *hit_by;         // [N] who came nearer: BY_AGENT, BY_PERSON; 0 nobody
  i64 *hit_tick;       // [N] of the action, from 1, that the agent did not do; 0 none
  double *final_people;  // the same of episodes that ended, 0 elsewhere
  i64 *final_hit_person;
  i64 *final_hit_by;
  i64 *final_hit_tick;
  double agent_radius, person_radius;      // m
  double tick_seconds, tick_cos, tick_sin;  // `Pace`
  int rate, parts;
  int places, ticks;   // people at most, ticks an action
  int slides, unused;  // whether agents do, at walls
};
static_assert(sizeof(Crowd) == CROWD_BYTES, "device_layout.CROWD differs from Crowd");

#define BY_AGENT 1
#define BY_PERSON 2

__device__ __forceinline__ i64 column_at(const World &w, const Crowd &c, int column, int p, int i) {
  return ((i64)column * c.places + p) * w.count + i;
}

__device__ __forceinline__ Person load_person(const World &w, const Crowd &c, int p, int i) {
  Person q;
#define LOAD_REAL(k, name, type) q.name = c.real[column_at(w, c, k, p, i)];
#define LOAD_WHOLE(k, name, type) q.name = (type)c.whole[column_at(w, c, k, p, i)];
  REAL_COLUMNS(LOAD_REAL)
  WHOLE_COLUMNS(LOAD_WHOLE)
  return q;
}

__device__ __forceinline__ void store_person(const World &w, const Crowd &c, int p, int i,
                                             const Person &q) {
#define STORE_REAL(k, name, type) c.real[column_at(w, c, k, p, i)] = q.name;
#define STORE_WHOLE(k, name, type) c.whole[column_at(w, c, k, p, i)] = q.name;
  REAL_COLUMNS(STORE_REAL)
  WHOLE_COLUMNS(STORE_WHOLE)
}

#define PERSON_COLUMNS 9  // of `Episode.people`; the last is the person's number

__device__ __forceinline__ Route route_of(const Episode &e, int p) {
  const int *row = e.people + PERSON_COLUMNS * p;
  const double *line = e.lines + 4 * p;
  Route r = {e.points + 7 * row[0], e.holds + 4 * row[2], line[0], line[1], row[1] - row[0] - 2,
             row[3] - row[2],       row[4],               row[5],  row[6],  row[7]};
  return r;
}

__device__ __forceinline__ void tell_person(const Crowd &c, int p, int i, const Person &q) {
  double *out = c.people + ((i64)i * c.places + p) * 4;
  out[0] = q.x;
  out[1] = q.y;
  out[2] = q.hx;
  out[3] = q.hy;
}

__device__ __forceinline__ void tell_nobody(const Crowd &c, int p, int i) {
  double *out = c.people + ((i64)i * c.places + p) * 4;
  for (int k = 0; k < 4; k++) out[k] = (double)__int_as_float(0x7fc00000);
}

__device__ __forceinline__ void clear_hit(const Crowd &c, int i) {
  c.hit_person[i] = 0;
  c.hit_by[i] = 0;
  c.hit_tick[i] = 0;
}

// `place_rows` of people/crowd.py: person p of an episode at its beginning.
__device__ __forceinline__ void begin_person(const World &w, const Crowd &c, const Episode &e, int p,
                                             int i) {
  if (p >= e.persons) {
    tell_nobody(c, p, i);
    return;
  }
  Route r = route_of(e, p);
  Person q = {};
  q.x = q.x0 = r.points[0];
  q.y = q.y0 = r.points[1];
  q.hx = e.lines[4 * p + 2];
  q.hy = e.lines[4 * p + 3];
  q.direction = 1;
  q.blocked_by = NOBODY;
  q.clip_since = LONG_AGO;
  q.claim = q.claim0 = r.right;
  q.fx = q.hx;
  q.fy = q.hy;
  q.turn_since = SETTLE;
  store_person(w, c, p, i, q);
  tell_person(c, p, i, q);
}

__device__ __forceinline__ void begin_hits(const Crowd &c, int i) {
  c.cut[i] = 0;
  clear_hit(c, i);
}

// A move of an agent through the map, by its body's rule; whether it was cut.
__device__ __noinline__ bool go_to(const Crowd &c, const Episode &e, double2 &p, double x, double y) {
  return c.slides ? slide(e, p.x, p.y, x, y) : trace(e, p.x, p.y, x, y);
}

// Everybody through the ticks of an action, and the agents that go ahead. A block is up to a warp of
// environments wide and as many people high. A thread keeps its person; what others see of it is in shared memory.
// Small blocks wait less for each other and leave a thread all the registers that it wants.
KERNEL_BOUNDED(move_people, CROWD_THREADS, 2)(World w, Crowd c, const u8 *codes) {
  __shared__ double old_x[CROWD_THREADS], old_y[CROWD_THREADS];  // a tick ago
  __shared__ double new_x[CROWD_THREADS], new_y[CROWD_THREADS];
  __shared__ double agent_x[WARP], agent_y[WARP];
  __shared__ i64 claims[CROWD_THREADS];
  __shared__ Task tasks[TASKS];
  __shared__ double scores[TASKS][CANDIDATES_MOST];
  __shared__ u16 items[TASKS * CANDIDATES_MOST];  // candidates: task * 16 + number
  __shared__ int asked, weighed;  // people who have been given a task, candidates that are in `items`
  if (w.status[0] != CLEAR) return;  // all threads alike
  int lane = threadIdx.x, p = threadIdx.y, i = blockIdx.x * LANES + lane;
  int mine = p * LANES + lane, thread = mine, threads = blockDim.x * blockDim.y;
  const Episode *e = i < w.count ? w.episodes + w.slot[i] : nullptr;
  int persons = e ? e->persons : 0;
  bool walks = p < persons, leads = p == 0 && persons > 0;
  bool goes = leads && codes[i] == FORWARD, cut = false, stopped = false;
  Pace pace = {c.tick_seconds, c.tick_cos, c.tick_sin, c.rate, c.parts};
  Person q;
  Route r;
  Task task;
  double2 start, end;  // of the agent's move as if nobody were there
  double dx, dy;
  i64 person = 0, by = 0, at = 0;
  if (walks) {
    q = load_person(w, c, p, i);
    r = route_of(*e, p);
  }
  if (leads) {
    start = end = w.position[i];
    agent_x[lane] = start.x;
    agent_y[lane] = start.y;
  }
  if (goes) {
    const double *heading = e->headings + w.turns[i] * 3;
    double x1 = start.x + w.forward * heading[1], y1 = start.y + w.forward * heading[2];
    dx = x1 - start.x;
    dy = y1 - start.y;
    cut = go_to(c, *e, end, x1, y1);
  }
  if (thread == 0) asked = weighed = 0;
#pragma unroll 1
  for (int tick = 1; tick <= c.ticks; tick++) {
    if (walks) {
      q.x0 = old_x[mine] = q.x;
      q.y0 = old_y[mine] = q.y;
      q.claim0 = q.claim;
      claims[mine] = r.behaviour == SCRIPT ? q.claim : ~q.claim;
    }
    __syncthreads();
    double hx, hy;
    Around around;
    int number = -1;  // of its task; their order shows nowhere
    if (walks) {
      hx = q.hx;
      hy = q.hy;
      around = {old_x + lane,  old_y + lane,   claims + lane,   agent_x[lane],
                agent_y[lane], c.agent_radius, c.person_radius, persons,       p, 0};
      begin_tick(q, r, *e, pace, around, task);
      if (task.kind != NO_TASK) {
        task.lane = lane;
        number = atomicAdd(&asked, 1);
      }
    }
    int all = __syncthreads_count(number >= 0);  // the same in every thread, which no load is sure to be
#pragma unroll 1
    for (int first = 0; first < all; first += TASKS) {
      int slot = number - first;
      bool now = number >= first && slot < TASKS;
      if (now) {
        tasks[slot] = task;
        int at = atomicAdd(&weighed, task.count);
        for (int k = 0; k < task.count; k++) items[at + k] = slot * 16 + k;
      }
      __syncthreads();
      int count = weighed;
      for (int n = thread; n < count; n += threads) {
        const Task &t = tasks[items[n] >> 4];
        int l = t.lane, candidate = items[n] & 15;
        Around other = {old_x + l,  old_y + l,      claims + l,      agent_x[l],
                        agent_y[l], c.agent_radius, c.person_radius, t.episode->persons, t.p, t.near};
        scores[items[n] >> 4][candidate] = weigh(t, candidate, other);
      }
      __syncthreads();
      if (now) {
        Person copy = q;
        do_chosen(copy, *e, pace, around, task, scores[slot]);
        q = copy;
      }
      if (thread == 0) weighed = 0;
      __syncthreads();
    }
    if (thread == 0 && all > 0) asked = 0;
    if (walks) {
      end_tick(q, r, pace, hx, hy);
      new_x[mine] = q.x;
      new_y[mine] = q.y;
    }
    __syncthreads();
    if (goes && !stopped) {
      double2 next = end;
      if (tick < c.ticks) {
        double share = (double)tick / (double)c.ticks;
        next = start;
        go_to(c, *e, next, start.x + dx * share, start.y + dy * share);
      }
      double reach = c.person_radius + c.agent_radius, best = reach * reach;
      int touched = -1;
      for (int k = 0; k < persons; k++) {
        double ox = new_x[k * LANES + lane] - next.x, oy = new_y[k * LANES + lane] - next.y;
        double square = ox * ox + oy * oy;
        if (square < best) {
          best = square;
          touched = k;
        }
      }
      if (touched >= 0) {
        int k = touched * LANES + lane;
        double lx = agent_x[lane], ly = agent_y[lane], px = old_x[k], py = old_y[k];
        double ax = px - lx, ay = py - ly;
        double own = (next.x - lx) * ax + (next.y - ly) * ay;
        double theirs = -((new_x[k] - px) * ax + (new_y[k] - py) * ay);
        person = e->people[PERSON_COLUMNS * touched + PERSON_COLUMNS - 1];
        by = own >= theirs ? BY_AGENT : BY_PERSON;
        at = tick;
        stopped = cut = true;
      } else {
        agent_x[lane] = next.x;
        agent_y[lane] = next.y;
      }
    }
    __syncthreads();
  }
  if (walks) {
    store_person(w, c, p, i, q);
    tell_person(c, p, i, q);
  }
  if (leads) {
    c.hit_person[i] = person;
    c.hit_by[i] = by;
    c.hit_tick[i] = at;
    c.cut[i] = cut;
  }
  if (goes) w.position[i] = make_double2(agent_x[lane], agent_y[lane]);
}

// What was told of a person goes to what is told of episodes that ended.
__device__ __forceinline__ void keep_person(const Crowd &c, int p, int i, bool ended) {
  i64 first = ((i64)i * c.places + p) * 4;
#pragma unroll
  for (int k = 0; k < 4; k++) c.final_people[first + k] = ended ? c.people[first + k] : 0.0;
}

__device__ __forceinline__ void keep_hits(const Crowd &c, int i, bool ended) {
  c.final_hit_person[i] = ended ? c.hit_person[i] : 0;
  c.final_hit_by[i] = ended ? c.hit_by[i] : 0;
  c.final_hit_tick[i] = ended ? c.hit_tick[i] : 0;
}

// `step_agent` behind `move_people`: agents among people are where they end already.
__device__ __forceinline__ Acted act_among(const World &w, const Crowd &c, const Episode &e, int i,
                                           int action) {
  int turns = w.turns[i];
  Acted a = {w.position[i], turn_by(w, turns, action), w.steps[i] + 1, w.distance[i]};
  if (action == FORWARD) {
    const double *heading = e.headings + turns * 3;
    a.hit = e.persons ? c.cut[i] != 0
                      : go_to(c, e, a.p, a.p.x + w.forward * heading[1],
                              a.p.y + w.forward * heading[2]);
    a.distance = measure(e, a.p.x, a.p.y);
  }
  return a;
}

// The agent of an environment goes on: to its next episode, whose slot is given, or in its own: -1.
__device__ __forceinline__ int go_on_to(const World &w, const Crowd &c, int i, const Acted &a) {
  bool ended = a.terminated || a.truncated;
  keep_hits(c, i, ended);
  int next = ended ? draw(w, i) : -1;
  if (next >= 0) {
    begin(w, i, next);
    begin_hits(c, i);
  } else {
    stay_in(w, i, a);
  }
  return next;
}

// `place_agents` for an agent; its slot, or -1 where it stays.
__device__ __forceinline__ int place_agent(const World &w, const Crowd &c, const int *slots, int i) {
  int slot = slots[i] == -2 ? draw(w, i) : slots[i];
  if (slot >= 0) {
    begin(w, i, slot);
    begin_hits(c, i);
  }
  return slot;
}

// Blocks are those of `move_people`: the first thread of an environment is its agent's as well.
KERNEL_BOUNDED(step_people, CROWD_THREADS, 2)(World w, Crowd c, const u8 *codes, Outputs out) {
  __shared__ int nexts[WARP];
  __shared__ u8 ends[WARP];
  if (w.status[0] != CLEAR) return;  // all threads alike
  int lane = threadIdx.x, p = threadIdx.y, i = blockIdx.x * LANES + lane;
  if (p == 0 && i < w.count) {
    int slot = w.slot[i], action = codes[i];
    const Episode &e = w.episodes[slot];
    Acted a = act_among(w, c, e, i, action);
    judge(w, e, action, w.distance[i], a);
    write_step(w, e, i, slot, a, out);
    ends[lane] = a.terminated || a.truncated;
    nexts[lane] = go_on_to(w, c, i, a);
  }
  __syncthreads();
  if (i >= w.count) return;
  keep_person(c, p, i, ends[lane]);
  if (nexts[lane] >= 0) begin_person(w, c, w.episodes[nexts[lane]], p, i);
  if (p == 0) tell(w, i, out);
}

// `place_agents`, and everybody around them at their beginnings.
KERNEL_BOUNDED(place_people, CROWD_THREADS, 2)(World w, Crowd c, const int *slots,
                                                     Outputs out) {
  __shared__ int nexts[WARP];
  int lane = threadIdx.x, p = threadIdx.y, i = blockIdx.x * LANES + lane;
  if (p == 0 && i < w.count) nexts[lane] = place_agent(w, c, slots, i);
  __syncthreads();
  if (i >= w.count) return;
  if (nexts[lane] >= 0) begin_person(w, c, w.episodes[nexts[lane]], p, i);
  if (p == 0) tell(w, i, out);
}

// `shorten_rays` of sim/people.py: rings [N, rays] m, cut where an agent at poses [N, 3] would touch
// somebody of `people` [N, places, 4]; NaN is nobody.
KERNEL(shorten_ranges)(World w, Crowd c, const int *slots, const double *poses, const int *turns,
                       const double *people, int rays, float *out) {
  i64 k = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= (i64)w.count * rays) return;
  int i = (int)(k / rays), slot = slots[i];
  if (slot < 0) return;
  const Episode &e = w.episodes[slot];
  const double *ray = e.directions + ((i64)turns[i] * rays + k % rays) * 2;
  double ux = ray[0], uy = ray[1], x = poses[3 * i], y = poses[3 * i + 1];
  double reach = c.person_radius + c.agent_radius, least = (double)out[k];
  for (int p = 0; p < e.persons; p++) {
    const double *other = people + ((i64)i * c.places + p) * 4;
    double dx = other[0] - x, dy = other[1] - y;
    double along = dx * ux + dy * uy, aside = dx * uy - dy * ux;
    double under = reach * reach - aside * aside;
    if (along > 0.0 && under > 0.0) least = least_of(least, most_of(along - sqrt(under), 0.0));
  }
  out[k] = (float)least;
}

// The people of `agents` [K] into rows: real [K, PEOPLE_MOST, REALS], whole [K, PEOPLE_MOST, WHOLES].
KERNEL(save_people)(World w, Crowd c, const int *agents, int count, double *real, i64 *whole) {
  int at = blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= count * PEOPLE_MOST) return;
  int k = at / PEOPLE_MOST, p = at % PEOPLE_MOST;
  Person q = {};
  if (p < c.places) q = load_person(w, c, p, agents[k]);
#define SAVE_REAL(k, name, type) real[(i64)at * REALS + k] = q.name;
#define SAVE_WHOLE(k, name, type) whole[(i64)at * WHOLES + k] = q.name;
  REAL_COLUMNS(SAVE_REAL)
  WHOLE_COLUMNS(SAVE_WHOLE)
}

// People of saved rows `rows` [K] around `agents` [K], who are in their episodes already.
KERNEL(restore_people)(World w, Crowd c, const int *rows, const int *agents, int count,
                       const double *real, const i64 *whole) {
  int at = blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= count * c.places) return;
  int k = at / c.places, p = at % c.places, i = agents[k];
  i64 row = (i64)rows[k] * PEOPLE_MOST + p;
  if (p == 0) {
    c.cut[i] = 0;
    clear_hit(c, i);
  }
  if (p >= w.episodes[w.slot[i]].persons) {
    tell_nobody(c, p, i);
    return;
  }
  Person q;
#define RESTORE_REAL(k, name, type) q.name = real[row * REALS + k];
#define RESTORE_WHOLE(k, name, type) q.name = (type)whole[row * WHOLES + k];
  REAL_COLUMNS(RESTORE_REAL)
  WHOLE_COLUMNS(RESTORE_WHOLE)
  store_person(w, c, p, i, q);
  tell_person(c, p, i, q);
}

// What was kept in `places` fewer rows a person, for more people: columns [columns, from, N].
KERNEL(widen_reals)(const double *in, int columns, int from, int to, int count, double *out) {
  i64 at = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= (i64)columns * from * count) return;
  i64 i = at % count, p = at / count % from, column = at / count / from;
  out[(column * to + p) * count + i] = in[at];
}

KERNEL(widen_wholes)(const i64 *in, int columns, int from, int to, int count, i64 *out) {
  i64 at = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (at >= (i64)columns * from * count) return;
  i64 i = at % count, p = at / count % from, column = at / count / from;
  out[(column * to + p) * count + i] = in[at];
}
