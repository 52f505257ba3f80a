// Which threads of a tile a splat reaches.
//
// A splat marks the pixels that it reaches, row by row. Turned about by 32, these bits tell each thread
// which splats it has to blend: most reach few of a tile's pixels.

// A thread's first pixel in its tile: bit j of what `gather_quarter` returns is lane j's. Quarters are
// numbered down the left half, then the right.
__device__ __forceinline__ uint2 find_pixel() {
  u32 quarter = threadIdx.x / WARP, lane = lane_id(), x = lane % 4 * PIXELS;
  u32 y = lane / 8 + lane / 4 % 2 * 4;
  return make_uint2(quarter / 2 * SIDE + x, quarter % 2 * SIDE + y);
}

// The bits under bit `n`, all from 32 on.
__device__ __forceinline__ u32 bits_below(u32 n) {
#ifdef GN0_HOST
  return n < 32 ? (1u << n) - 1 : FULL;
#else
  u32 mask;
  asm("bmsk.clamp.b32 %0, 0, %1;" : "=r"(mask) : "r"(n));
  return mask;
#endif
}

// Integers that are not negative; 0 for NaN.
__device__ __forceinline__ u32 round_up(float x) {
#ifdef GN0_HOST
  return (u32)ceilf(fminf(fmaxf(x, 0.f), 64.f));
#else
  return __float2uint_ru(x);
#endif
}
__device__ __forceinline__ u32 round_down(float x) {
#ifdef GN0_HOST
  return (u32)floorf(fminf(fmaxf(x, 0.f), 64.f));
#else
  return __float2uint_rd(x);
#endif
}

// Bits of the lanes of one quarter, from the rows of the whole tile.
__device__ __forceinline__ u32 gather_quarter(const u32 *rows, u32 quarter) {
  u32 a = rows[quarter % 2 * 2], b = rows[quarter % 2 * 2 + 1];
  return quarter / 2 ? (a >> 4 & 0x0f0f0f0fu) | (b & 0xf0f0f0f0u)
                     : (a & 0x0f0f0f0fu) | (b & 0x0f0f0f0fu) << 4;
}

// Marks in this thread's rows the pixels that a staged splat reaches: where its exponent may be at
// least the least that shows; a bit for each that a thread of the row blends. y: of its centre, from
// the tile's first pixel centre.
__device__ __forceinline__ void find_reach(TileRoom &t, const Staged &one, float y) {
  float over = one.b.y - LOG2_ALPHA_MIN;
  if (!(over >= 0.f)) return;
  // rounded outwards: by a share of what is under each root, and by EDGE
  const float each = 1.f / PIXELS, wider = 1e-5f - 1.00001f * LOG2_ALPHA_MIN;
  float half = root(fmaf(over, 1.00001f, 1e-5f)) * fast_rcp(one.a.w);
  float row = ceilf(fminf(fmaxf(y - half - EDGE, 0.f), (float)TILE));
  float last = fminf(y + half + EDGE, (float)(TILE - 1));
  float inverse = fast_rcp(one.a.x) * each;
  u8 *to = t.rows[threadIdx.x] + (u32)row;
#pragma unroll 1
  for (; row <= last; row += 2.f, to += 2) {  // lanes differ in how many: no more at once
#pragma unroll
    for (int next = 0; next < 2; next++) {  // the second may lie behind the last: nothing shows there
      float down = row + (float)next, s = fmaf(one.a.w, down, one.b.x);
      float across = fmaf(one.a.y, down, one.a.z), most = fmaf(-s, s, one.b.y);
      float wide = root(fmaf(most, 1.00001f, wider));  // NaN, and no bit, where nothing shows
      u32 from = round_up(fmaf(-across - wide, inverse, -(EDGE + (float)(PIXELS - 1)) * each));
      u32 end = round_down(fmaf(wide - across, inverse, EDGE * each + 1.f));
      to[next] = (u8)(bits_below(end) & ~bits_below(from));
    }
  }
}

// Brings together, for lanes D apart, the bits that the other has and this one wants.
template <u32 D>
__device__ __forceinline__ u32 swap_bits(u32 bits, u32 low) {
  bool upper = lane_id() & D;
  u32 other = __shfl_xor_sync(FULL, bits, D), keep = upper ? ~low : low, by = upper ? WARP - D : D;
  return (bits & keep) | ((other << by | other >> (WARP - by)) & ~keep);
}

// The same for whole bytes.
template <u32 D>
__device__ __forceinline__ u32 swap_bytes(u32 bits, u32 lower, u32 upper) {
  return __byte_perm(bits, __shfl_xor_sync(FULL, bits, D), lane_id() & D ? upper : lower);
}

// Bit j of lane i becomes bit i of lane j.
__device__ __forceinline__ u32 turn_about(u32 bits) {
  bits = swap_bytes<16>(bits, 0x5410, 0x3276);
  bits = swap_bytes<8>(bits, 0x6240, 0x3715);
  bits = swap_bits<4>(bits, 0x0f0f0f0fu);
  bits = swap_bits<2>(bits, 0x33333333u);
  return swap_bits<1>(bits, 0x55555555u);
}

// Shares with the warp what reaches what, of 32 splats from `k` on: this lane's is in its rows.
__device__ __forceinline__ void tell_reach(TileRoom &t, u32 k) {
  const u32 *rows = (const u32 *)t.rows[threadIdx.x];
#pragma unroll
  for (u32 w = 0; w < WARPS; w++)
    t.reach[w][k] = __brev(turn_about(gather_quarter(rows, w)));
}

