// What every kernel may use, on a GPU from sm_75 on (NVRTC, nvcc) and in the host emulation (g++ with shim.h).
//
// The emulation runs the threads of a block as fibers, one block after another. So that it can:
//   * no #include, no standard library, no textures, no cooperative groups, no inline assembly
//     outside `#ifndef GN0_HOST`;
//   * kernels are `KERNEL(name)(type a, type b) { ... }` at file scope, no overloads and no
//     template parameters of their own (call a template from a kernel instead); or
//     `KERNEL_BOUNDED(name, threads a block, blocks a multiprocessor)(...)`;
//   * static shared memory is `__shared__ type name[...]`; the dynamic one is
//     `DYNAMIC_SHARED(name)`, bytes aligned to 16;
//   * warp operations are the `_sync` ones; every lane of the mask must reach the same call;
//   * `__syncthreads()` is reached by every thread of the block that has not returned.
// The compiler is told --fmad=false: write `fmaf` where a fused operation is wanted, so that two
// kernels that compute the same thing get the same bits, and the emulation gets them too.
// `fast_exp2`, `fast_log2`, `fast_rsqrt`, `fast_rcp` are approximate and may differ between machines.

typedef unsigned char u8;
typedef unsigned short u16;
typedef unsigned int u32;
typedef unsigned long long u64;
typedef long long i64;

#define WARP 32
#define FULL 0xffffffffu

#ifndef GN0_HOST
#define KERNEL(name) extern "C" __global__ void name
#define KERNEL_BOUNDED(name, threads, blocks) \
  extern "C" __global__ void __launch_bounds__(threads, blocks) name
#define DYNAMIC_SHARED(name) extern __shared__ __align__(16) u8 name[]
#define INFINITY __int_as_float(0x7f800000)

__device__ __forceinline__ float fast_exp2(float x) {
  float y;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ float fast_log2(float x) {
  float y;
  asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ float fast_rsqrt(float x) {
  float y;
  asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ float fast_rcp(float x) {
  float y;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ float half_to_float(u16 h) {
  float f;
  asm("cvt.f32.f16 %0, %1;" : "=f"(f) : "h"(h));
  return f;
}
__device__ __forceinline__ u16 float_to_half(float f) {
  u16 h;
  asm("cvt.rn.f16.f32 %0, %1;" : "=h"(h) : "f"(f));
  return h;
}

// What another thread may be changing by an atomic operation: a value that it had, maybe an old one.
template <class T> __device__ __forceinline__ T read_stale(const T *p) { return *p; }

#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800  // cards before Ampere lack these
#define REDUCE_SYNC(name, combine)                                                        \
  __device__ __forceinline__ u32 name(u32 mask, u32 v) {                                  \
    if (mask == FULL) {                                                                   \
      for (int d = WARP / 2; d; d >>= 1) v = combine(v, __shfl_xor_sync(FULL, v, d));     \
      return v;                                                                           \
    }                                                                                     \
    u32 all = __shfl_sync(mask, v, __ffs(mask) - 1);                                      \
    for (u32 m = mask & (mask - 1); m; m &= m - 1)                                        \
      all = combine(all, __shfl_sync(mask, v, __ffs(m) - 1));                             \
    return all;                                                                           \
  }
__device__ __forceinline__ u32 sum_of(u32 a, u32 b) { return a + b; }
__device__ __forceinline__ u32 bits_of(u32 a, u32 b) { return a | b; }
REDUCE_SYNC(__reduce_add_sync, sum_of)
REDUCE_SYNC(__reduce_min_sync, min)
REDUCE_SYNC(__reduce_max_sync, max)
REDUCE_SYNC(__reduce_or_sync, bits_of)
#endif
#endif

__device__ __forceinline__ u32 lane_id() { return threadIdx.x & (WARP - 1); }
