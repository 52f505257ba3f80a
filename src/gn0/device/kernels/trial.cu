// What launches, copies and recordings must get right, for a card that was not tried before: trial.py.

struct Odd {
  float by;
  int first;
  u64 mask;
  double far;
  u8 last;
};

KERNEL(try_parameters)
(const float *x, double *y, u8 small, Odd odd, u16 middle, i64 wide, bool yes, u32 n) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x;
  double sum = odd.far + (double)(odd.mask >> 40) + odd.last + small + middle + (double)wide;
  if (i < n) y[i] = yes ? (double)fmaf(odd.by, x[i], (float)odd.first) + sum : -1;
}

// Static and dynamic shared memory of one block: the values in reverse order, plus the last one.
KERNEL(try_shared)(u32 *values, u32 n) {
  __shared__ u32 last;
  DYNAMIC_SHARED(bytes);
  u32 *held = (u32 *)bytes;
  for (u32 i = threadIdx.x; i < n; i += blockDim.x) held[i] = values[i];
  if (threadIdx.x == 0) last = values[n - 1];
  __syncthreads();
  for (u32 i = threadIdx.x; i < n; i += blockDim.x) values[i] = held[n - 1 - i] + last;
}

KERNEL(try_grid)(u32 *counts) {
  if (threadIdx.x + threadIdx.y + threadIdx.z == 0)
    atomicAdd(counts + (blockIdx.z * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x, blockDim.z);
}

// Steps of a generator of numbers: work that takes as long as is wanted, with a result to check.
KERNEL(try_steps)(u32 *values, u32 turns) {
  u32 i = blockIdx.x * blockDim.x + threadIdx.x, v = values[i];
  for (u32 turn = 0; turn < turns; turn++) v = v * 1664525u + 1013904223u;
  values[i] = v;
}
