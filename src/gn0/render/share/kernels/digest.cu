// BLAKE2b with a digest of 16 bytes (RFC 7693), of pictures as `gn0.storage.content_hash` sees
// them: what is said of the array, then its bytes. The blocks of a picture follow each other, so
// its time is that of one chain: four lanes take it, one for each of the four mixing steps that
// BLAKE2b makes at once. Each lane also reads a quarter of a block, a block ahead of the mixing.

#define BLOCK 128          // bytes
#define LANES 4            // of a picture
#define PART 32            // bytes of a block that a lane reads
#define HEAD 64            // bytes at most that are said of an array
#define PICTURES 8         // at most that a warp takes
#define STRIDE 18          // words from the message of one picture to the next: other banks
#define ENDLESS 0x7fffffffu  // bytes of zeros after a picture

// Pictures of one kind, one behind the other or as mosaics of tiles.
struct Kind {
  u64 pixels;  // address of whole pictures of `size` bytes, or 0
  u64 table;   // or address of addresses [count, rows, columns] of tiles; a tile at 0 is black
  u32 size;    // bytes of a picture
  u32 line;    // bytes of a tile's row; `size` for whole pictures
  u32 height;  // rows of a tile
  u32 columns, rows;  // of a mosaic; 1 for whole pictures
  u32 first, count;   // number of its first picture among all kinds; how many
  u32 begin;          // first block of threads that works for it
  u32 said;           // bytes of `head` that count
  u8 head[HEAD];
};

// Bytes that lie one behind the other: what is said, a row of a tile or a whole picture, zeros.
struct Piece {
  const u8 *tile;  // 0: all bytes are 0
  u32 above;       // bytes of the tile's rows above
  u32 length;
  u32 offset;  // in it, of what a lane reads
  u32 column, y, row;
};

// What a picture is read from, in registers.
struct Reader {
  const u8 *pixels;  // of a whole picture
  const u64 *table;  // or its tiles
  u32 line, height, columns, rows;
};

// Go on to the next piece if the offset is beyond this one. A tile's address is not waited for.
__device__ __forceinline__ void go_on(const Reader &r, Piece &p) {
  while (p.offset >= p.length) {
    p.offset -= p.length;
    if (++p.column == r.columns) {
      p.column = 0;
      if (++p.y == r.height) p.y = 0, p.row++;
    }
    p.tile = 0, p.above = p.y * r.line, p.length = r.line;
    if (p.row >= r.rows) {
      p.length = ENDLESS, p.row = r.rows, p.y = 0;
    } else {
      p.tile = r.table ? (const u8 *)r.table[p.row * r.columns + p.column] : r.pixels;
    }
  }
}

// Words around a lane's bytes, as they are aligned in memory.
struct Window {
  u32 words[PART / 4 + 1];
  u32 off;  // bytes of the first word that come before
};

// A word, or 0 without a read. As an instruction under a condition, for the compiler makes branches.
__device__ __forceinline__ u32 read_if(bool wanted, const u32 *at) {
#ifdef GN0_HOST
  return wanted ? *at : 0;
#else
  u32 word;
  asm volatile(
      "{ .reg .pred p; setp.ne.u32 p, %2, 0; mov.u32 %0, 0; @p ld.global.nc.u32 %0, [%1]; }"
      : "=r"(word)
      : "l"(at), "r"((u32)wanted));
  return word;
#endif
}

// Read bytes `from` to `to` of the window that begins at `p`'s offset less `back`. Whole words
// that hold one of them are read: they are on the same line of memory.
__device__ __forceinline__ void read_window(const Piece &p, u32 back, u32 from, u32 to, Window &w) {
  u64 at = p.tile ? (u64)p.tile + p.above + p.offset - back : 0;
  if (!p.tile) from = to = 0;
  w.off = (u32)at & 3;
  const u32 *words = (const u32 *)(at - w.off);
  from += w.off, to += w.off;
#pragma unroll
  for (u32 i = 0; i <= PART / 4; i++)
    w.words[i] = read_if(4 * i + 4 > from && 4 * i < to, words + i);
}

// The words from byte `off` on.
__device__ __forceinline__ u32 align_word(const Window &w, int i) {
  return (u32)(((u64)w.words[i + 1] << 32 | w.words[i]) >> 8 * w.off);
}

// What a lane has read of a block to come: one piece, and the next where the first ends.
struct Ahead {
  Window one, two;
  u32 left;  // bytes of the first
};

// Any number of pieces, byte by byte: rows of few pixels.
__device__ __forceinline__ void walk(const Reader &r, Piece p, u32 (&words)[PART / 4 + 1]) {
#pragma unroll 1
  for (int n = 0; n < PART; n++) {
    go_on(r, p);
    u32 byte = p.tile ? (p.tile + p.above)[p.offset] : 0;
    p.offset++;
#pragma unroll
    for (int i = 0; i < PART / 4; i++)
      words[i] = words[i] >> 8 | (i + 1 < PART / 4 ? words[i + 1] : byte) << 24;
  }
}

__device__ __forceinline__ void read_ahead(const Reader &r, const Piece &p, Ahead &ahead) {
  ahead.left = min(p.length - p.offset, (u32)PART);
  if (ahead.left == PART) {
    read_window(p, 0, 0, PART, ahead.one);
    return;
  }
  Piece next = p;
  next.offset = next.length;
  go_on(r, next);
  if (ahead.left + next.length >= PART) {
    read_window(p, 0, 0, ahead.left, ahead.one);
    read_window(next, ahead.left, ahead.left, PART, ahead.two);
  } else {
    walk(r, p, ahead.one.words);
    ahead.one.off = 0, ahead.left = PART;
  }
}

// Put what was read where all lanes of the picture find it.
__device__ __forceinline__ void put(const Ahead &ahead, u64 *message) {
  u32 words[PART / 4];
#pragma unroll
  for (int i = 0; i < PART / 4; i++) words[i] = align_word(ahead.one, i);
  if (ahead.left < PART) {
#pragma unroll
    for (int i = 0; i < PART / 4; i++) {
      int bits = min(max(8 * (int)ahead.left - 32 * i, 0), 32);
      u32 first = bits < 32 ? (1u << bits) - 1 : ~0u;
      words[i] = (words[i] & first) | (align_word(ahead.two, i) & ~first);
    }
  }
#pragma unroll
  for (int i = 0; i < PART / 8; i++) message[i] = (u64)words[2 * i + 1] << 32 | words[2 * i];
}

// Which words of the message a round takes, four bits each, from the lowest on.
__constant__ u64 ORDER[10] = {
    0xfedcba9876543210ull, 0x357b20c16df984aeull, 0x491763eadf250c8bull, 0x8f04a562ebcd1397ull,
    0xd386cb1efa427509ull, 0x91ef57d438b0a6c2ull, 0xb8293670a4def15cull, 0xa2684f05931ce7bdull,
    0x5a417d2c803b9ef6ull, 0x0dc3e9bf5167482aull};
#define ROUNDS 12

#define IV0 0x6a09e667f3bcc908ull
#define IV1 0xbb67ae8584caa73bull
#define IV2 0x3c6ef372fe94f82bull
#define IV3 0xa54ff53a5f1d36f1ull
#define IV4 0x510e527fade682d1ull
#define IV5 0x9b05688c2b3e6c1full
#define IV6 0x1f83d9abfb41bd6bull
#define IV7 0x5be0cd19137e2179ull

__device__ __forceinline__ u64 choose(u32 lane, u64 a, u64 b, u64 c, u64 d) {
  return lane < 2 ? (lane ? b : a) : (lane == 2 ? c : d);
}

__device__ __forceinline__ u64 turn(u64 x, int n) { return x >> n | x << (64 - n); }

__device__ __forceinline__ void mix(u64 &a, u64 &b, u64 &c, u64 &d, u64 x, u64 y) {
  a = a + b + x;
  d = turn(d ^ a, 32);
  c = c + d, b = turn(b ^ c, 24);
  a = a + b + y;
  d = turn(d ^ a, 16);
  c = c + d, b = turn(b ^ c, 63);
}

// From the lane of the same picture that is so many further on.
__device__ __forceinline__ u64 from_lane(u64 x, u32 lane, u32 further) {
  return __shfl_sync(FULL, x, (lane + further) & (LANES - 1), LANES);
}

// The four words of the message that a lane takes in a round; `at`: where, 16 bits each.
struct Words {
  u64 x, y, z, t;
};

__device__ __forceinline__ Words take(const u64 *message, u64 at) {
  const u8 *from = (const u8 *)message;
  u32 low = (u32)at, high = (u32)(at >> 32);
  return {*(const u64 *)(from + (low & 0xffff)), *(const u64 *)(from + (low >> 16)),
          *(const u64 *)(from + (high & 0xffff)), *(const u64 *)(from + (high >> 16))};
}

// A lane's two words of the state, after a block. The diagonals go round `b`, which is ready last.
// What a round takes is read a round before. A loop, for a warp alone would wait for the code of
// twelve rounds in line.
__device__ __forceinline__ void compress(
    u64 &low, u64 &high, u64 iv, u64 third, u32 lane, const u64 *message, const u64 *order) {
  u64 a = low, b = high, c = iv, d = third;
  Words now = take(message, order[0]);
  u64 at = order[LANES];
#pragma unroll 2
  for (int r = 0; r < ROUNDS; r++) {
    Words then = take(message, at);
    at = order[LANES * (r + 2)];
    mix(a, b, c, d, now.x, now.y);
    a = from_lane(a, lane, 3), d = from_lane(d, lane, 2), c = from_lane(c, lane, 1);
    mix(a, b, c, d, now.z, now.t);
    a = from_lane(a, lane, 1), d = from_lane(d, lane, 2), c = from_lane(c, lane, 3);
    now = then;
  }
  low ^= a ^ c, high ^= b ^ d;
}

// Digests [count, 2] as words. A block is four lanes for each of at most PICTURES of one kind.
KERNEL(digest_pictures)(const Kind *__restrict__ kinds, int kind_count, u64 *digests) {
  __shared__ u64 held[PICTURES * STRIDE];
  int kind = 0;
  while (kind + 1 < kind_count && kinds[kind + 1].begin <= blockIdx.x) kind++;
  const Kind &k = kinds[kind];
  u32 lane = threadIdx.x % LANES, place = threadIdx.x / LANES;
  u32 number = (blockIdx.x - k.begin) * (blockDim.x / LANES) + place;
  u32 v = min(number, k.count - 1);  // lanes to spare do the last one again, and keep in step
  u64 *message = held + place * STRIDE + lane * (PART / 8);
  __shared__ u64 order[(ROUNDS + 2) * LANES];  // two rounds more are read, for nothing
  for (u32 i = threadIdx.x; i < (ROUNDS + 2) * LANES; i += blockDim.x) {
    u32 one = i % LANES, diagonal = 8 + 2 * ((one + LANES - 1) % LANES);
    u64 words = ORDER[i / LANES % 10];
    u32 low = words >> 8 * one & 255, high = words >> 4 * diagonal & 255;  // two words each
    order[i] = (u64)((high & 15) | (high >> 4) << 16) << 35 | ((low & 15) | (low >> 4) << 16) << 3;
  }
  Reader r = {(const u8 *)k.pixels + (u64)v * k.size, 0, k.line, k.height, k.columns, k.rows};
  if (k.table) r.table = (const u64 *)k.table + (u64)v * k.rows * k.columns;
  // before the first row comes what is said
  Piece p = {k.head, 0, k.said, lane * PART, k.columns - 1, k.height - 1, 0xffffffffu};
  u64 iv = choose(lane, IV0, IV1, IV2, IV3), above = choose(lane, IV4, IV5, IV6, IV7);
  u64 low = lane ? iv : IV0 ^ 0x01010010ull, high = above;
  u32 end = k.said + k.size;
  Ahead ahead;
  go_on(r, p);
  read_ahead(r, p, ahead);
  for (u32 begin = 0; begin < end; begin += BLOCK) {
    put(ahead, message);
    __syncwarp();
    p.offset += BLOCK;
    go_on(r, p);
    read_ahead(r, p, ahead);
    u64 third = above;
    if (lane == 0) third ^= (u64)min(begin + BLOCK, end);
    if (lane == 2 && begin + BLOCK >= end) third = ~third;
    compress(low, high, iv, third, lane, held + place * STRIDE, order + lane);
    __syncwarp();
  }
  if (lane < 2 && number < k.count) digests[2 * (u64)(k.first + number) + lane] = low;
}
