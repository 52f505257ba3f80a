// Map pictures around agents, heading up: the arithmetic of sim/ego_map.py, operation by operation.

// sin(t * pi / 2) of 0 <= t <= 1, both in 2^-30.
__device__ __forceinline__ i64 sine_series(i64 t) {
  i64 z = (t * t) >> 30;
  i64 p = EGO_C5 + ((EGO_C6 * z) >> 30);
  p = EGO_C4 + ((p * z) >> 30);
  p = EGO_C3 + ((p * z) >> 30);
  p = EGO_C2 + ((p * z) >> 30);
  p = EGO_C1 + ((p * z) >> 30);
  p = EGO_C0 + ((p * z) >> 30);
  p = (t * p) >> 30;
  return p < (i64)1 << 30 ? p : (i64)1 << 30;
}

// Sine in 2^-30 of an angle in quarter turns of 2^30.
__device__ __forceinline__ i64 sine(i64 angle) {
  i64 quarter = (angle >> 30) & 3, t = angle & (((i64)1 << 30) - 1);
  if (quarter & 1) t = ((i64)1 << 30) - t;
  i64 found = sine_series(t);
  return quarter & 2 ? -found : found;
}

__device__ __forceinline__ i64 whole(double value) { return (i64)rint(value); }

struct Turn {
  i64 cosine, sine;  // in 2^-30
};

__device__ __forceinline__ Turn find_turn(double yaw) {
  i64 angle = whole(yaw * ((double)(i64)EGO_QUARTER / 1048576.0));
  return {sine(angle + ((i64)1 << 30)), sine(angle)};
}

// Whether a place [2^-16 px] from the agent is in its arrow: twice as long before as behind.
__device__ __forceinline__ bool in_arrow(i64 ahead, i64 left, int marker) {
  i64 half = (i64)(2 * marker + 1) << 15;
  return ahead >= -half && 3 * (left < 0 ? -left : left) <= 2 * half - ahead;
}

// An agent's square: what its pixels share.
struct Square {
  i64 along, across;         // pixels of the map a pixel, in 2^-24
  i64 u, v;                  // the agent's place on the map, in 2^-40 px
  i64 start_row, start_col;  // pixel of the start
  int side;                  // samples a side of a pixel
};

// Squares [size, size, 3] of all agents, heading up, from column `offset` on in pictures
// [N, high, wide, 3]. content: 0 bev, 1 occupancy, 2 merged. front: rows before the agent in
// 2^-16 px. A pixel is the mean of side * side samples.
KERNEL(draw_ego_maps)(World w, const int *slots, const double *poses, int size, double metres,
                      i64 front, int content, int marker, int offset, int high, int wide, u8 *out) {
  __shared__ Square q;
  __shared__ i64 down[EGO_SAMPLES], right[EGO_SAMPLES];  // of samples in a pixel, in 2^-40 px
  int i = blockIdx.x, slot = slots[i];
  i64 middle = (i64)size << 15;
  if (slot >= 0 && threadIdx.x == 0) {
    const Episode &e = w.episodes[slot];
    const double *pose = poses + 3 * (i64)i;
    Turn turn = find_turn(pose[2]);
    i64 step = whole(metres / e.map_scale * 65536.0);
    q.along = (turn.cosine * step + (1 << 21)) >> 22;
    q.across = (turn.sine * step + (1 << 21)) >> 22;
    q.u = whole((pose[0] - e.map_x) / e.map_scale * 65536.0) * ((i64)1 << 24);
    q.v = ((i64)e.map_rows << 40) -
          whole((pose[1] - e.map_y) / e.map_scale * 65536.0) * ((i64)1 << 24);
    i64 side = (step + 65535) >> 16;
    q.side = (int)(side < 1 ? 1 : side > EGO_SAMPLES ? EGO_SAMPLES : side);
    double far = (double)((i64)1 << 28);  // beyond any square
    i64 dx = whole(fmin(fmax(rint((e.start_x - pose[0]) / metres * 65536.0), -far), far));
    i64 dy = whole(fmin(fmax(rint((e.start_y - pose[1]) / metres * 65536.0), -far), far));
    q.start_row = (front - ((dx * turn.cosine + dy * turn.sine) >> 30)) >> 16;
    q.start_col = (middle - ((dy * turn.cosine - dx * turn.sine) >> 30)) >> 16;
  }
  __syncthreads();
  if (slot >= 0 && threadIdx.x < q.side) {
    i64 part = ((2 * (int)threadIdx.x + 1) << 15) / q.side;
    down[threadIdx.x] = part * q.along;
    right[threadIdx.x] = part * q.across;
  }
  __syncthreads();
  int k = blockIdx.y * blockDim.x + threadIdx.x;
  if (k >= size * size) return;
  int r = k / size, c = k % size;
  int red = 0, green = 0, blue = 0;
  if (slot >= 0) {
    const Episode &e = w.episodes[slot];
    i64 ahead = front - ((i64)r << 16), left = middle - ((i64)c << 16);
    i64 u0 = q.u + ahead * q.along - left * q.across, v0 = q.v - ahead * q.across - left * q.along;
    int side = q.side, count = side * side, rows = e.map_rows, cols = e.map_cols;
    const u8 *bev = e.bev, *grey = e.grey;
    for (int y = 0; y < side; y++) {
      for (int x = 0; x < side; x++) {
        i64 u = (u0 - down[y] + right[x]) >> 40, v = (v0 + right[y] + down[x]) >> 40;
        bool inside = 0 <= u && u < cols && 0 <= v && v < rows;
        i64 at = inside ? v * cols + u : 0;
        int cell = inside && content ? grey[at] : 0;
        if (content == 1) {
          red += cell;
          green += cell;
          blue += cell;
          continue;
        }
        int a = 0, b = 0, d = 0;
        if (inside) {
          a = bev[3 * at];
          b = bev[3 * at + 1];
          d = bev[3 * at + 2];
        }
        if (content == 2 && cell != 255) {
          a = (a + cell) >> 1;
          b = (b + cell) >> 1;
          d = (d + (cell ? cell : EGO_TINT)) >> 1;
        }
        red += a;
        green += b;
        blue += d;
      }
    }
    red = (red + count / 2) / count;
    green = (green + count / 2) / count;
    blue = (blue + count / 2) / count;
    if (marker >= 0) {
      i64 below = r - q.start_row, beside = c - q.start_col;
      if (-marker <= below && below <= marker && -marker <= beside && beside <= marker &&
          below * below + beside * beside <= marker * marker) {
        red = 0;
        green = 255;
        blue = 0;
      }
      if (in_arrow(ahead - 32768, left - 32768, marker)) {
        red = 255;
        green = 0;
        blue = 0;
      }
    }
  }
  u8 *p = out + (((i64)i * high + r) * wide + offset + c) * 3;
  p[0] = (u8)red;
  p[1] = (u8)green;
  p[2] = (u8)blue;
}
