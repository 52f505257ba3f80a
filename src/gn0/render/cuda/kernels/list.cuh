// Lists of entries a (view, tile): counted, or some of them, given room by a scan, then written, in
// any order; a second scan tells how long they are.
//
// A block takes `each` chunks (at most CHUNKS) of a cloud for up to VIEWS of the views that show
// that cloud: a warp a chunk tests its box against them; then the block holds each chunk that is in
// sight, a splat a thread in registers, and projects it for each view that can see it. An entry is a
// key, depth bits over index, so that entries need no order here.

// Whether a chunk may touch the picture; dropped only if `project` would drop each of its splats.
__device__ __forceinline__ bool is_in_sight(const float *at, const View &w, u32 flags) {
  float box[7];
#pragma unroll
  for (int k = 0; k < 7; k++) box[k] = __ldg(at + k);
  float cx = (box[0] + box[3]) * 0.5f - w.eye[0], hx = (box[3] - box[0]) * 0.5f;
  float cy = (box[1] + box[4]) * 0.5f - w.eye[1], hy = (box[4] - box[1]) * 0.5f;
  float cz = (box[2] + box[5]) * 0.5f - w.eye[2], hz = (box[5] - box[2]) * 0.5f;
  float slack = (fabsf(cx) + fabsf(cy) + fabsf(cz) + hx + hy + hz) * 1e-5f;
  bool keep = true;
#pragma unroll
  for (int plane = 0; plane < 6; plane++) {
    float a = w.r[6], b = w.r[7], c = w.r[8], d, allow = 0.f;
    if (plane == 0) {
      a = -a, b = -b, c = -c, d = w.near;
    } else if (plane == 1) {
      d = -w.far;
    } else {
      bool along_y = plane >= 4, negative = plane & 1;
      float focal = along_y ? w.fy : w.fx, middle = along_y ? w.cy : w.cx;
      float size = along_y ? w.height : w.width;
      float limit = ((negative ? middle : size - middle) + PAD) / focal;
      float sign = negative ? -1.f : 1.f;
      a = sign * w.r[along_y ? 3 : 0], b = sign * w.r[along_y ? 4 : 1];
      c = sign * w.r[along_y ? 5 : 2];
      d = 0.f;
      if (flags & ORTHO) d = -limit;
      else a -= limit * w.r[6], b -= limit * w.r[7], c -= limit * w.r[8];
      allow = box[6] * (along_y ? w.gain_y : w.gain_x);
    }
    float lowest = a * cx + b * cy + c * cz - fabsf(a) * hx - fabsf(b) * hy - fabsf(c) * hz + d;
    if (lowest > allow * 1.0001f + slack * (fabsf(a) + fabsf(b) + fabsf(c))) keep = false;
  }
  return keep;
}

// What is known of all lists when they are written.
struct State {
  u64 needed, longest;  // entries: room for all, NO_ROOM if a list has outgrown its own; of a list
  u64 wrong;            // a view that is none: its number times four, and what is wrong
  u64 entries;
};
#define NO_ROOM 0xffffffffffffffffull

// Lists lie one behind another, with room by what a first pass has counted; or each has the same
// `room`, where the longest is known from calls before.
struct Lists {
  u32 *counts;   // [views, tiles]: entries so far; without `room`, where the next goes
  u64 *entries;  // null while they are counted
  u64 capacity;
  u32 room;

  __device__ __forceinline__ void store(u32 tile, u32 place, u64 key) const {
    u64 at = room ? (u64)tile * room + place : place;
    if (room ? place < room : at < capacity) entries[at] = key;
  }
};

template <bool EMIT>
__device__ __forceinline__ void put_one(const Lists &to, u32 tile, u64 key) {
  u32 place = atomicAdd(to.counts + tile, 1u);
  if (EMIT) to.store(tile, place, key);
}

// All lanes call this; neighbours in Morton order mostly list into the same tile.
template <bool EMIT>
__device__ __forceinline__ void put(const Lists &to, const bool (&active)[PUTS],
                                    const u32 (&tile)[PUTS], const u32 (&quarters)[PUTS], u64 key) {
#if GROUP
  u32 peers[PUTS], place[PUTS], lane = lane_id();
#pragma unroll
  for (int j = 0; j < PUTS; j++) {
    peers[j] = place[j] = 0;
    if (j && !__any_sync(FULL, active[j])) break;
    peers[j] = __match_any_sync(FULL, active[j] ? tile[j] : NOWHERE);
    if (active[j] && lane == (u32)__ffs(peers[j]) - 1)
      place[j] = atomicAdd(to.counts + tile[j], (u32)__popc(peers[j]));
  }
  if (!EMIT) return;
#pragma unroll
  for (int j = 0; j < PUTS; j++) {
    if (!peers[j]) break;
    u32 at = __shfl_sync(FULL, place[j], __ffs(peers[j]) - 1);
    if (active[j]) to.store(tile[j], at + __popc(peers[j] & ((1u << lane) - 1)), key | quarters[j]);
  }
#else
#pragma unroll
  for (int j = 0; j < PUTS; j++)
    if (active[j]) put_one<EMIT>(to, tile[j], key | quarters[j]);
#endif
}

// Quarters of a tile that a footprint's box meets.
__device__ __forceinline__ u32 find_quarters(const Box &box, int column, int row) {
  int x = column * TILE + TILE / 2, y = row * TILE + TILE / 2;
  u32 down = (u32)(box.y0 < y) | (u32)(box.y1 > y) << 1;
  return (box.x0 < x ? down : 0) | (box.x1 > x ? down << 2 : 0);
}

// Tile rows of column `column` that the ellipse reaches within its box.
__device__ __forceinline__ int2 tile_rows(const Ellipse &e, float u, float v, const Box &box, int column) {
  float dx = (float)(column * TILE) + 0.5f - u;
  float2 y = cut_rows(e, dx, dx + (float)(TILE - 1));
  float low = (float)box.y0, high = (float)box.y1;
  int y0 = (int)fminf(fmaxf(ceilf(v + y.x - 0.5f - EDGE), low), high);
  int y1 = (int)fmaxf(fminf(floorf(v + y.y - 0.5f + EDGE) + 1.f, high), low);
  return y0 < y1 ? make_int2((u32)y0 / TILE, (u32)(y1 + TILE - 1) / TILE) : make_int2(0, 0);
}

template <bool EMIT>
__device__ __forceinline__ void list_splat(const Splat &s, u32 index, const View &w, const float &nearer,
                                           u32 flags, u32 tiles_x, u32 first_tile, const Lists &to) {
  Footprint f;
  Box box = {0, 0, 0, 0};
  bool seen = project(s, w, flags, f) && bound(f, w, box);
  if (!__any_sync(FULL, seen)) return;
  // unsigned: a division of what may be negative takes three instructions
  int tx0 = (u32)box.x0 / TILE, tx1 = (u32)(box.x1 + TILE - 1) / TILE;
  int ty0 = (u32)box.y0 / TILE, ty1 = (u32)(box.y1 + TILE - 1) / TILE;
  int tiles = seen ? (tx1 - tx0) * (ty1 - ty0) : 0;
  // as on the CPU: an instance may be sorted as if nearer
  float order = INSTANCES ? fmaxf(f.z - nearer, f.z * 0.5f) : f.z;
  u64 key = (u64)__float_as_uint(order) << 32 | index;
  // small footprints: each lane walks the tiles of its own box, all in step
  bool large = tiles > LARGE;
  int column = tx0, row = large || tiles == 0 ? ty1 : ty0;
  while (true) {
    bool active[PUTS];
    u32 tile[PUTS], quarters[PUTS];
#pragma unroll
    for (int j = 0; j < PUTS; j++) {
      active[j] = row < ty1, tile[j] = first_tile + row * tiles_x + column;
      quarters[j] = EMIT && SPLIT ? find_quarters(box, column, row) : ALL_QUARTERS;
      if (++column == tx1) column = tx0, row++;
    }
    if (!__any_sync(FULL, active[0])) break;
    put<EMIT>(to, active, tile, quarters, key);
  }
  // large ones: their tiles are dealt out among the lanes, those that the ellipse reaches are listed
  if (!__any_sync(FULL, large)) return;
  Ellipse e = outline(f);
  u32 mine = large ? (u32)tiles : 0, upto = mine;
#pragma unroll
  for (u32 d = 1; d < WARP; d <<= 1) {
    u32 other = __shfl_up_sync(FULL, upto, d);
    if (lane_id() >= d) upto += other;
  }
  u32 total = __shfl_sync(FULL, upto, WARP - 1), before = upto - mine, across = tx1 - tx0;
  for (u32 first = 0; first < total; first += WARP * PUTS) {
    u32 tile[PUTS];
    u64 its_key[PUTS];
    bool reached[PUTS];
#pragma unroll
    for (int j = 0; j < PUTS; j++) {
      u32 item = first + j * WARP + lane_id(), from = 0;
#pragma unroll
      for (u32 step = WARP / 2; step; step >>= 1)  // whose tile it is
        if (__shfl_sync(FULL, upto, from + step - 1) <= item) from += step;
      u32 rest = item - __shfl_sync(FULL, before, from), wide = __shfl_sync(FULL, across, from);
      u32 down = rest / max(wide, 1u), x = __shfl_sync(FULL, tx0, from) + rest - down * wide;
      u32 y = __shfl_sync(FULL, ty0, from) + down;
      Ellipse one = {__shfl_sync(FULL, e.peak, from), __shfl_sync(FULL, e.inner, from),
                     __shfl_sync(FULL, e.steep, from), __shfl_sync(FULL, e.mixed, from),
                     __shfl_sync(FULL, e.scale, from)};
      Box its = {0, 0, __shfl_sync(FULL, box.y0, from), __shfl_sync(FULL, box.y1, from)};
      float u = __shfl_sync(FULL, f.u, from), v = __shfl_sync(FULL, f.v, from);
      its_key[j] = EMIT ? __shfl_sync(FULL, key, from) | ALL_QUARTERS : 0;
      int2 rows = tile_rows(one, u, v, its, (int)x);
      reached[j] = item < total && rows.x <= (int)y && (int)y < rows.y;
      tile[j] = first_tile + y * tiles_x + x;
    }
    u32 place[PUTS];
#pragma unroll
    for (int j = 0; j < PUTS; j++)
      if (reached[j]) place[j] = atomicAdd(to.counts + tile[j], 1u);
    if (!EMIT) continue;
#pragma unroll
    for (int j = 0; j < PUTS; j++)
      if (reached[j]) to.store(tile[j], place[j], its_key[j]);
  }
}

// The last group that begins at or before this block, with `before` blocks before the first.
__device__ __forceinline__ u32 find_group(const Group *__restrict__ groups, u32 count, u32 before) {
  u32 low = 0, high = count;
  while (high - low > 1) {
    u32 step = (high - low + WARP - 1) / WARP, at = low + lane_id() * step;
    bool begun = at < high && groups[at].first_block <= blockIdx.x + before;
    low += (__popc(__ballot_sync(FULL, begun)) - 1) * step;
    high = min(low + step, high);
  }
  return low;
}

struct alignas(16) ViewHeld {  // 36 words: lanes that read one word of many views meet few conflicts
  View view;
  u32 who;
  float nearer;
  u32 spare[2];
};

template <bool EMIT>
__device__ __forceinline__ void list_chunks(const View *__restrict__ views,
                                            const Cloud *__restrict__ clouds,
                                            const Group *__restrict__ groups, u32 group_count,
                                            const u32 *__restrict__ members, u32 tiles_x,
                                            u32 tiles, u32 flags, u32 each, u32 stride, const Lists &to) {
  __shared__ ViewHeld held[VIEWS];
  __shared__ u32 seen_by[CHUNKS];
  // groups of instances may be given alone: their blocks lie behind those of the others
  u32 before = INSTANCES ? groups->first_block : 0;
  // as many blocks as could be needed of whatever stands there: most have nothing to look for
  if (INSTANCES && blockIdx.x + before >= groups[group_count].first_block) return;
  const Group g = groups[find_group(groups, group_count, before)];
  const Cloud &cloud = clouds[g.cloud];
  u32 rows = (g.chunks + each - 1) / each, local = blockIdx.x + before - g.first_block;
  u32 first_chunk = local % rows * each, first = local / rows * VIEWS;
  u32 count = first < g.members ? min(g.members - first, (u32)VIEWS) : 0;
  if (!count) return;
  for (u32 k = threadIdx.x; k < count * 8; k += blockDim.x) {
    u32 view = members[g.first_member + first + k / 8];
    float4 words = ((const float4 *)(views + view))[k % 8];
    ((float4 *)&held[k / 8])[k % 8] = words;
    if (INSTANCES && k % 8 == 7) {  // these are `row` and `spare`
      bool part = __float_as_uint(words.z);
      held[k / 8].who = part ? __float_as_uint(words.w) : view;
      held[k / 8].nearer = part ? words.x : 0.f;
    }
    if (!INSTANCES && k % 8 == 0) held[k / 8].who = view;
  }
  __syncthreads();
  u32 mask = 0;
  for (u32 c = each == 1 ? 0 : threadIdx.x / WARP; c < each; c += blockDim.x / WARP) {
    bool seen = lane_id() < count && first_chunk + c < g.chunks &&
                is_in_sight(cloud.boxes + (u64)(first_chunk + c) * 7, held[lane_id()].view, flags);
    mask = __ballot_sync(FULL, seen);
    if (each > 1 && lane_id() == 0) seen_by[c] = mask;
  }
  if (each > 1) __syncthreads();  // else each warp has tested the one chunk
  for (u32 at = 0; at < each; at += stride) {
    u32 c = at, number = threadIdx.x, dealt = FULL;  // of the chunk, and of the splat in it
    if (stride > 1) {  // some of several chunks' at once, or of one chunk's for some of the views
      u32 which = threadIdx.x / (CHUNK / stride);
      if (each > 1) c += which;
      else dealt = FULL / ((1u << stride) - 1) << which;
      number = threadIdx.x % (CHUNK / stride) * stride + c % stride;
    }
    if (each > 1) mask = c < each ? seen_by[c] : 0;
    if (!mask || c >= each) continue;
    u32 slot = (first_chunk + c) * CHUNK + number;
    bool posed = INSTANCES && cloud.degree == PACKED;
    if (cloud.slots && !posed) slot = __ldg(cloud.slots + slot);
    Splat s = {0.f, 0.f, 0.f, -1.f, {0.f}, 0.f};
    u32 index = slot;
    if (slot < cloud.rows) {
      s = posed ? load_posed(cloud, slot) : load_splat(cloud.splats + (u64)slot * 4);
      if (EMIT && cloud.places) index = __ldg(cloud.order + slot);
    }
    if (INSTANCES && g.tail) index += TAIL_INDEX;
    index <<= QUARTER_BITS;
    if (!INSTANCES && g.tail) index |= TAIL;
    for (u32 rest = mask & dealt; rest; rest &= rest - 1) {
      const ViewHeld &one = held[__ffs(rest) - 1];
      u32 low = INSTANCES ? index | one.view.spare[IS_PART] : index;
      list_splat<EMIT>(s, low, load_view(one.view), one.nearer, flags, tiles_x, one.who * tiles, to);
    }
  }
}
