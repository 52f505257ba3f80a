// A pretended libcuda on host memory: counts calls, fails on demand, and runs kernels that the host
// emulation compiled ("FAKE:" and the path of its library stand for a module's image).
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef int R;
typedef uint64_t P;
#define ENTER { int code_ = enter(__func__); if (code_) return code_; }
#define OURS { if (context != &primary) return 201; }

static struct { char name[64]; long calls; int code, wait; } table[128];
static int known;
static int primary, foreign;  // two contexts
static __thread void *context;
static size_t limit = 1 << 30, used, reserved;
static long live;

static int slot(const char *name) {
  for (int i = 0; i < known; i++) if (!strcmp(table[i].name, name)) return i;
  strncpy(table[known].name, name, 63);
  return known++;
}
void fake_fail(const char *name, int code, int wait) { int i = slot(name); table[i].code = code; table[i].wait = wait; }
void fake_once(const char *name, int code) { int i = slot(name); table[i].code = -code; }
void fake_forget(const char *name) { table[slot(name)].calls = 0; }
long fake_calls(const char *name) { return table[slot(name)].calls; }
long fake_total(void) { long n = 0; for (int i = 0; i < known; i++) n += table[i].calls; return n; }
long fake_live(void) { return live; }
void fake_limit(size_t bytes) { limit = bytes; }
void *fake_context(int other) { context = other ? (void *)&foreign : NULL; return context; }
void *fake_current(void) { return context == &foreign ? (void *)2 : context == &primary ? (void *)1 : NULL; }
static int number(const char *name, int otherwise) { const char *t = getenv(name); return t ? atoi(t) : otherwise; }

static int enter(const char *name) {
  int i = slot(name);
  table[i].calls++;
  const char *plan = getenv("FAKE_CUDA_FAIL");  // "cuInit=100"
  size_t n = strlen(name);
  if (plan && !strncmp(plan, name, n) && plan[n] == '=') return atoi(plan + n + 1);
  if (table[i].code < 0) { int once = -table[i].code; table[i].code = 0; return once; }
  if (table[i].code && table[i].wait-- <= 0) return table[i].code;
  return 0;
}

R cuInit(unsigned f) { ENTER return 0; }
R cuDriverGetVersion(int *v) { ENTER *v = number("FAKE_CUDA_VERSION", 12080); return 0; }
R cuGetErrorName(int code, const char **text) {
  *text = code == 2 ? "CUDA_ERROR_OUT_OF_MEMORY" : code == 100 ? "CUDA_ERROR_NO_DEVICE" : code == 700 ? "CUDA_ERROR_ILLEGAL_ADDRESS"
    : code == 719 ? "CUDA_ERROR_LAUNCH_FAILED" : code == 803 ? "CUDA_ERROR_SYSTEM_DRIVER_MISMATCH" : code == 209 ? "CUDA_ERROR_NO_BINARY_FOR_GPU" : NULL;
  return *text ? 0 : 1;
}
R cuDeviceGetCount(int *n) { ENTER *n = number("FAKE_CUDA_COUNT", 2); return 0; }
R cuDeviceGet(int *d, int i) { ENTER *d = i; return 0; }
R cuDeviceGetName(char *text, int n, int d) { ENTER snprintf(text, n, "Pretended Card %d", d); return 0; }
R cuDeviceGetAttribute(int *v, int a, int d) {
  ENTER
  *v = a == 16 ? 132 : a == 75 ? number("FAKE_CUDA_MAJOR", 9) : a == 76 ? 0 : a == 97 ? 227 * 1024 : a == 115 ? number("FAKE_CUDA_POOLS", 1) : 1;
  return 0;
}
R cuDeviceTotalMem_v2(size_t *n, int d) { ENTER *n = limit; return 0; }
R cuDevicePrimaryCtxRetain(void **c, int d) { ENTER *c = &primary; return 0; }
R cuCtxGetCurrent(void **c) { *c = context; return 0; }
R cuCtxSetCurrent(void *c) { ENTER context = c; return 0; }
static __thread void *before;
R cuCtxPushCurrent_v2(void *c) { ENTER before = context; context = c; return 0; }
R cuCtxPopCurrent_v2(void **c) { ENTER *c = context; context = before; return 0; }

// Blocks begin with their size; a pool keeps `reserved` until it is trimmed.
static R take(P *out, size_t size) {
  if (used + size > limit) return 2;
  if (used + size > reserved && reserved + size > limit) return 2;
  size_t *block = aligned_alloc(256, 256 + (size + 255) / 256 * 256);
  block[0] = size;
  memset((char *)block + 256, 0xff, size);
  used += size;
  if (reserved < used) reserved = used;
  live++;
  *out = (P)block + 256;
  return 0;
}
static void give(P p) { size_t *block = (size_t *)(p - 256); used -= block[0]; live--; free(block); }
R cuMemGetInfo_v2(size_t *f, size_t *t) { ENTER OURS *f = limit - reserved; *t = limit; return 0; }
R cuMemAlloc_v2(P *p, size_t n) { ENTER OURS return take(p, n); }
R cuMemFree_v2(P p) { ENTER OURS give(p); reserved = used; return 0; }
R cuMemPoolCreate(void **pool, const void *properties) {
  ENTER OURS
  const int *v = properties;
  if (v[0] != 1 || v[1] || v[2] != 1) return 1;
  *pool = &reserved;
  return 0;
}
R cuMemPoolSetAttribute(void *pool, int a, void *v) { ENTER return a == 4 && *(uint64_t *)v == ~0ull ? 0 : 1; }
R cuMemPoolGetAttribute(void *pool, int a, void *v) { ENTER *(uint64_t *)v = a == 5 ? reserved : used; return 0; }
R cuMemPoolTrimTo(void *pool, size_t keep) { ENTER reserved = used; return 0; }
R cuMemAllocFromPoolAsync(P *p, size_t n, void *pool, void *s) { ENTER OURS return take(p, n); }
R cuMemFreeAsync(P p, void *s) { ENTER OURS give(p); return 0; }
R cuMemHostAlloc(void **p, size_t n, unsigned f) { ENTER OURS *p = malloc(n); live++; return 0; }
R cuMemFreeHost(void *p) { ENTER OURS free(p); live--; return 0; }
R cuPointerGetAttribute(void *v, int a, P p) { ENTER *(int *)v = 0; return 0; }

// Work: done at once, or noted in the graph that its stream records.
typedef struct { char name[64]; R (*entry)(const unsigned *, const unsigned *, size_t, uint64_t, void **); const size_t *sizes; int shared; } Function;
typedef struct { int kind; P to; const void *from; size_t size; int byte; Function *f; unsigned grid[3], block[3]; unsigned char cells[8192] __attribute__((aligned(16))); } Step;
typedef struct { Step *steps; int count; int recording; } Graph;
static Graph streams[8];
static int stream_count;

static R run(Step *s) {
  if (s->kind == 0) memset((void *)s->to, s->byte, s->size);
  else if (s->kind == 1) memcpy((void *)s->to, s->from, s->size);
  else if (s->f->entry) {
    void *p[64];
    for (size_t i = 0, at = 0; s->f->sizes[i]; at += (s->f->sizes[i++] + 15) / 16 * 16) p[i] = s->cells + at;
    return s->f->entry(s->grid, s->block, s->size, 1, p) ? 719 : 0;
  }
  return 0;
}
static R work(Step *s, void *stream) {
  if (context != &primary) return 201;
  if (stream && ((Graph *)stream)->recording) {
    Graph *g = stream;
    g->steps = realloc(g->steps, (g->count + 1) * sizeof(Step));
    g->steps[g->count++] = *s;
    return 0;
  }
  return run(s);
}
R cuMemsetD8Async(P p, unsigned char byte, size_t n, void *s) { ENTER if (getenv("FAKE_CUDA_NO_FILL")) return 0; Step w = {0, p, 0, n, byte}; return work(&w, s); }
R cuMemcpyHtoDAsync_v2(P d, const void *h, size_t n, void *s) { ENTER Step w = {1, d, h, n}; return work(&w, s); }
R cuMemcpyDtoHAsync_v2(void *h, P d, size_t n, void *s) { ENTER Step w = {1, (P)h, (void *)d, n}; return work(&w, s); }

R cuModuleLoadDataEx(void **m, const void *image, unsigned n, int *options, void **values) {
  ENTER OURS
  if (n != 2 || options[0] != 5 || options[1] != 6 || (size_t)values[1] != 4096) return 1;
  *m = NULL;
  if (strncmp(image, "FAKE:", 5)) return 0;
  *m = dlopen((const char *)image + 5, RTLD_NOW | RTLD_LOCAL);
  return *m ? 0 : 200;
}
R cuModuleGetFunction(void **out, void *m, const char *name) {
  ENTER
  Function *f = calloc(1, sizeof *f);
  char symbol[128];
  strncpy(f->name, name, 63);
  if (m) {
    snprintf(symbol, sizeof symbol, "gn0_run_%s", name);
    f->entry = dlsym(m, symbol);
    snprintf(symbol, sizeof symbol, "gn0_sizes_%s", name);
    f->sizes = dlsym(m, symbol);
    if (!f->entry) return 500;
  }
  *out = f;
  return 0;
}
#ifndef OLDER
R cuFuncGetParamInfo(Function *f, size_t i, size_t *offset, size_t *size) {
  ENTER
  if (!f->sizes) return 801;
  for (size_t k = 0; k <= i; k++) if (!f->sizes[k]) return 1;
  *offset = 0, *size = f->sizes[i];
  return 0;
}
#endif
R cuFuncGetAttribute(int *v, int a, Function *f) { ENTER *v = a == 0 ? 1024 : a == 1 ? 1024 : a == 3 ? 0 : 40; return 0; }
R cuFuncSetAttribute(Function *f, int a, int v) { ENTER if (a != 8 || v + 1024 > 227 * 1024) return 1; f->shared = v; return 0; }
R cuOccupancyMaxActiveBlocksPerMultiprocessor(int *n, Function *f, int threads, size_t shared) { ENTER *n = 2048 / threads; return 0; }
R cuLaunchKernel(Function *f, unsigned gx, unsigned gy, unsigned gz, unsigned bx, unsigned by, unsigned bz, unsigned shared, void *stream, void **p, void **extra) {
  ENTER
  if (shared + 1024 > 48 * 1024 && (int)shared > f->shared) return 1;  // 1024 bytes are static: cuFuncGetAttribute
  if (!bx || !by || !bz || bx > 1024 || by > 1024 || bz > 64 || (uint64_t)bx * by * bz > 1024) return 1;
  if (!f->entry) return context == &primary ? 0 : 201;
  Step w = {2};
  w.f = f, w.size = shared;
  w.grid[0] = gx, w.grid[1] = gy, w.grid[2] = gz, w.block[0] = bx, w.block[1] = by, w.block[2] = bz;
  for (size_t i = 0, at = 0; f->sizes[i]; at += (f->sizes[i++] + 15) / 16 * 16) memcpy(w.cells + at, p[i], f->sizes[i]);
  return work(&w, stream);
}

R cuStreamCreate(void **s, unsigned flags) { ENTER OURS if (flags != 1) return 1; *s = &streams[stream_count++ % 8]; return 0; }
R cuStreamSynchronize(Graph *s) { ENTER OURS return s && s->recording ? 900 : 0; }
// Events are never freed: a card answers 709 to one that was destroyed.
typedef struct { double at; int destroyed; } Event;
R cuStreamWaitEvent(void *s, Event *e, unsigned f) { ENTER OURS return e->destroyed ? 709 : 0; }
R cuStreamBeginCapture_v2(Graph *s, int mode) { ENTER OURS if (mode != 2 || s->recording) return 1; s->recording = 1; s->count = 0; s->steps = NULL; return 0; }
R cuStreamEndCapture(Graph *s, void **g) {
  ENTER OURS
  if (!s->recording) return 1;
  Graph *whole = malloc(sizeof *whole);
  s->recording = 0;
  *whole = *s;
  *g = whole;
  live++;
  return 0;
}
R cuGraphInstantiateWithFlags(void **x, Graph *g, uint64_t flags) {
  ENTER
  Graph *copy = malloc(sizeof *copy);
  *copy = *g;
  *x = copy;
  live++;
  return 0;
}
R cuGraphDestroy(Graph *g) { ENTER free(g); live--; return 0; }
R cuGraphExecDestroy(Graph *g) { ENTER free(g->steps); free(g); live--; return 0; }
R cuGraphLaunch(Graph *g, void *s) {
  ENTER OURS
  for (int i = 0; i < g->count; i++) { R code = run(&g->steps[i]); if (code) return code; }
  return 0;
}
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return t.tv_sec * 1e3 + t.tv_nsec * 1e-6; }
R cuEventCreate(Event **e, unsigned f) { ENTER OURS *e = calloc(1, sizeof **e); live++; return 0; }
R cuEventDestroy_v2(Event *e) { ENTER if (e->destroyed) return 709; e->destroyed = 1; live--; return 0; }
R cuEventRecord(Event *e, void *s) { ENTER OURS e->at = now(); return e->destroyed ? 709 : 0; }
R cuEventQuery(Event *e) { ENTER return e->destroyed ? 709 : 0; }
R cuEventSynchronize(Event *e) { ENTER return e->destroyed ? 709 : 0; }
R cuEventElapsedTime(float *ms, Event *a, Event *b) { ENTER *ms = b->at - a->at; return a->destroyed || b->destroyed ? 709 : 0; }
