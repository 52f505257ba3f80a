// The checked emulation: who touched which byte of device memory, and whether a barrier lay between.
//
// Kernels are compiled with -fsanitize=thread and -fsanitize=undefined, and this file takes the
// place of their run-time libraries. Two accesses of one byte by different threads, one of them a
// write and not both atomic, must be ordered: by __syncthreads, by __syncwarp for lanes of one warp
// (votes and shuffles order no memory), or by the end of a launch. Blocks are never ordered.
// A read must find what somebody wrote: in shared memory, the block itself.
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <link.h>
#include <map>
#include <memory>
#include <unordered_map>

namespace {

typedef uint32_t u32;
constexpr u32 HOST = ~0u, LANES = 32, THREADS = 1024, ATOMIC = 1u << 31;

struct Access {
  u32 who = 0, tick = 0, pc = 0;  // who: block * 1024 + thread; tick 0: there was none
};
struct Cell {  // of one byte
  Access write, read, also;  // two readers, of different warps if there are such
};
struct Page {
  Cell cells[4096];
};

std::unordered_map<uintptr_t, std::unique_ptr<Page>> pages;
std::map<uintptr_t, uintptr_t> buffers;  // end -> begin
uintptr_t last_low, last_high, last_number, shared_low, shared_high, dynamic_low, dynamic_high, library;
Page *last_page;
u32 tick, launch_tick, barrier_tick, block;
u32 known[THREADS][LANES];  // up to which tick a thread knows of each lane of its warp
void (*fail)(const char *);
bool watching;

Cell &cell_at(uintptr_t at) {
  if (!last_page || last_number != at >> 12) {
    std::unique_ptr<Page> &page = pages[last_number = at >> 12];
    if (!page) page.reset(new Page());
    last_page = page.get();
  }
  return last_page->cells[at & 4095];
}

bool is_shared(uintptr_t at) {
  return (at >= shared_low && at < shared_high) || (at >= dynamic_low && at < dynamic_high);
}

bool is_buffer(uintptr_t at) {
  if (at >= last_low && at < last_high) return true;
  auto found = buffers.upper_bound(at);
  if (found == buffers.end() || at < found->second) return false;
  last_low = found->second, last_high = found->first;
  return true;
}

}  // namespace

extern "C" {

u32 gn0_thread;      // that runs
int gn0_atomic;      // whether it is inside an atomic operation, or reads what may be stale

void gn0_watch_allocate(uintptr_t begin, uintptr_t size) {
  buffers[begin + size] = begin;
  for (uintptr_t at = begin; at < begin + size; at++) cell_at(at) = Cell();
}
void gn0_watch_release(uintptr_t begin, uintptr_t size) {
  buffers.erase(begin + size);
  last_low = last_high = 0;
  for (uintptr_t page = begin >> 12; page <= (begin + size) >> 12; page++) pages.erase(page);
  last_page = nullptr;
}
// The host has filled memory.
void gn0_watch_fill(uintptr_t begin, uintptr_t size) {
  for (uintptr_t at = begin; at < begin + size; at++)
    if (is_buffer(at)) cell_at(at).write = {HOST, launch_tick = ++tick, 0};
}

// `inside`: an address in the kernels' library, whose thread-local memory is the static shared one.
void gn0_watch_launch(void (*on_fail)(const char *), void *inside, void *dynamic, size_t size) {
  fail = on_fail;
  gn0_atomic = 0;
  launch_tick = ++tick;
  tick++;
  dynamic_low = (uintptr_t)dynamic, dynamic_high = dynamic_low + size;
  shared_low = shared_high = 0;
  dl_iterate_phdr(
      [](dl_phdr_info *info, size_t, void *inside) {
        bool mine = false;
        size_t size = 0;
        for (int k = 0; k < info->dlpi_phnum; k++) {
          const auto &part = info->dlpi_phdr[k];
          uintptr_t low = info->dlpi_addr + part.p_vaddr;
          if (part.p_type == PT_LOAD && (uintptr_t)inside - low < part.p_memsz) mine = true;
          if (part.p_type == PT_TLS) size = part.p_memsz;
        }
        if (mine) library = info->dlpi_addr;
        if (mine && size && info->dlpi_tls_data) {
          shared_low = (uintptr_t)info->dlpi_tls_data;
          shared_high = shared_low + size;
        }
        return (int)mine;
      },
      inside);
}
void gn0_watch_block(u32 number) {
  block = number;
  barrier_tick = ++tick;
  tick++;
  memset(known, 0, sizeof known);
  watching = true;
}
void gn0_watch_end() { watching = false; }
void gn0_watch_barrier() { barrier_tick = tick++; }
u32 gn0_watch_meet() { return tick++; }
void gn0_watch_met(u32 mask, u32 at) {
  for (u32 lane = 0; lane < LANES; lane++)
    if (mask >> lane & 1) known[gn0_thread][lane] = at;
}

static void say(const char *text, ...) {
  static char message[400];
  va_list list;
  va_start(list, text);
  vsnprintf(message, sizeof message, text, list);
  va_end(list);
  watching = false;
  fail(message);
}

static bool is_before(const Access &a, bool shared) {
  if (a.tick <= launch_tick) return true;
  u32 who = a.who & ~ATOMIC, me = gn0_thread;
  if (who >> 10 != block) return shared;
  who &= THREADS - 1;
  if (who == me || a.tick <= barrier_tick) return true;
  return who / LANES == me / LANES && a.tick <= known[me][who % LANES];
}

static bool check(uintptr_t at, size_t size, bool writes, void *pc) {
  bool shared = is_shared(at);
  if (!shared && !is_buffer(at)) return true;
  u32 here = (u32)((uintptr_t)pc - library - 1);
  const char *where = shared ? "shared" : "global", *does = writes ? "writes" : "reads";
  Access mine = {block << 10 | gn0_thread | (gn0_atomic ? ATOMIC : 0), tick, here};
  for (uintptr_t b = at; b < at + size; b++) {
    if (!shared && !is_buffer(b)) continue;
    Cell &cell = cell_at(b);
    const Access *other = nullptr;
    bool both = gn0_atomic && cell.write.who & ATOMIC;
    if (cell.write.tick && !both && !is_before(cell.write, shared)) other = &cell.write;
    if (writes && !other)
      for (const Access *read : {&cell.read, &cell.also})
        if (read->tick && !(gn0_atomic && read->who & ATOMIC) && !is_before(*read, shared)) other = read;
    if (other) {
      u32 who = other->who & ~ATOMIC;
      say("a race: it %s %s memory that thread %u of block number %u %s, with nothing to order them; here @%x, there @%x",
          does, where, who & (THREADS - 1), who >> 10, other == &cell.write ? "wrote" : "read", here, other->pc);
      return false;
    }
    if (writes) {  // of a thread's own writes since the barrier the plain one says more
      bool plain = cell.write.who == (mine.who & ~ATOMIC) && cell.write.tick > barrier_tick;
      if (!(gn0_atomic && plain)) cell.write = mine;
      continue;
    }
    const Access &last = cell.write;
    bool fresh = !last.tick ||
                 (shared && (last.tick <= launch_tick || (last.who & ~ATOMIC) >> 10 != block));
    if (fresh) {
      say("it reads %s memory that nobody has written; here @%x", where, here);
      return false;
    }
    u32 me = mine.who >> 5;
    if (!cell.read.tick || is_before(cell.read, shared)) cell.read = mine;
    else if (!cell.also.tick || is_before(cell.also, shared) || cell.also.who >> 5 == cell.read.who >> 5 || cell.also.who >> 5 == me)
      cell.also = mine;
  }
  return true;
}

#define ACCESS(size)                                                                                                        \
  void __tsan_read##size(void *p) { if (watching) check((uintptr_t)p, size, false, __builtin_return_address(0)); }          \
  void __tsan_write##size(void *p) { if (watching) check((uintptr_t)p, size, true, __builtin_return_address(0)); }          \
  void __tsan_unaligned_read##size(void *p) { if (watching) check((uintptr_t)p, size, false, __builtin_return_address(0)); } \
  void __tsan_unaligned_write##size(void *p) { if (watching) check((uintptr_t)p, size, true, __builtin_return_address(0)); }
ACCESS(1)
ACCESS(2)
ACCESS(4)
ACCESS(8)
ACCESS(16)
void __tsan_read_range(void *p, size_t n) { if (watching) check((uintptr_t)p, n, false, __builtin_return_address(0)); }
void __tsan_write_range(void *p, size_t n) { if (watching) check((uintptr_t)p, n, true, __builtin_return_address(0)); }
void __tsan_vptr_update(void **, void *) {}
void __tsan_init() {}

struct Place {
  const char *file;
  u32 line, column;
};
static void undefined(const Place *at, const char *what) {
  if (watching) say("%s, in %s:%u", what, at->file, at->line);
}
#define UNDEFINED(name, what) \
  void __ubsan_handle_##name(const Place *at) { undefined(at, what); }
UNDEFINED(out_of_bounds, "an index beyond its array")
UNDEFINED(shift_out_of_bounds, "a shift by more than the bits there are, which a card and a CPU do differently")
UNDEFINED(float_cast_overflow, "a number that the integer cannot hold, which a card and a CPU do differently")
UNDEFINED(divrem_overflow, "a division by zero")
UNDEFINED(type_mismatch_v1, "an address that is not aligned, or null")
UNDEFINED(pointer_overflow, "an address that overflows")
UNDEFINED(builtin_unreachable, "code that was never to be reached")
UNDEFINED(missing_return, "a function that returns nothing")
UNDEFINED(load_invalid_value, "a bool that is neither true nor false")
}
