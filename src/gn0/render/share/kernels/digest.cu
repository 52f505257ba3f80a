// BLAKE2b with a digest of 16 bytes (RFC 7693), of pictures as `gn0.storage.content_hash` sees
// them: what is said of the array, then its bytes. A thread takes a picture from end to end: the
// blocks of one follow each other, and the four steps of a half round fill a thread's pipeline.

#define BLOCK 128  // bytes
#define HEAD 64    // bytes at most that are said of an array

// Pictures of one kind, one behind the other or as mosaics of tiles.
struct Kind {
  u64 pixels;  // address of whole pictures of `size` bytes, or 0
  u64 table;   // or address of addresses [count, cells] of tiles; a tile at 0 is black
  u32 size;    // bytes of a picture
  u32 line;    // bytes of a tile's row; `size` for whole pictures
  u32 height;  // rows of a tile
  u32 columns, cells;
  u32 first;  // number of its first picture among all kinds
  u32 said;   // bytes of `head` that count
  u8 head[HEAD];
};

struct Spot {
  const u8 *at;  // 0: all bytes are 0
  u32 left;      // bytes that follow there
};

// Where byte `offset` of the pixels of picture `v` is.
__device__ __forceinline__ Spot find_spot(const Kind &k, u32 v, u32 offset) {
  if (!k.table) return {(const u8 *)k.pixels + (u64)v * k.size + offset, k.size - offset};
  u32 piece = offset / k.line, within = offset - piece * k.line;
  u32 y = piece / k.columns, column = piece - y * k.columns, row = y / k.height;
  u64 tile = ((const u64 *)k.table)[(u64)v * k.cells + row * k.columns + column];
  const u8 *at = tile ? (const u8 *)tile + (y - row * k.height) * k.line + within : 0;
  return {at, k.line - within};
}

// Eight bytes from bit `shift` of a word on.
__device__ __forceinline__ u64 load_word(const u32 *at, u32 shift) {
  u32 a = at[0], b = at[1];
  if (!shift) return (u64)b << 32 | a;
  u32 c = at[2], up = 32 - shift;
  return (u64)(b >> shift | c << up) << 32 | (a >> shift | b << up);
}

// The message from byte `begin` on: what is said, the pixels, zeros.
__device__ __forceinline__ void load_block(const Kind &k, u32 v, u32 begin, u64 (&m)[16]) {
  Spot spot = {0, 0};
  if (begin >= k.said) spot = find_spot(k, v, begin - k.said);
  if (spot.left >= BLOCK + 4) {  // so that no word beyond the picture is touched
    if (!spot.at) {
#pragma unroll
      for (int w = 0; w < 16; w++) m[w] = 0;
      return;
    }
#ifndef GN0_HOST
    if (spot.left >= 4 * BLOCK) asm volatile("prefetch.global.L1 [%0];" ::"l"(spot.at + 3 * BLOCK));
#endif
    u32 off = (u32)((u64)spot.at & 3);
    const u32 *at = (const u32 *)(spot.at - off);
#pragma unroll
    for (int w = 0; w < 16; w++) m[w] = load_word(at + 2 * w, 8 * off);
    return;
  }
  u64 words[16];  // of their own, so that `m` can stay in registers
  u32 offset = 0;  // of the spot, in the message
  spot.left = 0;
  for (u32 w = 0; w < 16; w++) {
    u64 word = 0;
    for (u32 i = 0; i < 8; i++) {
      u32 q = begin + 8 * w + i;
      u8 byte = 0;
      if (q < k.said) {
        byte = k.head[q];
      } else if (q - k.said < k.size) {
        if (!spot.left || q - offset >= spot.left) spot = find_spot(k, v, q - k.said), offset = q;
        byte = spot.at ? spot.at[q - offset] : (u8)0;
      }
      word |= (u64)byte << 8 * i;
    }
    words[w] = word;
  }
#pragma unroll
  for (int w = 0; w < 16; w++) m[w] = words[w];
}

__device__ __forceinline__ u64 turn(u64 x, int n) { return x >> n | x << (64 - n); }

#define MIX(a, b, c, d, x, y)    \
  a = a + b + (x);               \
  d = turn(d ^ a, 32);           \
  c = c + d, b = turn(b ^ c, 24); \
  a = a + b + (y);               \
  d = turn(d ^ a, 16);           \
  c = c + d, b = turn(b ^ c, 63)

#define ROUND(s0, s1, s2, s3, s4, s5, s6, s7, s8, s9, sa, sb, sc, sd, se, sf) \
  MIX(v0, v4, v8, vc, m[s0], m[s1]);                                          \
  MIX(v1, v5, v9, vd, m[s2], m[s3]);                                          \
  MIX(v2, v6, va, ve, m[s4], m[s5]);                                          \
  MIX(v3, v7, vb, vf, m[s6], m[s7]);                                          \
  MIX(v0, v5, va, vf, m[s8], m[s9]);                                          \
  MIX(v1, v6, vb, vc, m[sa], m[sb]);                                          \
  MIX(v2, v7, v8, vd, m[sc], m[sd]);                                          \
  MIX(v3, v4, v9, ve, m[se], m[sf])

#define IV0 0x6a09e667f3bcc908ull
#define IV1 0xbb67ae8584caa73bull
#define IV2 0x3c6ef372fe94f82bull
#define IV3 0xa54ff53a5f1d36f1ull
#define IV4 0x510e527fade682d1ull
#define IV5 0x9b05688c2b3e6c1full
#define IV6 0x1f83d9abfb41bd6bull
#define IV7 0x5be0cd19137e2179ull

__device__ __forceinline__ void compress(u64 (&h)[8], const u64 (&m)[16], u64 done, bool last) {
  u64 v0 = h[0], v1 = h[1], v2 = h[2], v3 = h[3], v4 = h[4], v5 = h[5], v6 = h[6], v7 = h[7];
  u64 v8 = IV0, v9 = IV1, va = IV2, vb = IV3;
  u64 vc = IV4 ^ done, vd = IV5, ve = last ? ~IV6 : IV6, vf = IV7;
  ROUND(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  ROUND(14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3);
  ROUND(11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4);
  ROUND(7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8);
  ROUND(9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13);
  ROUND(2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9);
  ROUND(12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11);
  ROUND(13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10);
  ROUND(6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5);
  ROUND(10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0);
  ROUND(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  ROUND(14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3);
  h[0] ^= v0 ^ v8, h[1] ^= v1 ^ v9, h[2] ^= v2 ^ va, h[3] ^= v3 ^ vb;
  h[4] ^= v4 ^ vc, h[5] ^= v5 ^ vd, h[6] ^= v6 ^ ve, h[7] ^= v7 ^ vf;
}

// Digests [count, 2] as words. Few threads a block: each has a line of memory of its own.
KERNEL(digest_pictures)(const Kind *__restrict__ kinds, int kind_count, u32 count, u64 *digests) {
  u32 number = blockIdx.x * blockDim.x + threadIdx.x;
  if (number >= count) return;
  int kind = 0;
  while (kind + 1 < kind_count && kinds[kind + 1].first <= number) kind++;
  const Kind &k = kinds[kind];
  u32 v = number - k.first, end = k.said + k.size;
  u64 h[8] = {IV0 ^ 0x01010010ull, IV1, IV2, IV3, IV4, IV5, IV6, IV7}, m[16];
  for (u32 begin = 0; begin < end; begin += BLOCK) {
    load_block(k, v, begin, m);
    compress(h, m, (u64)min(begin + BLOCK, end), begin + BLOCK >= end);
  }
  digests[2 * (u64)number] = h[0];
  digests[2 * (u64)number + 1] = h[1];
}
