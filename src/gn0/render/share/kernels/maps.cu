// Occupancy pictures of steps: a map in grey with two discs, the pixels of `draw_disc` in
// gn0/sim/sensors.py.

#define RUN 4096  // pixels a block

// What a picture shows.
struct Shown {
  u64 grey;        // address of the map [rows, cols]
  int at[2][2];    // row and column of the start, which is green, and of the agent, over it in red
  int radius;      // of both discs [px]
};

// Pictures [count, rows, cols, 3]; blocks (count, runs of a picture).
KERNEL(paint_maps)(const Shown *shown, int rows, int cols, u8 *pictures) {
  const Shown s = shown[blockIdx.x];
  const u8 *grey = (const u8 *)s.grey;
  int size = rows * cols, end = min((int)(blockIdx.y + 1) * RUN, size);
  u8 *out = pictures + (i64)blockIdx.x * size * 3;
  for (int k = blockIdx.y * RUN + threadIdx.x; k < end; k += blockDim.x) {
    int row = k / cols, col = k - row * cols;
    u8 red = grey[k], green = red, blue = red;
    for (int d = 0; d < 2; d++) {
      int down = abs(row - s.at[d][0]), across = abs(col - s.at[d][1]);
      if (down > s.radius || across > s.radius) continue;
      if (down * down + across * across > s.radius * s.radius) continue;
      red = d ? 255 : 0, green = d ? 0 : 255, blue = 0;
    }
    out[3 * (i64)k] = red, out[3 * (i64)k + 1] = green, out[3 * (i64)k + 2] = blue;
  }
}
