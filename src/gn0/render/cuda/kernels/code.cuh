// Instead of a splat's colour: what it belongs to. For `labels.cu`, whose tables of clouds have codes
// (uint32 a packed splat, null where all are 0) where others have spherical harmonics. With WHO the
// code of all its splats stands there.

__device__ __forceinline__ float3 find_colour(const Cloud &cloud, const Splat &, u32 slot, const View &) {
  u32 code = WHO ? (u32)(u64)cloud.sh : cloud.sh ? __ldg((const u32 *)cloud.sh + slot) : 0;
  return make_float3(__uint_as_float(code), 0.f, 0.f);
}
