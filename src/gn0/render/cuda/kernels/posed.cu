// Clouds of people in poses: linear blend skinning of splats at rest, packed as `posed.cuh` says.

#define JOINTS 55
#define OF_JOINT 16  // floats: a transform [3, 4], and its turn as w, x, y, z

struct Posing {  // one cloud, 96 bytes
  const float4 *skin;  // [rows, 4] at rest: centre, normal, turn, weights, joints (bytes)
  const float4 *rest;  // [rows, 2], see `posed.cuh`
  const float *joints;      // [JOINTS, OF_JOINT]
  const float4 *floor;      // [lying] centre, log opacity
  uint4 *splats;            // [rows]
  float *boxes;             // [chunks, 7]
  float step;
  u32 first_block, alive, lying;  // the last `lying` of those `alive` lie on the floor
  u32 spare[8];
};

__device__ __forceinline__ u64 to_step(float value, float step) {
  float code = floorf(value / step + 0.5f), most = (float)(PLACE_ZERO - 1);
  return (u64)((int)fminf(fmaxf(code, -most), most) + PLACE_ZERO);
}

__device__ __forceinline__ u32 to_octahedron(float value) {
  return (u32)((int)floorf(fminf(fmaxf(value, -1.f), 1.f) * NORMAL_STEPS + 0.5f) + 2048);
}

// Of any length but 0, in the top 24 bits of a word.
__device__ __forceinline__ u32 pack_normal(float x, float y, float z) {
  float sum = fabsf(x) + fabsf(y) + fabsf(z), scale = 1.f / fmaxf(sum, 1e-30f);
  x *= scale, y *= scale;
  if (z < 0.f) {
    float u = (1.f - fabsf(y)) * (x < 0.f ? -1.f : 1.f);
    y = (1.f - fabsf(x)) * (y < 0.f ? -1.f : 1.f), x = u;
  }
  return to_octahedron(x) << 8 | to_octahedron(y) << 20;
}

// A turn of length 1 in 41 bits: which component is left out, and the other three.
__device__ __forceinline__ u64 pack_turn(const float *q) {
  u32 out = 0;
  for (u32 k = 1; k < 4; k++)
    if (fabsf(q[k]) > fabsf(q[out])) out = k;
  float sign = q[out] < 0.f ? -1.f : 1.f;
  u64 bits = (u64)out << (3 * TURN_BITS);
  for (u32 k = 0, at = 0; k < 4; k++) {
    if (k == out) continue;
    float code = floorf(q[k] * sign * (TURN_STEPS / ROOT_HALF) + 0.5f);
    bits |= (u64)((int)fminf(fmaxf(code, -TURN_STEPS), TURN_STEPS) + 4096) << (TURN_BITS * at++);
  }
  return bits;
}

// All clouds of a call, and the boxes of their chunks. Grid: chunks of all.
KERNEL(pose_splats)(const Posing *__restrict__ jobs, u32 count) {
  __shared__ float turns[JOINTS * OF_JOINT];
  __shared__ float low[3][CHUNK / WARP], high[4][CHUNK / WARP];
  u32 first = 0, last = count;
  while (last - first > 1) {
    u32 middle = (first + last) / 2;
    if (jobs[middle].first_block <= blockIdx.x) first = middle;
    else last = middle;
  }
  const Posing job = jobs[first];
  for (u32 k = threadIdx.x; k < JOINTS * OF_JOINT; k += blockDim.x) turns[k] = job.joints[k];
  __syncthreads();
  u32 chunk = blockIdx.x - job.first_block, row = chunk * CHUNK + threadIdx.x;
  uint4 packed = {0, 0, 0, 0};
  float lo[3] = {INFINITY, INFINITY, INFINITY}, hi[4] = {-INFINITY, -INFINITY, -INFINITY, 0.f};
  if (row < job.alive) {
    float p[3] = {0.f, 0.f, 0.f};
    if (row >= job.alive - job.lying) {
      float4 at = job.floor[row - (job.alive - job.lying)];
      p[0] = at.x, p[1] = at.y, p[2] = at.z;
      packed.z = __float_as_uint(at.w), packed.w = pack_normal(0.f, 0.f, 1.f);
    } else {
      const float4 *from = job.skin + (u64)row * 4;
      float4 a = from[0], b = from[1], c = from[2], d = from[3];
      float weight[4] = {c.z, c.w, d.x, d.y}, q[4] = {0.f, 0.f, 0.f, 0.f};
      u32 joint = __float_as_uint(d.z);
      const float *r = turns + (joint & 255u) * OF_JOINT + 12;
      for (u32 k = 0; k < 4; k++) {
        float share = weight[k];
        if (share <= 0.f) continue;
        const float *m = turns + (joint >> (8 * k) & 255u) * OF_JOINT;
        for (u32 i = 0; i < 3; i++)
          p[i] += share * (m[4 * i] * a.x + m[4 * i + 1] * a.y + m[4 * i + 2] * a.z + m[4 * i + 3]);
        // of the two quaternions of a turn, the one on the side of the heaviest joint's
        if (m[12] * r[0] + m[13] * r[1] + m[14] * r[2] + m[15] * r[3] < 0.f) share = -share;
        for (u32 i = 0; i < 4; i++) q[i] += share * m[12 + i];
      }
      float scale = 1.f / sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
      float w = q[0] * scale, x = q[1] * scale, y = q[2] * scale, z = q[3] * scale;
      float n[3] = {a.w, b.x, b.y};
      float e = y * n[2] - z * n[1] + w * n[0], f = z * n[0] - x * n[2] + w * n[1];
      float g = x * n[1] - y * n[0] + w * n[2];
      float ow = b.z, ox = b.w, oy = c.x, oz = c.y;
      float whole[4] = {w * ow - x * ox - y * oy - z * oz, w * ox + x * ow + y * oz - z * oy,
                        w * oy - x * oz + y * ow + z * ox, w * oz + x * oy - y * ox + z * ow};
      u64 turn = pack_turn(whole);
      packed.y = (u32)(turn >> 40) << 31, packed.z = (u32)turn;
      packed.w = (u32)(turn >> 32) & 0xffu;
      packed.w |= pack_normal(n[0] + 2.f * (y * g - z * f), n[1] + 2.f * (z * e - x * g),
                              n[2] + 2.f * (x * f - y * e));
    }
    u64 places = to_step(p[0], job.step) | to_step(p[1], job.step) << PLACE_BITS |
                 to_step(p[2] - MIDDLE, job.step) << (2 * PLACE_BITS);
    packed.x = (u32)places, packed.y |= (u32)(places >> 32);
    float4 a = job.rest[(u64)row * 2], b = job.rest[(u64)row * 2 + 1];
    const Splat s = read_posed(packed, a, b, job.step);
    if (s.extent >= 0.f) {
      lo[0] = hi[0] = s.x, lo[1] = hi[1] = s.y, lo[2] = hi[2] = s.z;
      hi[3] = s.extent * fmaxf(a.x, fmaxf(a.y, a.z)) * 1.0001f;
    }
  }
  job.splats[row] = packed;
  for (int d = WARP / 2; d; d >>= 1) {
    for (int k = 0; k < 3; k++) lo[k] = fminf(lo[k], __shfl_xor_sync(FULL, lo[k], d));
    for (int k = 0; k < 4; k++) hi[k] = fmaxf(hi[k], __shfl_xor_sync(FULL, hi[k], d));
  }
  u32 warp = threadIdx.x / WARP;
  if (lane_id() == 0) {
    for (int k = 0; k < 3; k++) low[k][warp] = lo[k];
    for (int k = 0; k < 4; k++) high[k][warp] = hi[k];
  }
  __syncthreads();
  if (threadIdx.x < 7) {
    u32 k = threadIdx.x;
    float v = k < 3 ? low[k][0] : high[k - 3][0];
    for (u32 w = 1; w < CHUNK / WARP; w++)
      v = k < 3 ? fminf(v, low[k][w]) : fmaxf(v, high[k - 3][w]);
    job.boxes[(u64)chunk * 7 + k] = v;
  }
}

#define NOBODY 0  // instead of a code
#define HASH_NONE -1

// Slots [count] of codes, by a hash table of a power of two of `places`; the slots that are found are
// stamped as used, and `asked` counts the stamps of each. Codes that are in none go to `missing` behind
// its first two words, of which the first counts them.
KERNEL(find_slots)(const u64 *__restrict__ codes, u32 count, const u64 *__restrict__ keys,
                   const int *__restrict__ slots, u32 places, u32 stamp, u32 *stamps, u32 *asked,
                   int *chosen, u64 *missing) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count) return;
  u64 code = codes[i];
  int found = HASH_NONE;
  if (code != NOBODY) {
    u64 mixed = code * 0x9e3779b97f4a7c15ull;
    for (u32 at = (u32)(mixed >> 32) & (places - 1);; at = (at + 1) & (places - 1)) {
      if (keys[at] == code) found = slots[at];
      if (keys[at] == code || keys[at] == NOBODY) break;
    }
    if (found == HASH_NONE) missing[2 + atomicAdd(missing, (u64)1)] = code;
    else if (atomicMax(stamps + found, stamp) < stamp) atomicAdd(asked + found, 1u);
  }
  chosen[i] = found;
}

// Behind `find_slots`: in which views [count] of `each` codes one lacks a slot, and how many those are
// in `many`, which begins at 0.
KERNEL(find_late)(const u64 *__restrict__ codes, const int *__restrict__ chosen, u32 each, u32 count,
                  int *late, u64 *many) {
  u32 v = blockIdx.x * blockDim.x + threadIdx.x;
  if (v >= count) return;
  bool lacks = false;
  for (u32 i = v * each; i < (v + 1) * each; i++) lacks = lacks || (codes[i] != NOBODY && chosen[i] == HASH_NONE);
  late[v] = lacks;
  if (lacks) atomicAdd(many, (u64)1);
}

// Put codes [count], once each, into the table of `find_slots`, each with the slot it was given, or
// HASH_NONE: it is in none from now on, and its place stays taken.
KERNEL(hold_slots)(const u64 *__restrict__ codes, const u64 *__restrict__ given, u32 count, u64 *keys,
                   int *slots, u32 places) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count) return;
  u64 code = codes[i], mixed = code * 0x9e3779b97f4a7c15ull;
  for (u32 at = (u32)(mixed >> 32) & (places - 1);; at = (at + 1) & (places - 1)) {
    u64 old = atomicCAS(keys + at, (u64)NOBODY, code);
    if (old != NOBODY && old != code) continue;
    slots[at] = (int)(i64)given[i];
    return;
  }
}
