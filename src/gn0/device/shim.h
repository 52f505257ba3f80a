// CUDA C++ on the host: one operating-system thread runs a grid's blocks one after another, and a
// block's threads as fibers that change over at barriers and warp operations. Slow and exact; for
// tests. Reads and writes beyond a buffer hit a guard page and are reported, not survived.
#pragma once
#define GN0_HOST 1
#include <algorithm>
#include <cmath>
#include <csetjmp>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <sys/mman.h>
#include <vector>
#if !defined(__x86_64__)
#include <ucontext.h>
#endif

#define __global__
#define __device__
#define __host__
#define __constant__ static const
#ifdef GN0_CHECKED  // see watch.cpp: shared memory lies together, so that it is known
#define __shared__ static thread_local
#else
#define __shared__ static
#endif
#define __forceinline__ inline __attribute__((always_inline))
#define __noinline__ __attribute__((noinline))
#define __launch_bounds__(...)
#define __align__(n) __attribute__((aligned(n)))
#define KERNEL(name) extern "C" void name
#define KERNEL_BOUNDED(name, threads, blocks) extern "C" void name
#define DYNAMIC_SHARED(name) u8 *name = gn0::dynamic_shared

struct alignas(8) float2 { float x, y; };
struct float3 { float x, y, z; };
struct alignas(16) float4 { float x, y, z, w; };
struct alignas(8) int2 { int x, y; };
struct int3 { int x, y, z; };
struct alignas(16) int4 { int x, y, z, w; };
struct alignas(8) uint2 { unsigned x, y; };
struct uint3 { unsigned x, y, z; };
struct alignas(16) uint4 { unsigned x, y, z, w; };
struct alignas(16) double2 { double x, y; };
struct alignas(4) short2 { short x, y; };
struct alignas(8) short4 { short x, y, z, w; };
struct alignas(4) ushort2 { unsigned short x, y; };
struct alignas(8) ushort4 { unsigned short x, y, z, w; };
struct uchar3 { unsigned char x, y, z; };
struct alignas(4) uchar4 { unsigned char x, y, z, w; };
struct dim3 { unsigned x = 1, y = 1, z = 1; };
inline float2 make_float2(float a, float b) { return {a, b}; }
inline float3 make_float3(float a, float b, float c) { return {a, b, c}; }
inline float4 make_float4(float a, float b, float c, float d) { return {a, b, c, d}; }
inline int2 make_int2(int a, int b) { return {a, b}; }
inline int4 make_int4(int a, int b, int c, int d) { return {a, b, c, d}; }
inline uint2 make_uint2(unsigned a, unsigned b) { return {a, b}; }
inline uint4 make_uint4(unsigned a, unsigned b, unsigned c, unsigned d) { return {a, b, c, d}; }
inline double2 make_double2(double a, double b) { return {a, b}; }
inline short4 make_short4(short a, short b, short c, short d) { return {a, b, c, d}; }
inline ushort4 make_ushort4(unsigned short a, unsigned short b, unsigned short c, unsigned short d) { return {a, b, c, d}; }
inline uchar3 make_uchar3(unsigned char a, unsigned char b, unsigned char c) { return {a, b, c}; }
inline uchar4 make_uchar4(unsigned char a, unsigned char b, unsigned char c, unsigned char d) { return {a, b, c, d}; }

#ifdef GN0_CHECKED
extern "C" {
extern unsigned gn0_thread;
extern int gn0_atomic;
void gn0_watch_launch(void (*on_fail)(const char *), void *inside, void *dynamic, size_t size);
void gn0_watch_block(unsigned number);
void gn0_watch_end();
void gn0_watch_barrier();
unsigned gn0_watch_meet();
void gn0_watch_met(unsigned mask, unsigned at);
}
#define WATCH(...) __VA_ARGS__
#else
#define WATCH(...)
#endif

namespace gn0 {

constexpr size_t STACK = 1 << 17;
constexpr int WARP_SIZE = 32;

#if defined(__x86_64__)
extern "C" void gn0_switch(void **save, void *load);
asm(R"(
.text
.type gn0_switch,@function
gn0_switch:
  pushq %rbp
  pushq %rbx
  pushq %r12
  pushq %r13
  pushq %r14
  pushq %r15
  movq %rsp, (%rdi)
  movq %rsi, %rsp
  popq %r15
  popq %r14
  popq %r13
  popq %r12
  popq %rbx
  popq %rbp
  ret
.size gn0_switch,.-gn0_switch
)");
#endif

struct Fiber {
#if defined(__x86_64__)
  void *stack_pointer = nullptr;
#else
  ucontext_t context;
#endif
  char *stack = nullptr;
  bool done = true;
  bool at_barrier = false;  // it waits for the round after `round` to begin
  uint64_t round = 0;
  unsigned mask = 0;     // the lanes that it waits for in a warp operation
  unsigned present = 0;  // those that took part in the last one
  unsigned met = 0;      // when, in a checked build
  int slot = -1;         // of its warp: what they gave
};

struct Warp {
  uint64_t value[WARP_SIZE];
  unsigned arrived = 0, alive = 0;
  uint64_t given[WARP_SIZE + 1][WARP_SIZE];  // of past operations, one that nobody reads among them
  uint8_t readers[WARP_SIZE + 1];            // threads whose last operation it was
};

static std::vector<Fiber> fibers;
static std::vector<Warp> warps;
static std::vector<uint3> places;  // of threads in their block
static const std::function<void()> *body;
static unsigned threads, alive, arrived, current;
static uint64_t barrier_round, progress;  // progress tells waiting from deadlock
static int votes, last_votes;
static unsigned char *dynamic_shared;
static dim3 grid_size, block_size;
static uint3 block_index, thread_index;
static char message[512];
static jmp_buf escape;
static volatile bool running;
static bool failed;
#if defined(__x86_64__)
static void *main_pointer;
#else
static ucontext_t main_context;
#endif

inline void to_main() {
  Fiber &me = fibers[current];
#if defined(__x86_64__)
  gn0_switch(&me.stack_pointer, main_pointer);
#else
  swapcontext(&me.context, &main_context);
#endif
}

inline void locate(unsigned t) {
  current = t;
  WATCH(gn0_thread = t;)
  thread_index = places[t];
}

inline void yield() { to_main(); }

inline void fail(const char *what) {
  if (!failed) snprintf(message, sizeof message, "%s (block %u, %u, %u, thread %u)", what, block_index.x, block_index.y, block_index.z, current);
  failed = true;
  to_main();  // never resumed
}

inline void release_barrier() {
  if (alive && arrived == alive) {
    arrived = 0;
    last_votes = votes;
    votes = 0;
    barrier_round++;
    progress++;
    WATCH(gn0_watch_barrier();)
  }
}

inline int barrier(int vote) {
  uint64_t round = barrier_round;
  arrived++;
  votes += vote != 0;
  progress++;
  release_barrier();
  Fiber &me = fibers[current];
  me.round = round;
  me.at_barrier = true;
  while (barrier_round == round) yield();
  me.at_barrier = false;
  return last_votes;
}

inline void complete_warp(Warp &w, unsigned warp, unsigned mask) {
  WATCH(unsigned met = gn0_watch_meet();)
  int slot = 0;
  while (w.readers[slot]) slot++;
  memcpy(w.given[slot], w.value, sizeof w.value);
  for (int l = 0; l < WARP_SIZE; l++)
    if (mask >> l & 1) {
      Fiber &f = fibers[warp * WARP_SIZE + l];
      if (f.slot >= 0) w.readers[f.slot]--;
      w.readers[slot]++;
      f.slot = slot;
      f.present = mask;
      WATCH(f.met = met;)
    }
  w.arrived &= ~mask;
  progress++;
}

// Every lane of `mask` gives a value; all of them, until the thread's next operation.
inline const uint64_t *exchange(unsigned mask, uint64_t value) {
  unsigned warp = current / WARP_SIZE, lane = current % WARP_SIZE;
  Warp &w = warps[warp];
  if (!(mask >> lane & 1)) fail("a warp operation whose mask leaves out the lane that calls it");
  w.value[lane] = value;
  w.arrived |= 1u << lane;
  progress++;
  while (w.arrived >> lane & 1) {
    unsigned real = mask & w.alive;  // lanes that have returned are not waited for; a card may
    WATCH(if (real != mask && threads % WARP_SIZE == 0) fail("a warp operation whose mask names lanes that have returned");)
    if ((w.arrived & real) == real) complete_warp(w, warp, real);
    else {
      fibers[current].mask = mask;
      yield();
      fibers[current].mask = 0;
    }
  }
  return w.given[fibers[current].slot];
}

static void entry() {
  (*body)();
  Fiber &me = fibers[current];
  me.done = true;
  alive--;
  progress++;
  warps[current / WARP_SIZE].alive &= ~(1u << (current % WARP_SIZE));
  release_barrier();
  to_main();
}

// Whether a thread would only find that what it waits for has not come.
inline bool waits(unsigned t) {
  const Fiber &f = fibers[t];
  if (f.at_barrier) return barrier_round == f.round;
  if (!f.mask) return false;
  const Warp &w = warps[t / WARP_SIZE];
  unsigned real = f.mask & w.alive;
  WATCH(if (real != f.mask) return false;)
  return (w.arrived >> (t % WARP_SIZE) & 1) && (w.arrived & real) != real;
}

// Stacks begin at addresses of their own within a page's distance, or a cache could hold few of them.
inline void prepare(Fiber &f, unsigned t) {
  if (!f.stack) f.stack = (char *)mmap(nullptr, STACK, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  f.done = f.at_barrier = false;
  f.mask = 0;
  f.slot = -1;
#if defined(__x86_64__)
  void **top = (void **)(f.stack + STACK - 64 - t % 61 * 192);
  *--top = nullptr;  // keeps the stack aligned as after a call
  *--top = (void *)entry;
  for (int i = 0; i < 6; i++) *--top = nullptr;
  f.stack_pointer = top;
#else
  getcontext(&f.context);
  f.context.uc_stack.ss_sp = f.stack;
  f.context.uc_stack.ss_size = STACK - t % 61 * 192;
  f.context.uc_link = nullptr;
  makecontext(&f.context, entry, 0);
#endif
}

inline void resume(unsigned t) {
  locate(t);
#if defined(__x86_64__)
  gn0_switch(&main_pointer, fibers[t].stack_pointer);
#else
  swapcontext(&main_context, &fibers[t].context);
#endif
}

static void caught(int, siginfo_t *info, void *) {
  if (!running) _exit(139);
  snprintf(message, sizeof message, "it reads or writes outside of every buffer, at %p (block %u, %u, %u, thread %u)", info->si_addr, block_index.x, block_index.y, block_index.z, current);
  siglongjmp(escape, 1);
}

static uint64_t shuffle_state;
inline unsigned next_random(unsigned below) {
  shuffle_state = shuffle_state * 6364136223846793005ull + 1442695040888963407ull;
  return (unsigned)((shuffle_state >> 33) % below);
}

// Returns 0, or 1 with a message. `seed` != 0 takes blocks and threads in a drawn order.
inline int run(const unsigned *grid, const unsigned *block, size_t shared, uint64_t seed, const std::function<void()> &work) {
  grid_size = {grid[0], grid[1], grid[2]};
  block_size = {block[0], block[1], block[2]};
  threads = block[0] * block[1] * block[2];
  fibers.resize(std::max<size_t>(fibers.size(), threads));
  places.resize(threads);
  for (unsigned t = 0; t < threads; t++)
    places[t] = {t % block_size.x, t / block_size.x % block_size.y, t / (block_size.x * block_size.y)};
  warps.resize((threads + 31) / 32);
  body = &work;
  failed = false;
  message[0] = 0;
  std::vector<unsigned char> pool(shared + 16);
  dynamic_shared = (unsigned char *)(((uintptr_t)pool.data() + 15) & ~(uintptr_t)15);
  WATCH(static thread_local volatile char touched; touched = 1;)  // or there is no such memory yet
  WATCH(gn0_watch_launch(fail, (void *)&message, dynamic_shared, shared);)
  std::vector<unsigned> order(threads);
  uint64_t blocks = (uint64_t)grid[0] * grid[1] * grid[2];
  shuffle_state = seed;
  static char signal_stack[1 << 16];
  stack_t fresh = {}, old_stack;
  fresh.ss_sp = signal_stack;
  fresh.ss_size = sizeof signal_stack;
  sigaltstack(&fresh, &old_stack);
  struct sigaction action = {}, old_segv, old_bus;
  action.sa_sigaction = caught;
  action.sa_flags = SA_SIGINFO | SA_ONSTACK | SA_NODEFER;
  sigaction(SIGSEGV, &action, &old_segv);
  sigaction(SIGBUS, &action, &old_bus);
  int result = 0;
  uint64_t stride = 1, first = 0;
  if (seed && blocks > 1) {
    first = next_random((unsigned)std::min<uint64_t>(blocks, 1u << 30));
    stride = 2 * next_random((unsigned)std::min<uint64_t>(blocks, 1u << 30)) + 1;
    auto gcd = [](uint64_t a, uint64_t b) { while (b) { uint64_t t = a % b; a = b; b = t; } return a; };
    while (gcd(stride, blocks) != 1) stride += 2;
  }
  if (sigsetjmp(escape, 1)) {
    result = 1;
    goto finish;
  }
  running = true;
  for (uint64_t n = 0; n < blocks; n++) {
    uint64_t b = (first + n * stride) % blocks;
    block_index = {(unsigned)(b % grid[0]), (unsigned)(b / grid[0] % grid[1]), (unsigned)(b / grid[0] / grid[1])};
    for (unsigned t = 0; t < threads; t++) {
      order[t] = t;
      prepare(fibers[t], t);
    }
    if (seed)
      for (unsigned t = threads; t > 1; t--) std::swap(order[t - 1], order[next_random(t)]);
    for (size_t w = 0; w < warps.size(); w++) {
      unsigned count = std::min(32u, threads - (unsigned)w * 32);
      warps[w].alive = count == 32 ? ~0u : (1u << count) - 1;
      warps[w].arrived = 0;
      memset(warps[w].readers, 0, sizeof warps[w].readers);
    }
    alive = threads;
    arrived = 0;
    votes = 0;
    WATCH(gn0_watch_block((unsigned)b);)
    while (alive) {
      uint64_t before = progress;
      for (unsigned t : order)
        if (!fibers[t].done && !waits(t)) {
          resume(t);
          if (failed) {
            result = 1;
            goto finish;
          }
        }
      if (alive && progress == before) {
        snprintf(message, sizeof message, "deadlock: threads wait at different barriers (block %u, %u, %u, %u of %u threads left)", block_index.x, block_index.y, block_index.z, alive, threads);
        result = 1;
        goto finish;
      }
    }
  }
finish:
  running = false;
  WATCH(gn0_watch_end();)
  sigaction(SIGSEGV, &old_segv, nullptr);
  sigaction(SIGBUS, &old_bus, nullptr);
  sigaltstack(&old_stack, nullptr);
  return result;
}

template <class T> inline uint64_t to_bits(T v) {
  uint64_t bits = 0;
  static_assert(sizeof(T) <= 8, "at most 8 bytes go through a warp operation");
  memcpy(&bits, &v, sizeof v);
  return bits;
}
template <class T> inline T from_bits(uint64_t bits) {
  T v;
  memcpy(&v, &bits, sizeof v);
  return v;
}

}  // namespace gn0

#define threadIdx gn0::thread_index
#define blockIdx gn0::block_index
#define blockDim gn0::block_size
#define gridDim gn0::grid_size
#define warpSize 32

inline void __syncthreads() { gn0::barrier(0); }
inline int __syncthreads_count(int p) { return gn0::barrier(p); }
inline int __syncthreads_or(int p) { return gn0::barrier(p) != 0; }
inline int __syncthreads_and(int p) { return gn0::barrier(!p) == 0; }
inline void __syncwarp(unsigned mask = ~0u) {
  gn0::exchange(mask, 0);
  WATCH(gn0_watch_met(gn0::fibers[gn0::current].present, gn0::fibers[gn0::current].met);)
}
inline void __threadfence() {}
inline void __threadfence_block() {}
inline unsigned __ballot_sync(unsigned mask, int p) {
  const uint64_t *v = gn0::exchange(mask, p != 0);
  unsigned out = 0;
  for (int l = 0; l < 32; l++)
    if (gn0::fibers[gn0::current].present >> l & 1) out |= (unsigned)v[l] << l;
  return out;
}
inline int __any_sync(unsigned mask, int p) { return __ballot_sync(mask, p) != 0; }
inline int __all_sync(unsigned mask, int p) {
  unsigned b = __ballot_sync(mask, p);
  return b == gn0::fibers[gn0::current].present;
}
template <class T> inline T __shfl_sync(unsigned mask, T v, int lane, int width = 32) {
  const uint64_t *all = gn0::exchange(mask, gn0::to_bits(v));
  int me = gn0::current & 31, from = (me & ~(width - 1)) | (lane & (width - 1));
  return gn0::from_bits<T>(all[from]);
}
template <class T> inline T __shfl_up_sync(unsigned mask, T v, unsigned d, int width = 32) {
  const uint64_t *all = gn0::exchange(mask, gn0::to_bits(v));
  int me = gn0::current & 31, from = me - (int)d;
  return gn0::from_bits<T>(all[from < (me & ~(width - 1)) ? me : from]);
}
template <class T> inline T __shfl_down_sync(unsigned mask, T v, unsigned d, int width = 32) {
  const uint64_t *all = gn0::exchange(mask, gn0::to_bits(v));
  int me = gn0::current & 31, from = me + (int)d;
  return gn0::from_bits<T>(all[from > (me | (width - 1)) ? me : from]);
}
template <class T> inline T __shfl_xor_sync(unsigned mask, T v, int x, int width = 32) {
  const uint64_t *all = gn0::exchange(mask, gn0::to_bits(v));
  int me = gn0::current & 31, from = me ^ x;
  return gn0::from_bits<T>(all[from > (me | (width - 1)) ? me : from]);
}
template <class T> inline unsigned __match_any_sync(unsigned mask, T v) {
  uint64_t mine = gn0::to_bits(v);
  const uint64_t *all = gn0::exchange(mask, mine);
  unsigned out = 0;
  for (int l = 0; l < 32; l++)
    if ((gn0::fibers[gn0::current].present >> l & 1) && all[l] == mine) out |= 1u << l;
  return out;
}
inline unsigned __reduce_add_sync(unsigned mask, unsigned v) {
  const uint64_t *all = gn0::exchange(mask, v);
  unsigned out = 0;
  for (int l = 0; l < 32; l++)
    if (gn0::fibers[gn0::current].present >> l & 1) out += (unsigned)all[l];
  return out;
}
inline unsigned __reduce_max_sync(unsigned mask, unsigned v) {
  const uint64_t *all = gn0::exchange(mask, v);
  unsigned out = 0;
  for (int l = 0; l < 32; l++)
    if (gn0::fibers[gn0::current].present >> l & 1) out = std::max(out, (unsigned)all[l]);
  return out;
}
inline unsigned __reduce_min_sync(unsigned mask, unsigned v) {
  const uint64_t *all = gn0::exchange(mask, v);
  unsigned out = ~0u;
  for (int l = 0; l < 32; l++)
    if (gn0::fibers[gn0::current].present >> l & 1) out = std::min(out, (unsigned)all[l]);
  return out;
}
inline unsigned __reduce_or_sync(unsigned mask, unsigned v) {
  const uint64_t *all = gn0::exchange(mask, v);
  unsigned out = 0;
  for (int l = 0; l < 32; l++)
    if (gn0::fibers[gn0::current].present >> l & 1) out |= (unsigned)all[l];
  return out;
}

namespace gn0 {
struct Atomic {  // what is between its ends counts as one operation
  Atomic() { WATCH(gn0_atomic++;) }
  ~Atomic() { WATCH(gn0_atomic--;) }
};
}  // namespace gn0
template <class T> inline T read_stale(const T *p) { gn0::Atomic one; return *p; }
template <class T, class U> inline T atomicAdd(T *p, U v) { gn0::Atomic one; T o = *p; *p = o + (T)v; return o; }
template <class T, class U> inline T atomicSub(T *p, U v) { gn0::Atomic one; T o = *p; *p = o - (T)v; return o; }
template <class T, class U> inline T atomicMax(T *p, U v) { gn0::Atomic one; T o = *p; *p = std::max(o, (T)v); return o; }
template <class T, class U> inline T atomicMin(T *p, U v) { gn0::Atomic one; T o = *p; *p = std::min(o, (T)v); return o; }
template <class T, class U> inline T atomicOr(T *p, U v) { gn0::Atomic one; T o = *p; *p = o | (T)v; return o; }
template <class T, class U> inline T atomicAnd(T *p, U v) { gn0::Atomic one; T o = *p; *p = o & (T)v; return o; }
template <class T, class U> inline T atomicXor(T *p, U v) { gn0::Atomic one; T o = *p; *p = o ^ (T)v; return o; }
template <class T, class U> inline T atomicExch(T *p, U v) { gn0::Atomic one; T o = *p; *p = (T)v; return o; }
template <class T, class U, class V> inline T atomicCAS(T *p, U c, V v) { gn0::Atomic one; T o = *p; if (o == (T)c) *p = (T)v; return o; }

inline int __popc(unsigned v) { return __builtin_popcount(v); }
inline int __popcll(unsigned long long v) { return __builtin_popcountll(v); }
inline int __ffs(int v) { return __builtin_ffs(v); }
inline int __ffsll(long long v) { return __builtin_ffsll(v); }
inline int __clz(int v) { return v ? __builtin_clz((unsigned)v) : 32; }
inline int __clzll(long long v) { return v ? __builtin_clzll((unsigned long long)v) : 64; }
inline unsigned __byte_perm(unsigned x, unsigned y, unsigned select) {
  unsigned long long both = (unsigned long long)y << 32 | x;
  unsigned out = 0;
  for (int k = 0; k < 4; k++) out |= (unsigned)(both >> (select >> 4 * k & 7) * 8 & 255) << 8 * k;
  return out;
}
inline unsigned __brev(unsigned v) {
  unsigned r = 0;
  for (int i = 0; i < 32; i++) r |= (v >> i & 1) << (31 - i);
  return r;
}
inline unsigned __umulhi(unsigned a, unsigned b) { return (unsigned)((uint64_t)a * b >> 32); }
template <class T> inline T __ldg(const T *p) { return *p; }
template <class T> inline T __ldcs(const T *p) { return *p; }
template <class T> inline T __ldcg(const T *p) { return *p; }
template <class T> inline void __stcs(T *p, T v) { *p = v; }
template <class T> inline void __stcg(T *p, T v) { *p = v; }
inline float __int_as_float(int v) { return gn0::from_bits<float>((unsigned)v); }
inline float __uint_as_float(unsigned v) { return gn0::from_bits<float>(v); }
inline int __float_as_int(float v) { return (int)gn0::to_bits(v); }
inline unsigned __float_as_uint(float v) { return (unsigned)gn0::to_bits(v); }
inline long long __double_as_longlong(double v) { return (long long)gn0::to_bits(v); }
inline double __longlong_as_double(long long v) { return gn0::from_bits<double>((uint64_t)v); }
inline float __fmaf_rn(float a, float b, float c) { return fmaf(a, b, c); }
inline float __fmul_rn(float a, float b) { return a * b; }
inline float __fadd_rn(float a, float b) { return a + b; }
inline float __fdiv_rn(float a, float b) { return a / b; }
inline float __fsqrt_rn(float a) { return sqrtf(a); }
inline float __fdividef(float a, float b) { return a / b; }
inline int __float2int_rd(float v) { return (int)floorf(v); }
inline int __float2int_ru(float v) { return (int)ceilf(v); }
inline int __float2int_rn(float v) { return (int)rintf(v); }
inline int __float2int_rz(float v) { return (int)v; }
inline float __saturatef(float v) { return v > 0.f ? (v < 1.f ? v : 1.f) : 0.f; }
inline float fast_exp2(float x) { return x < -126.f ? 0.f : exp2f(x); }
inline float fast_log2(float x) { return log2f(x); }
inline float fast_rsqrt(float x) { return 1.f / sqrtf(x); }
inline float fast_rcp(float x) { return 1.f / x; }
inline float half_to_float(unsigned short h) {
  _Float16 v;
  memcpy(&v, &h, 2);
  return (float)v;
}
inline unsigned short float_to_half(float f) {
  _Float16 v = (_Float16)f;
  unsigned short h;
  memcpy(&h, &v, 2);
  return h;
}
template <class T> inline T min(T a, T b) { return b < a ? b : a; }
template <class T> inline T max(T a, T b) { return a < b ? b : a; }
inline float min(float a, float b) { return fminf(a, b); }
inline float max(float a, float b) { return fmaxf(a, b); }
inline double min(double a, double b) { return fmin(a, b); }
inline double max(double a, double b) { return fmax(a, b); }
inline unsigned min(unsigned a, int b) { return min(a, (unsigned)b); }
inline unsigned max(unsigned a, int b) { return max(a, (unsigned)b); }
inline unsigned min(int a, unsigned b) { return min((unsigned)a, b); }
inline unsigned max(int a, unsigned b) { return max((unsigned)a, b); }
