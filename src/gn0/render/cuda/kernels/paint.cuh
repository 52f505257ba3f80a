// Pictures of tiles.

struct Picture {  // of a lane's pixels; a negative transmittance has ended
  static const bool COLOUR = true;
  float through[PIXELS], red[PIXELS], green[PIXELS], blue[PIXELS], depth[PIXELS];

  __device__ __forceinline__ void pixel(int i, float alpha, float r, float g, float b, float z) {
#if PREDICATE && !defined(GN0_HOST)  // the same operations, with one selection less
    asm("{\n\t"
        ".reg .pred keep;\n\t"
        ".reg .f32 weight, after, ended;\n\t"
        "mul.rn.f32 weight, %5, %0;\n\t"
        "sub.rn.f32 after, %0, weight;\n\t"
        "setp.gt.f32 keep, after, %10;\n\t"
        "@keep fma.rn.f32 %1, weight, %6, %1;\n\t"
        "@keep fma.rn.f32 %2, weight, %7, %2;\n\t"
        "@keep fma.rn.f32 %3, weight, %8, %3;\n\t"
        "@keep fma.rn.f32 %4, weight, %9, %4;\n\t"
        "abs.f32 ended, %0;\n\t"
        "neg.f32 ended, ended;\n\t"
        "selp.f32 %0, after, ended, keep;\n\t"
        "}"
        : "+f"(through[i]), "+f"(red[i]), "+f"(green[i]), "+f"(blue[i]), "+f"(depth[i])
        : "f"(alpha), "f"(r), "f"(g), "f"(b), "f"(z), "f"(TRANSMITTANCE_STOP));
#else
    float weight = alpha * through[i], after = through[i] - weight;
    bool keep = after > TRANSMITTANCE_STOP;  // selected, not branched on: lanes rarely agree
    weight = keep ? weight : 0.f;
    through[i] = keep ? after : -fabsf(through[i]);
    red[i] = fmaf(weight, r, red[i]), green[i] = fmaf(weight, g, green[i]);
    blue[i] = fmaf(weight, b, blue[i]), depth[i] = fmaf(weight, z, depth[i]);
#endif
  }
  __device__ __forceinline__ void splat(const TileRoom &, u32) {}
  __device__ __forceinline__ bool open() const {
    bool any = false;
#pragma unroll
    for (int i = 0; i < PIXELS; i++) any = any || through[i] > 0.f;
    return any;
  }
};

__device__ __forceinline__ u8 level(float value) {
  return (u8)(int)(fminf(fmaxf(value, 0.f), 1.f) * 255.f + 0.5f);
}

struct Target {  // where pictures go; null for what is not wanted
  u8 *rgb_u8;
  float *rgb_f32, *depth, *alpha;
  float back_red, back_green, back_blue;
  u32 spare;
};

// Paints the tile of a block. `listed`, where there is one, stands for `given`.
__device__ __forceinline__ void paint(TileRoom &t, const View *__restrict__ views,
                                      const Cloud *__restrict__ clouds,
                                      const u64 *__restrict__ starts, const u32 *__restrict__ counts,
                                      u64 *entries, u64 capacity, u32 room, u64 *aside, Corner c,
                                      int width, int height, u32 flags,
                                      const Target *__restrict__ listed, Target given,
                                      Moving moving) {
  int2 at = find_first(c);
  Picture p;
#pragma unroll
  for (int i = 0; i < PIXELS; i++) {
    p.through[i] = at.x + i < width && at.y < height ? 1.f : -1.f;
    p.red[i] = p.green[i] = p.blue[i] = p.depth[i] = 0.f;
  }
  walk_tile(t, p, views, clouds, starts, counts, entries, capacity, room, aside, c, flags, moving);
  __syncthreads();  // all have left the walk
  c = t.corner, at = find_first(c);
  const Target to = listed ? *listed : given;
  u64 row = (u64)views[c.view].row * height;
#pragma unroll
  for (int i = 0; i < PIXELS; i++) {
    int x = at.x + i;
    float left = fabsf(p.through[i]), opacity = 1.f - left;
    p.red[i] = p.red[i] + left * to.back_red;
    p.green[i] = p.green[i] + left * to.back_green;
    p.blue[i] = p.blue[i] + left * to.back_blue;
    if (x < width && at.y < height) {
      u64 pixel = (row + at.y) * width + x;
      if (to.depth) to.depth[pixel] = opacity >= 0.5f ? p.depth[i] / opacity : INFINITY;
      if (to.alpha) to.alpha[pixel] = opacity;
      if (to.rgb_f32) {
        to.rgb_f32[pixel * 3] = p.red[i];
        to.rgb_f32[pixel * 3 + 1] = p.green[i];
        to.rgb_f32[pixel * 3 + 2] = p.blue[i];
      }
    }
  }
  if (!to.rgb_u8) return;
#pragma unroll
  for (int i = 0; i < PIXELS && at.x < NO_PIXEL; i++) {
    u8 *pixel = t.picture + ((at.y - c.y) * TILE + at.x + i - c.x) * 3;
    pixel[0] = level(p.red[i]), pixel[1] = level(p.green[i]), pixel[2] = level(p.blue[i]);
  }
  __syncthreads();
  bool apart = c.quarter != NOWHERE;
  int x0 = apart ? c.quarter / 2 * SIDE : 0, y0 = apart ? c.quarter % 2 * SIDE : 0;  // in the tile
  int side = apart ? SIDE : TILE;
  int columns = min(side, width - c.x - x0), lines = min(side, height - c.y - y0);
  u8 *out = to.rgb_u8 + ((row + c.y + y0) * width + c.x + x0) * 3;
  const u8 *in = t.picture + (y0 * TILE + x0) * 3;
  if (width % 4 == 0 && columns == side) {  // whole words
    int words = side * 3 / 4;               // of a line
    for (int k = threadIdx.x; k < lines * words; k += THREADS) {
      int line = k / words, word = k % words;
      *(u32 *)(out + (u64)line * width * 3 + word * 4) = *(const u32 *)(in + line * TILE * 3 + word * 4);
    }
  } else if (columns > 0) {
    for (int k = threadIdx.x; k < lines * columns * 3; k += THREADS) {
      int line = k / (columns * 3), byte = k % (columns * 3);
      out[(u64)line * width * 3 + byte] = in[line * TILE * 3 + byte];
    }
  }
}
