// What a card can do at most: the floors of the figures are counted against these.

KERNEL(copy_words)(const float4 *source, float4 *target, i64 words) {
  i64 stride = (i64)gridDim.x * blockDim.x;
  for (i64 i = (i64)blockIdx.x * blockDim.x + threadIdx.x; i < words; i += stride)
    target[i] = source[i];
}

// eight independent chains a thread hide the latency of each
KERNEL(multiply_add)(float4 *out, int rounds) {
  float x = (float)threadIdx.x * 1e-6f, y = 0.999f;
  float a = x, b = x + 1.0f, c = x + 2.0f, d = x + 3.0f;
  float e = x + 4.0f, f = x + 5.0f, g = x + 6.0f, h = x + 7.0f;
#pragma unroll 16
  for (int i = 0; i < rounds; ++i) {
    a = fmaf(a, y, x);
    b = fmaf(b, y, x);
    c = fmaf(c, y, x);
    d = fmaf(d, y, x);
    e = fmaf(e, y, x);
    f = fmaf(f, y, x);
    g = fmaf(g, y, x);
    h = fmaf(h, y, x);
  }
  if (a + b + c + d + e + f + g + h == 12345.0f)  // never; the compiler does not know
    out[threadIdx.x] = make_float4(a, b, c, d);
}
