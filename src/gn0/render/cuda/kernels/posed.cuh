// A splat of a posed cloud: 16 bytes of what a pose changes, 32 of what no pose does.
//
//   packed, words 0, 1  x, y, z: steps of the cloud from its middle, plus 2^20, 21 bits each; bit 40
//                       of the turn
//           words 2, 3  bits 0 to 39 of the turn: its three least components, 13 bits each, and in
//                       bits 39 and 40 which is left out; of a splat on the floor its log opacity;
//                       in the top 24 bits the normal, two numbers on an unfolded octahedron
//   at rest, float4 0   scales, log opacity
//            float4 1   four halves: red, green, blue, 0; extent in standard deviations (-1: padding)
//
// A cloud of such splats has PACKED for a degree, what rests in place of `slots`, its step [m] in
// place of `sh_row`; its middle is a metre over its origin. A splat whose extent is ON_FLOOR lies
// flat, and has an opacity of its own.

#define PACKED 8u
#define ON_FLOOR -2.f
#define MIDDLE 1.f  // m
#define PLACE_BITS 21
#define PLACE_ZERO (1 << (PLACE_BITS - 1))
#define TURN_BITS 13
#define TURN_STEPS 4095.f
#define NORMAL_BITS 12
#define NORMAL_STEPS 2047.f
#define ROOT_HALF 0.70710678f

__device__ __forceinline__ float read_place(u64 bits, u32 axis, float step) {
  u32 code = (u32)(bits >> (PLACE_BITS * axis)) & ((1u << PLACE_BITS) - 1);
  return (float)((int)code - PLACE_ZERO) * step;
}

// The normal of a splat, as `part.cuh` would have unpacked it: not of length 1.
__device__ __forceinline__ float2 read_posed_normal(u32 last) {
  u32 x = last >> 8 & 0xfffu, y = last >> 20;
  return make_float2((float)((int)x - 2048) * (1.f / NORMAL_STEPS),
                     (float)((int)y - 2048) * (1.f / NORMAL_STEPS));
}

__device__ __forceinline__ Splat read_posed(uint4 p, float4 a, float4 b, float step) {
  Splat s;
  u64 places = (u64)p.y << 32 | p.x;
  s.x = read_place(places, 0, step), s.y = read_place(places, 1, step);
  s.z = read_place(places, 2, step) + MIDDLE;
  s.extent = b.z, s.log_opacity = a.w;
  float c[3], left = 1.f;
  u64 turn = (u64)(p.y >> 31) << 40 | (u64)(p.w & 0xffu) << 32 | p.z;
  u32 out = (u32)(turn >> (3 * TURN_BITS));
  bool lies = b.z == ON_FLOOR;
  if (lies) {
    s.log_opacity = __uint_as_float(p.z);
    float squared = 2.f * (s.log_opacity - LOG_ALPHA_MIN);
    s.extent = squared >= 0.f ? sqrtf(squared) : -1.f;
    out = 0;
  }
  for (u32 k = 0; k < 3; k++) {
    u32 code = (u32)(turn >> (TURN_BITS * k)) & ((1u << TURN_BITS) - 1);
    c[k] = lies ? 0.f : (float)((int)code - 4096) * (ROOT_HALF / TURN_STEPS);
    left -= c[k] * c[k];
  }
  float most = sqrtf(fmaxf(left, 0.f));
  float w = out == 0 ? most : c[0], x = out == 1 ? most : out < 1 ? c[0] : c[1];
  float y = out == 2 ? most : out < 2 ? c[1] : c[2], z = out == 3 ? most : c[2];
  s.m[0] = (1.f - 2.f * (y * y + z * z)) * a.x, s.m[1] = 2.f * (x * y - w * z) * a.y;
  s.m[2] = 2.f * (x * z + w * y) * a.z, s.m[3] = 2.f * (x * y + w * z) * a.x;
  s.m[4] = (1.f - 2.f * (x * x + z * z)) * a.y, s.m[5] = 2.f * (y * z - w * x) * a.z;
  s.m[6] = 2.f * (x * z - w * y) * a.x, s.m[7] = 2.f * (y * z + w * x) * a.y;
  s.m[8] = (1.f - 2.f * (x * x + y * y)) * a.z;
  return s;
}

__device__ __forceinline__ Splat load_posed(const Cloud &cloud, u32 slot) {
  const float4 *rest = (const float4 *)cloud.slots + (u64)slot * 2;
  return read_posed(__ldg((const uint4 *)cloud.splats + slot), __ldg(rest), __ldg(rest + 1),
                    __uint_as_float(cloud.sh_row));
}
