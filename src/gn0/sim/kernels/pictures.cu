// Views, map pictures and history mosaics: the pixels of sim/sensors.py and sim/history.py.

// World-to-camera matrices [N, 4, 4] of agents' eyes at `height` [m], looking up by the pitch; and
// numbers of the looks that they see, if they are wanted.
KERNEL(build_views)(World w, double height, double cos_pitch, double sin_pitch, double *views,
                    int *looks) {
  int i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= w.count) return;
  if (looks) looks[i] = w.episodes[w.slot[i]].look;
  const double *heading = w.episodes[w.slot[i]].headings + w.turns[i] * 3;
  double c = heading[1], s = heading[2], x = w.position[i].x, y = w.position[i].y;
  double rows[3][3] = {{s, -c, 0.0},
                       {c * sin_pitch, s * sin_pitch, -cos_pitch},
                       {c * cos_pitch, s * cos_pitch, sin_pitch}};
  double *view = views + (i64)i * 16;
  for (int r = 0; r < 3; r++) {
    for (int k = 0; k < 3; k++) view[4 * r + k] = rows[r][k];
    view[4 * r + 3] = -(rows[r][0] * x + rows[r][1] * y + rows[r][2] * height);
  }
  for (int k = 0; k < 4; k++) view[12 + k] = k == 3;
}

// Where the parts of each agent's scene stand at its step: rows [N, parts] of the tables [motions,
// times, parts], which `motion_of` numbers by scene; and the steps themselves.
KERNEL(place_parts)(World w, const int *motion_of, const double *poses, const int *chosen,
                    const float *gains, const float *nearer, int times, int parts, double *out_poses,
                    int *out_chosen, float *out_gains, float *out_nearer, int *steps) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= (u64)w.count * parts) return;
  int i = (int)(k / parts), p = (int)(k % parts), slot = w.slot[i];
  int motion = slot < 0 ? -1 : motion_of[w.episodes[slot].scene];
  if (!p) steps[i] = w.steps[i];
  if (motion < 0) {
    out_chosen[k] = -1;
    return;
  }
  u64 row = ((u64)motion * times + min(w.steps[i], times - 1)) * parts + p;
  out_chosen[k] = chosen[row];
  for (int j = 0; j < 16; j++) out_poses[16 * k + j] = poses[16 * row + j];
  if (gains)
    for (int j = 0; j < 12; j++) out_gains[12 * k + j] = gains[12 * row + j];
  if (nearer) out_nearer[k] = nearer[row];
}

KERNEL(clip_depth)(const float *depth, float low, float high, u64 size, float *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k < size) out[k] = fminf(fmaxf(depth[k], low), high);
}

// What is drawn into an occupancy picture of an agent: rows and columns of the discs' middles; for
// an arrow the turn and the place, column and row in 2^-16 px.
struct MapMarks {
  int discs[4];
  Turn turn;
  i64 place[2];
};

// By the first two threads of a block, which must wait for each other behind it.
__device__ __forceinline__ void find_marks(const Episode &e, const double *pose, int arrow,
                                           MapMarks *m) {
  if (threadIdx.x < 2) {
    double x = threadIdx.x ? pose[0] : e.start_x, y = threadIdx.x ? pose[1] : e.start_y;
    m->discs[2 * threadIdx.x] = e.map_rows - 1 - (int)floor((y - e.map_y) / e.map_scale);
    m->discs[2 * threadIdx.x + 1] = (int)floor((x - e.map_x) / e.map_scale);
  }
  if (arrow && threadIdx.x == 0) {
    m->turn = find_turn(pose[2]);
    m->place[0] = whole((pose[0] - e.map_x) / e.map_scale * 65536.0);
    m->place[1] = ((i64)e.map_rows << 16) - whole((pose[1] - e.map_y) / e.map_scale * 65536.0);
  }
}

// A pixel of the occupancy picture: the start is a green disc and the agent, over it, a red one,
// or an arrow.
__device__ __forceinline__ void occupancy_pixel(const Episode &e, const MapMarks &m, int row,
                                                int col, int radius, int arrow, u8 *cell) {
  for (int c = 0; c < 3; c++) cell[c] = e.grey[row * e.map_cols + col];
  for (int d = 0; d < (arrow ? 1 : 2); d++) {
    int down = row - m.discs[2 * d], across = col - m.discs[2 * d + 1];
    if (abs(down) > radius || abs(across) > radius) continue;
    if (down * down + across * across > radius * radius) continue;
    cell[0] = d ? 255 : 0;
    cell[1] = d ? 0 : 255;
    cell[2] = 0;
  }
  if (arrow) {
    i64 right = ((i64)col << 16) + 32768 - m.place[0], up = m.place[1] - ((i64)row << 16) - 32768;
    i64 ahead = (right * m.turn.cosine + up * m.turn.sine) >> 30;
    i64 left = (up * m.turn.cosine - right * m.turn.sine) >> 30;
    if (in_arrow(ahead, left, radius)) {
      cell[0] = 255;
      cell[1] = 0;
      cell[2] = 0;
    }
  }
}

// Map pictures [N, rows, cols, 3], black where a scene's own is smaller; null ones are left out.
KERNEL(paint_maps)(World w, const int *slots, const double *poses, int rows, int cols, int radius,
                   int arrow, u8 *bev, u8 *occupancy) {
  __shared__ MapMarks marks;
  int i = blockIdx.x, slot = slots[i];
  if (slot >= 0) find_marks(w.episodes[slot], poses + 3 * (i64)i, arrow, &marks);
  __syncthreads();
  int k = blockIdx.y * blockDim.x + threadIdx.x;
  if (k >= rows * cols) return;
  int row = k / cols, col = k % cols;
  u8 colour[3] = {0, 0, 0}, cell[3] = {0, 0, 0};
  if (slot >= 0) {
    const Episode &e = w.episodes[slot];
    if (row < e.map_rows && col < e.map_cols) {
      if (bev)
        for (int c = 0; c < 3; c++) colour[c] = e.bev[3 * (row * e.map_cols + col) + c];
      if (occupancy) occupancy_pixel(e, marks, row, col, radius, arrow, cell);
    }
  }
  i64 at = ((i64)i * rows * cols + k) * 3;
  for (int c = 0; c < 3; c++) {
    if (bev) bev[at + c] = colour[c];
    if (occupancy) occupancy[at + c] = cell[c];
  }
}

__device__ __forceinline__ int clip8(int sum) { return min(max(sum >> 22, 0), 255); }

// Pictures [N, rows, cols, 3] at another size, as Pillow's box filter does it: weights of 22 bits,
// first along rows, rounded, then along columns. `across` and `down` hold, for each output column
// and row, first input, number of inputs, and their weights (2 + taps numbers each).
// With `views`, picture i is written as tile views[i] % TILES of its history.
KERNEL(reduce_pictures)(const u8 *in, int rows, int cols, const int *across, int across_taps,
                        const int *down, int down_taps, int out_rows, int out_cols,
                        const int *views, const int *status, u8 *out) {
  int k = blockIdx.y * blockDim.x + threadIdx.x, i = blockIdx.x;
  if (k >= out_rows * out_cols || status[0] != CLEAR) return;
  int row = k / out_cols, col = k % out_cols;
  const int *a = across + col * (2 + across_taps), *d = down + row * (2 + down_taps);
  int sum[3] = {1 << 21, 1 << 21, 1 << 21};
  for (int y = 0; y < d[1]; y++) {
    int line[3] = {1 << 21, 1 << 21, 1 << 21};
    const u8 *p = in + (((i64)i * rows + d[0] + y) * cols + a[0]) * 3;
    for (int x = 0; x < a[1]; x++, p += 3)
      for (int c = 0; c < 3; c++) line[c] += p[c] * a[2 + x];
    for (int c = 0; c < 3; c++) sum[c] += clip8(line[c]) * d[2 + y];
  }
  i64 picture = views ? (i64)i * TILES + views[i] % TILES : i;
  u8 *q = out + (picture * out_rows * out_cols + k) * 3;
  for (int c = 0; c < 3; c++) q[c] = (u8)clip8(sum[c]);
}

// Whole maps [N, rows, cols, 3], brought to one size as `reduce_pictures` does it: each scene's own
// picture with its marks, the occupancy picture or the BEV. `across` [shapes, cols, 3] and `down`
// [shapes, rows, 3] hold first input, number of inputs and their one weight, for the shape of each
// episode's map. Black where the slot is negative.
KERNEL(shrink_maps)(World w, const int *slots, const double *poses, const int *shapes,
                    const int *across, const int *down, int rows, int cols, int radius, int arrow,
                    int occupancy, u8 *out) {
  __shared__ MapMarks marks;
  int i = blockIdx.x, slot = slots[i];
  if (slot >= 0) find_marks(w.episodes[slot], poses + 3 * (i64)i, arrow, &marks);
  __syncthreads();
  int k = blockIdx.y * blockDim.x + threadIdx.x;
  if (k >= rows * cols) return;
  int sum[3] = {1 << 21, 1 << 21, 1 << 21};
  if (slot >= 0) {
    const Episode &e = w.episodes[slot];
    const int *a = across + ((i64)shapes[slot] * cols + k % cols) * 3;
    const int *d = down + ((i64)shapes[slot] * rows + k / cols) * 3;
    for (int y = d[0]; y < d[0] + d[1]; y++) {
      int line[3] = {1 << 21, 1 << 21, 1 << 21};
      for (int x = a[0]; x < a[0] + a[1]; x++) {
        u8 cell[3];
        if (occupancy)
          occupancy_pixel(e, marks, y, x, radius, arrow, cell);
        else
          for (int c = 0; c < 3; c++) cell[c] = e.bev[3 * (y * e.map_cols + x) + c];
        for (int c = 0; c < 3; c++) line[c] += cell[c] * a[2];
      }
      for (int c = 0; c < 3; c++) sum[c] += clip8(line[c]) * d[2];
    }
  }
  u8 *q = out + ((i64)i * rows * cols + k) * 3;
  for (int c = 0; c < 3; c++) q[c] = (u8)clip8(sum[c]);
}

// History mosaics [N, 4 h, 4 w, 3] from the tiles [N, TILES, h, w, 3], newest first; black where
// there is no view yet. A word a thread; a tile's row is `row_words` of them.
template <class Word>
__device__ __forceinline__ void lay_mosaic(const Word *tiles, const int *views, int tile_rows,
                                           int row_words, Word nothing, Word *out) {
  int k = blockIdx.y * blockDim.x + threadIdx.x, i = blockIdx.x;
  int wide = COLUMNS * row_words, high = (TILES / COLUMNS) * tile_rows;
  if (k >= wide * high) return;
  int row = k / wide, col = k % wide, seen = views[i];
  int back = (row / tile_rows) * COLUMNS + col / row_words;  // 0 is the newest
  Word word = nothing;
  if (back < min(seen, TILES)) {
    i64 tile = (i64)i * TILES + (seen - 1 - back) % TILES;
    word = tiles[(tile * tile_rows + row % tile_rows) * row_words + col % row_words];
  }
  out[(i64)i * wide * high + k] = word;
}

KERNEL(lay_mosaics)(const uint4 *tiles, const int *views, int rows, int words, uint4 *out) {
  lay_mosaic(tiles, views, rows, words, make_uint4(0, 0, 0, 0), out);
}

KERNEL(lay_mosaics_4)(const u32 *tiles, const int *views, int rows, int words, u32 *out) {
  lay_mosaic(tiles, views, rows, words, 0u, out);
}

KERNEL(lay_mosaics_1)(const u8 *tiles, const int *views, int rows, int words, u8 *out) {
  lay_mosaic(tiles, views, rows, words, (u8)0, out);
}

// Rows [entries, size] to rows `to` of another array.
KERNEL(place_rows)(const u8 *in, const int *to, u64 size, int entries, u8 *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k < size * entries) out[(u64)to[k / size] * size + k % size] = in[k];
}

// Pictures [N, pixels, 3] as [N, 3, pixels], of elements of `width` bytes.
KERNEL(move_channels)(const u8 *in, u64 pixels, u64 width, u64 size, u8 *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= size) return;
  u64 byte = k % width, pixel = k / width % pixels, plane = k / (width * pixels);
  out[k] = in[((plane / 3 * pixels + pixel) * 3 + plane % 3) * width + byte];
}

// Rows of a table [entries, width] by number; zeros where the number is negative.
KERNEL(take_rows)(const int *table, const int *numbers, u64 width, u64 size, int *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= size) return;
  int row = numbers[k / width];
  out[k] = row < 0 ? 0 : table[(u64)row * width + k % width];
}
