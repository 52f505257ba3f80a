// Labels of pictures: for each pixel the code whose splats weigh most. A block a (view, tile), as those
// that paint, from the same lists; see `gn0.render.cuda.labels`.
//
// A pixel has room for ROOM codes. A new one takes the place of one that can no longer win. A pixel
// where all can is done again in two turns, four, eight, ...: in each only codes count whose mixed
// bits fall to that turn. All splats of a code are summed in one turn, in order: turns cannot show.

#define SURE 1e-5f       // more than sums of weights are rounded by
#define HALF (ROOM / 2)  // of the places are used in turns; the others hold `first` of these

struct Codes {  // of a tile's pixels: by place, then thread; those met first come first
  u32 code[ROOM][TILE * TILE];
  float sum[ROOM][TILE * TILE];  // of weights; `first`: what came through to the first splat
};

// Codes in another order: one to one, neighbours far apart.
__device__ __forceinline__ u32 mix_code(u32 code) {
  code = (code ^ code >> 16) * 0x7feb352du;
  code = (code ^ code >> 15) * 0x846ca68bu;
  return code ^ code >> 16;
}

struct Labels {  // of a lane's pixels
  static const bool COLOUR = true;  // a code stands where red does
  Codes *codes;
  u32 turns, turn;  // a power of two
  float through[PIXELS];
  u32 code[PIXELS], place[PIXELS];    // of the last splat that showed
  float sum[PIXELS], others[PIXELS];  // of its code so far; the greatest of all others
  u32 used[PIXELS];                   // places
  u32 shown[PIXELS];                  // of the turns before, with its sum
  float best[PIXELS], met[PIXELS];
  bool wanted[PIXELS], over[PIXELS];  // in these turns; done again in twice as many

  // The first turn.
  __device__ __forceinline__ void start(int2 at, int width, int height) {
    turns = 1, turn = 0;
#pragma unroll
    for (int i = 0; i < PIXELS; i++) {
      wanted[i] = at.x + i < width && at.y < height, over[i] = false;
      shown[i] = 0, best[i] = met[i] = 0.f;
    }
  }

  __device__ __forceinline__ void begin() {
#pragma unroll
    for (int i = 0; i < PIXELS; i++) {
      through[i] = wanted[i] && !over[i] ? 1.f : 0.f;
      place[i] = NOWHERE, code[i] = used[i] = 0, sum[i] = others[i] = 0.f;
    }
  }

  // Goes on to the sum of another code.
  __device__ __forceinline__ void change(int i, u32 next) {
    u32 p = threadIdx.x + i * BLENDERS, found = NOWHERE, least = 0, most = turns == 1 ? ROOM : HALF;
    if (place[i] != NOWHERE) codes->sum[place[i]][p] = sum[i];
    float low = INFINITY, high = 0.f;
    for (u32 k = 0; k < used[i]; k++) {
      float one = codes->sum[k][p];
      if (codes->code[k][p] == next) found = k;
      if (one < low) low = one, least = k;
      high = fmaxf(high, one);
    }
    if (found == NOWHERE && used[i] == most) {  // one gives way, those behind it move up
      over[i] = over[i] || !(low + through[i] + SURE < high);
      for (u32 k = least + 1; k < most; k++) {
        codes->code[k - 1][p] = codes->code[k][p], codes->sum[k - 1][p] = codes->sum[k][p];
        if (turns > 1) codes->sum[HALF + k - 1][p] = codes->sum[HALF + k][p];
      }
      used[i]--;
    }
    if (found == NOWHERE) {
      found = used[i]++;
      codes->code[found][p] = next, codes->sum[found][p] = 0.f;
      if (turns > 1) codes->sum[HALF + found][p] = through[i];
    }
    float other = 0.f;
    for (u32 k = 0; k < used[i]; k++)
      if (k != found) other = fmaxf(other, codes->sum[k][p]);
    code[i] = next, place[i] = found, sum[i] = codes->sum[found][p], others[i] = other;
  }

  __device__ __forceinline__ void pixel(int i, float alpha, float red, float, float, float) {
    float weight = alpha * through[i], after = through[i] - weight;
    bool keep = after > TRANSMITTANCE_STOP;
    u32 next = __float_as_uint(red);
    if (keep && weight > 0.f && (turns == 1 || (mix_code(next) & (turns - 1)) == turn)) {
      if (next != code[i] || place[i] == NOWHERE) change(i, next);
      sum[i] += weight;
      bool won = turns == 1 && sum[i] > others[i] + after + SURE;
      bool lost = fmaxf(sum[i], others[i]) + after + SURE < best[i];
      keep = !won && !lost && !over[i];
    }
    through[i] = keep ? after : 0.f;
  }
  __device__ __forceinline__ void splat(const TileRoom &, u32) {}
  __device__ __forceinline__ bool open() const {
    bool any = false;
#pragma unroll
    for (int i = 0; i < PIXELS; i++) any = any || through[i] > 0.f;
    return any;
  }

  // The best of this turn against those before.
  __device__ __forceinline__ void settle() {
#pragma unroll
    for (int i = 0; i < PIXELS; i++) {
      u32 p = threadIdx.x + i * BLENDERS;
      if (place[i] == NOWHERE || over[i]) continue;
      codes->sum[place[i]][p] = sum[i];
      for (u32 k = 0; k < used[i]; k++) {
        float total = codes->sum[k][p], first = turns == 1 ? 0.f : codes->sum[HALF + k][p];
        bool wins = total > best[i] || (total == best[i] && first > met[i]);
        best[i] = wins ? total : best[i], met[i] = wins ? first : met[i];
        shown[i] = wins ? codes->code[k][p] : shown[i];
      }
    }
  }

  // Twice as many turns, for pixels that had no room.
  __device__ __forceinline__ void go_on() {
    turns *= 2, turn = 0;
#pragma unroll
    for (int i = 0; i < PIXELS; i++) {
      wanted[i] = over[i], over[i] = false;
      if (wanted[i]) shown[i] = 0, best[i] = met[i] = 0.f;
    }
  }
};

__device__ __forceinline__ void label(TileRoom &t, Codes &codes, const View *__restrict__ views,
                                      const Cloud *__restrict__ clouds,
                                      const u64 *__restrict__ starts, const u32 *__restrict__ counts,
                                      u64 *entries, u64 capacity, u32 room, u64 *aside, Corner c,
                                      int width, int height, u32 flags, u32 *semantic, u32 *instance,
                                      Moving moving) {
  Labels p;
  p.codes = &codes;
  p.start(find_first(c), width, height);
  while (true) {
    p.begin();
    walk_tile(t, p, views, clouds, starts, counts, entries, capacity, room, aside, c, flags, moving);
    __syncthreads();  // all have left the walk
    c = t.corner;
    p.settle();
    bool over = false;
#pragma unroll
    for (int i = 0; i < PIXELS; i++) over = over || p.over[i];
    over = __syncthreads_or(over);
    if (++p.turn < p.turns) continue;
    if (!over) break;
    p.go_on();
  }
  int2 at = find_first(c);
  u64 row = (u64)views[c.view].row * height;
#pragma unroll
  for (int i = 0; i < PIXELS; i++) {
    if (at.x + i >= width || at.y >= height) continue;
    u64 pixel = (row + at.y) * width + at.x + i;
    if (semantic) semantic[pixel] = p.shown[i] >> OBJECT_BITS;
    if (instance) instance[pixel] = p.shown[i] & ((1u << OBJECT_BITS) - 1);
  }
}
