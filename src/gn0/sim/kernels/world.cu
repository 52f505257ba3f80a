// What agents, episodes and maps are on the device; the layouts of device_layout.py.

#define STOP 0
#define FORWARD 1
#define LEFT 2
#define RIGHT 3
#define CLEAR 0x7fffffff  // a status word that nothing has been written to

// A resident episode: where its map, distance field and headings lie, and what is fixed in it.
struct Episode {
  const int *compact;        // [rows * cols] a free cell's number in its scene; -1 where blocked
  const void *labels;        // [free cells] u16, or u32 when wide: the root of each
  const double *roots;       // [R, 3] bends as (x, y, distance to the goal) in cells
  const double *headings;    // [circle, 3] yaw [rad], cosine, sine after k turns
  const double *directions;  // [circle, rays, 2] cosine and sine of each range ray; or null
  const u8 *grey;            // [map_rows, map_cols] the occupancy picture; or null
  const u8 *bev;             // [map_rows, map_cols, 3]; or null
  const u8 *walls;           // [rows, cols] WALL and WALL_NEAR; or null where there are no people
  const int *people;         // [persons, 9] `Routes.table` and their numbers; or null
  const double *lines;       // [persons, 4] of `Routes`
  const double *points;      // [points, 7] of `Routes`
  const double *holds;       // [stops, 4] of `Routes`
  const void *roles;         // [persons] of `Role`; or null where nobody is drawn
  const int *light_column;   // [light_cols, light_rows] probes of a cell; or null where nobody is drawn
  const double *light_places;  // [light_count, 2] m
  const double *light_gains;   // [light_count, 4, 3]
  double x, y, resolution;   // of the map: its origin [m], and of a cell [m]
  double start_x, start_y, goal_x, goal_y;
  double map_x, map_y, map_scale;  // of the map pictures: lower left corner [m], m a pixel
  double reach;              // m, its own success radius; 0: the world's
  double keep_distance, keep_lateral;  // m, how to follow
  int rows, cols, map_rows, map_cols;
  int wide, number, scene, look;
  int stays;                 // STOP stands still for one action
  int persons;               // people in it
  int followed;              // row of whom to follow
  int light_cols, light_rows, light_count;
};
static_assert(sizeof(Episode) == EPISODE_BYTES, "device_layout.EPISODE differs from Episode");

struct World {
  const Episode *episodes;  // [slots]
  const int *queue;         // [N, ahead] slots of the episodes that come next, a ring
  const int *filled;        // [N] draws that are in the queue, since the beginning
  int *cursor;              // [N] draws that have been begun
  int *slot;                // [N] the episode that is played
  double2 *position;        // [N] m
  int *turns;               // [N] whole turns since the start, modulo the circle
  int *steps;               // [N] actions taken
  u8 *collided;             // [N] the last action was truncated
  double *distance;         // [N] m to the goal, geodesic
  int *views;               // [N] views since the start; or null without a history
  int *status;              // [3] first agent with a bad action, agent without an episode, step
  double forward;           // m
  double success_distance;  // m
  double step_cost, success_reward;
  int count, ahead, circle, max_steps;
};
static_assert(sizeof(World) == WORLD_BYTES, "device_layout.WORLD differs from World");

// Where a step writes; null where nobody wants it. The `final` ones are of episodes that ended.
struct Outputs {
  double *rewards;       // [N]
  u8 *terminated;        // [N]
  u8 *truncated;         // [N]
  u8 *ended;             // [N] either of them
  float2 *goal_vector;   // [N] m, forward and left
  i64 *collided;         // [N]
  double *pose;          // [N, 3]
  double *distance;      // [N] m
  int *episode;          // [N] number
  int *scene;            // [N] number
  float2 *final_goal_vector;
  i64 *final_collided;
  double *final_pose;
  double *final_distance;
  u8 *final_success;
  int *final_episode;    // -1 where none ended
  int *final_slot;       // the same
  int *final_turns;
  int *final_views;      // views since the start, of a history
};
static_assert(sizeof(Outputs) == OUTPUTS_BYTES, "device_layout.OUTPUTS differs from Outputs");

__device__ __forceinline__ bool is_blocked(const Episode &e, i64 row, i64 col) {
  if (row < 0 || col < 0 || row >= e.rows || col >= e.cols) return true;
  return e.compact[row * e.cols + col] < 0;
}

#define WALL 1       // a cell of the raw map that is not free
#define WALL_NEAR 2  // a cell where no person's centre may be
