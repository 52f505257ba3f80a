// Baseline JPEG, 4:2:0, with the bytes of libjpeg's "islow" transform and standard Huffman tables.
//
// All arithmetic is in integers and every bit has its place, so the file does not depend on the
// order of threads. A unit (MCU) is 16x16 pixels: blocks Y00 Y01 Y10 Y11 Cb Cr of 8x8.

#define UNIT_BLOCKS 6
#define WARPS 4  // units a thread block

__constant__ u8 ZIGZAG[64] = {
    0,  1,  8,  16, 9,  2,  3,  10, 17, 24, 32, 25, 18, 11, 4,  5,  12, 19, 26, 33, 40, 48,
    41, 34, 27, 20, 13, 6,  7,  14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23,
    30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63};

// Where the pixels of pictures are: whole pictures, or mosaics of tiles by a table.
struct Source {
  const u8 *pixels;   // [V, height, width, 3]
  const u64 *table;   // or addresses [V, cells] of tiles [tile_height, tile_width, 3]; 0 is black
  int width, height;  // of a picture
  int tile_width, tile_height, columns, cells;
};

__device__ __forceinline__ int3 pixel_at(const Source &s, int v, int x, int y) {
  const u8 *p;
  if (s.table) {
    int row = y / s.tile_height, column = x / s.tile_width;
    p = (const u8 *)s.table[(i64)v * s.cells + row * s.columns + column];
    if (!p) return {0, 0, 0};
    p += ((y - row * s.tile_height) * s.tile_width + (x - column * s.tile_width)) * 3;
  } else {
    p = s.pixels + (((i64)v * s.height + y) * s.width + x) * 3;
  }
  return {p[0], p[1], p[2]};
}

// libjpeg's fixed-point colours, 16 bits of fraction.
__device__ __forceinline__ int luma_of(int3 c) {
  return (19595 * c.x + 38470 * c.y + 7471 * c.z + 32768) >> 16;
}
__device__ __forceinline__ int blue_of(int3 c) {
  return (-11059 * c.x - 21709 * c.y + 32768 * c.z + (128 << 16) + 32767) >> 16;
}
__device__ __forceinline__ int red_of(int3 c) {
  return (32768 * c.x - 27439 * c.y - 5329 * c.z + (128 << 16) + 32767) >> 16;
}

__device__ __forceinline__ int descale(int x, int n) { return (x + (1 << (n - 1))) >> n; }

// One pass of the transform over eight numbers `step` apart; `first` over rows, else columns.
__device__ __forceinline__ void transform(int *d, int step, bool first) {
  int d0 = d[0], d1 = d[step], d2 = d[2 * step], d3 = d[3 * step];
  int d4 = d[4 * step], d5 = d[5 * step], d6 = d[6 * step], d7 = d[7 * step];
  int n = first ? 11 : 15;
  int t0 = d0 + d7, t7 = d0 - d7, t1 = d1 + d6, t6 = d1 - d6;
  int t2 = d2 + d5, t5 = d2 - d5, t3 = d3 + d4, t4 = d3 - d4;
  int t10 = t0 + t3, t13 = t0 - t3, t11 = t1 + t2, t12 = t1 - t2;
  d[0] = first ? (t10 + t11) * 4 : descale(t10 + t11, 2);
  d[4 * step] = first ? (t10 - t11) * 4 : descale(t10 - t11, 2);
  int z1 = (t12 + t13) * 4433;
  d[2 * step] = descale(z1 + t13 * 6270, n);
  d[6 * step] = descale(z1 - t12 * 15137, n);
  z1 = (t4 + t7) * -7373;
  int z2 = (t5 + t6) * -20995, z3 = t4 + t6, z4 = t5 + t7;
  int z5 = (z3 + z4) * 9633;
  z3 = z3 * -16069 + z5;
  z4 = z4 * -3196 + z5;
  d[7 * step] = descale(t4 * 2446 + z1 + z3, n);
  d[5 * step] = descale(t5 * 16819 + z2 + z4, n);
  d[3 * step] = descale(t6 * 25172 + z2 + z3, n);
  d[step] = descale(t7 * 12299 + z1 + z4, n);
}

// Coefficients int16 [V, units, 6, 64] in zigzag order, quantised; a warp a unit.
// `steps` [2, 64]: quantisation of luma and chroma in zigzag order.
KERNEL_BOUNDED(jpeg_transform, 128, 8)
(const u8 *pixels, const u64 *table, int width, int height, int tile_width, int tile_height,
 int columns, int cells, const int *steps, int views, u16 *coefficients) {
  __shared__ int held[WARPS][UNIT_BLOCKS * 64];
  Source source = {pixels, table, width, height, tile_width, tile_height, columns, cells};
  int across = (width + 15) / 16, down = (height + 15) / 16;
  i64 unit = (i64)blockIdx.x * WARPS + threadIdx.x / WARP;
  if (unit >= (i64)views * across * down) return;
  int lane = threadIdx.x & 31, *block = held[threadIdx.x / WARP];
  int v = (int)(unit / (across * down)), m = (int)(unit - (i64)v * across * down);
  int my = m / across, mx = m - my * across;
  for (int i = lane; i < 256; i += 32) {
    int px = i & 15, py = i >> 4;
    int3 c = pixel_at(source, v, min(mx * 16 + px, width - 1), min(my * 16 + py, height - 1));
    block[((py >> 3) * 2 + (px >> 3)) * 64 + (py & 7) * 8 + (px & 7)] = luma_of(c) - 128;
  }
  for (int i = lane; i < 64; i += 32) {
    int cx = i & 7, cy = i >> 3;
    // rows below the picture repeat the last row of chroma, not that of pixels
    int row = min(my * 8 + cy, (height + 1) / 2 - 1) * 2, blue = 0, red = 0;
    for (int k = 0; k < 4; k++) {
      int x = min(mx * 16 + cx * 2 + (k & 1), width - 1), y = min(row + (k >> 1), height - 1);
      int3 c = pixel_at(source, v, x, y);
      blue += blue_of(c);
      red += red_of(c);
    }
    int bias = 1 + (cx & 1);
    block[4 * 64 + i] = ((blue + bias) >> 2) - 128;
    block[5 * 64 + i] = ((red + bias) >> 2) - 128;
  }
  __syncwarp();
  for (int j = lane; j < UNIT_BLOCKS * 8; j += 32) transform(block + (j >> 3) * 64 + (j & 7) * 8, 1, true);
  __syncwarp();
  for (int j = lane; j < UNIT_BLOCKS * 8; j += 32) transform(block + (j >> 3) * 64 + (j & 7), 8, false);
  __syncwarp();
  u16 *out = coefficients + unit * (UNIT_BLOCKS * 64);
  int wide = (width + 7) / 8, high = (height + 7) / 8;
  for (int i = lane; i < UNIT_BLOCKS * 64; i += 32) {
    int b = i >> 6, k = i & 63;
    // blocks that lie outside altogether hold nothing but the mean of the block before them
    int from = b;
    while (from < 4 && (mx * 2 + (from & 1) >= wide || my * 2 + (from >> 1) >= high)) from--;
    int value = 0;
    if (from == b || k == 0) {
      int c = block[from * 64 + ZIGZAG[k]], q = steps[(b < 4 ? 0 : 64) + k] * 8;
      int size = (abs(c) + (q >> 1)) / q;
      value = c < 0 ? -size : size;
    }
    out[i] = (u16)value;
  }
}

// Bits of one block, given through `put(code, length)`. `codes`: [2, 272], of luma and chroma, 256
// of AC symbols and 16 of DC sizes, each length << 16 | code.
template <class Put>
__device__ __forceinline__ void code_block(const u16 *coefficients, int n, const u32 *codes, Put &put) {
  int m = n / UNIT_BLOCKS, b = n - m * UNIT_BLOCKS;
  const u16 *own = coefficients + (i64)n * 64;
  int before = 0;
  if (b > 0 && b < 4) before = (short)own[-64];
  else if (m > 0) before = (short)(b == 0 ? own[-3 * 64] : own[-UNIT_BLOCKS * 64]);
  const u32 *table = codes + (b < 4 ? 0 : 272);
  const uint4 *quads = (const uint4 *)own;
  int run = 0;
  for (int i = 0; i < 8; i++) {
    uint4 quad = quads[i];
    u32 words[4] = {quad.x, quad.y, quad.z, quad.w};
#pragma unroll
    for (int j = 0; j < 8; j++) {
      int value = (short)(words[j >> 1] >> (16 * (j & 1)));
      bool first = i == 0 && j == 0;
      if (first) value -= before;
      if (!first && value == 0) {
        run++;
        continue;
      }
      if (run > 15) {
        u32 skip = table[0xF0];
        for (; run > 15; run -= 16) put(skip & 0xffff, (int)(skip >> 16));
      }
      int length = 32 - __clz(abs(value));
      u32 code = first ? table[256 + length] : table[run << 4 | length];
      u32 bits = (u32)(value < 0 ? value - 1 : value) & ((1u << length) - 1);
      put((code & 0xffff) << length | bits, (int)(code >> 16) + length);
      run = 0;
    }
  }
  if (run) put(table[0] & 0xffff, (int)(table[0] >> 16));
}

struct Counter {
  u32 bits;
  __device__ __forceinline__ void operator()(u32, int length) { bits += length; }
};

struct Writer {
  u32 *words;
  u64 held;
  int filled;
  __device__ __forceinline__ void operator()(u32 code, int length) {
    held |= (u64)code << (64 - filled - length);
    filled += length;
    if (filled >= 32) {
      atomicOr(words++, (u32)(held >> 32));
      held <<= 32;
      filled -= 32;
    }
  }
};

// Bits of each block u32 [V, blocks]; a thread a block.
KERNEL(jpeg_count)(const u16 *coefficients, const u32 *codes, int blocks, u32 *bits) {
  int n = blockIdx.x * blockDim.x + threadIdx.x, v = blockIdx.y;
  if (n >= blocks) return;
  Counter counter = {0};
  code_block(coefficients + (i64)v * blocks * 64, n, codes, counter);
  bits[(i64)v * blocks + n] = counter.bits;
}

// The sum of `own` over threads before this one, and of all; 256 threads, `held` of 8 numbers.
__device__ __forceinline__ u32 scan_block(u32 own, u32 *held, u32 *all) {
  u32 sum = own;
  int lane = threadIdx.x & 31, warp = threadIdx.x / WARP;
  for (int d = 1; d < 32; d <<= 1) {
    u32 other = __shfl_up_sync(FULL, sum, d);
    if (lane >= d) sum += other;
  }
  if (lane == 31) held[warp] = sum;
  __syncthreads();
  u32 before = 0, total = 0;
  for (int w = 0; w < 8; w++) {
    if (w < warp) before += held[w];
    total += held[w];
  }
  __syncthreads();
  *all = total;
  return before + sum - own;
}

// Turns the bits of each block into where they begin, and says how many there are; a block a view.
KERNEL_BOUNDED(jpeg_scan, 256, 1)(int blocks, u32 *bits, u32 *totals) {
  __shared__ u32 held[8];
  u32 *own = bits + (i64)blockIdx.x * blocks;
  int share = (blocks + 255) / 256, begin = min((int)threadIdx.x * share, blocks);
  int end = min(begin + share, blocks);
  u32 sum = 0, total;
  for (int i = begin; i < end; i++) sum += own[i];
  u32 at = scan_block(sum, held, &total);
  for (int i = begin; i < end; i++) {
    u32 size = own[i];
    own[i] = at;
    at += size;
  }
  if (threadIdx.x == 0) totals[blockIdx.x] = total;
}

// Writes the bits of each block into words of zeros u32 [V, room], the first bit topmost.
KERNEL(jpeg_write)(const u16 *coefficients, const u32 *codes, int blocks, const u32 *starts,
                   int room, u32 *words) {
  int n = blockIdx.x * blockDim.x + threadIdx.x, v = blockIdx.y;
  if (n >= blocks) return;
  u32 start = starts[(i64)v * blocks + n];
  Writer writer = {words + (i64)v * room + (start >> 5), 0, (int)(start & 31)};
  code_block(coefficients + (i64)v * blocks * 64, n, codes, writer);
  if (n == blocks - 1 && (writer.filled & 7)) {  // the last byte is filled up with ones
    int spare = 8 - (writer.filled & 7);
    writer((1u << spare) - 1, spare);
  }
  if (writer.filled) atomicOr(writer.words, (u32)(writer.held >> 32));
}

__device__ __forceinline__ u32 byte_at(const u32 *words, int i) {
  return words[i >> 2] >> (24 - 8 * (i & 3)) & 255;
}

// Puts a zero behind each byte 255; without `out` only says how many bytes that makes. A block a
// view; the bytes of view v go to out + starts[v].
KERNEL_BOUNDED(jpeg_stuff, 256, 1)(const u32 *words, const u32 *totals, int room,
                                   const u64 *starts, u32 *sizes, u8 *out) {
  __shared__ u32 held[8];
  const u32 *own = words + (i64)blockIdx.x * room;
  int bytes = (int)((totals[blockIdx.x] + 7) / 8), share = (bytes + 255) / 256;
  int begin = min((int)threadIdx.x * share, bytes), end = min(begin + share, bytes);
  u32 full = 0, all;
  for (int i = begin; i < end; i++) full += byte_at(own, i) == 255;
  u32 before = scan_block(full, held, &all);
  if (!out) {
    if (threadIdx.x == 0) sizes[blockIdx.x] = bytes + all;
    return;
  }
  u8 *at = out + starts[blockIdx.x] + begin + before;
  for (int i = begin; i < end; i++) {
    u32 byte = byte_at(own, i);
    *at++ = (u8)byte;
    if (byte == 255) *at++ = 0;
  }
}

// Pillow's BOX reduction by whole factors: tiles [V, tile_height, tile_width, 3] of pictures
// [V, height, width, 3]. It averages along rows, rounds, then along columns, with 22 bits of
// fraction. A thread a number.
KERNEL(reduce_tiles)(const u8 *pictures, int views, int width, int height, int by_x, int by_y,
                     u8 *tiles) {
  int tile_width = width / by_x, tile_height = height / by_y;
  i64 i = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= (i64)views * tile_height * tile_width * 3) return;
  int c = (int)(i % 3), x = (int)(i / 3 % tile_width);
  i64 line = i / 3 / tile_width;
  int y = (int)(line % tile_height);
  i64 v = line / tile_height;
  int weight_x = (int)(0.5 + 4194304.0 / by_x), weight_y = (int)(0.5 + 4194304.0 / by_y);
  int sum = 1 << 21;
  for (int dy = 0; dy < by_y; dy++) {
    const u8 *row = pictures + ((v * height + y * by_y + dy) * width + x * by_x) * 3 + c;
    int part = 1 << 21;
    for (int dx = 0; dx < by_x; dx++) part += row[dx * 3] * weight_x;
    sum += min(part >> 22, 255) * weight_y;
  }
  tiles[i] = (u8)min(sum >> 22, 255);
}
