// What kernels see of views, clouds and the work to share; the host's tables are in `tables.py`.

#define CHUNK 256
#define TILE 16
#define ORTHO 1u        // flags of a draw
#define ANTIALIASED 2u
#define TAIL 0x80000000u  // top bit of a key's low word: a moving splat, after all others
#define QUARTER_BITS 4       // lowest bits of a key: quarters of the tile that the splat may reach
#define ALL_QUARTERS 15u     // left above, left below, right above, right below
#define NOWHERE 0xffffffffu

// With INSTANCES, whose keys have TAIL, too: the instance and its index share what is the
// index else, and tails are numbered behind the splats of their scene.
#define PART_BITS 22  // of an index in an instance's cloud
#define PART_SHIFT (PART_BITS + QUARTER_BITS)
#define PART_INDEX ((1u << PART_BITS) - 1)
#define TAIL_INDEX ((1u << 27) - (1u << PART_BITS))  // of a tail's first splat
#define TAIL_SLOT (1u << 27)                         // beside a slot: of a tail
#define IS_PART 1  // words of `spare`, beside what is wrong with it: an instance's key bits, else 0
#define WHOSE 2    // the view that an instance belongs to, or the first instance of a view
// `row` of an instance's view: bits of the metres by which it is sorted as if nearer

struct alignas(16) View {  // 32 words
  float r[9], eye[3], fx, fy, cx, cy, near, far;
  float lim_xp, lim_xn, lim_yp, lim_yn, gain_x, gain_y, width, height;
  u32 cloud, tail, row, spare[3];
};

struct Cloud {  // 64 bytes
  const float4 *splats;
  const u32 *order;   // packed number -> index in the cloud
  const u32 *places;  // index -> packed number; null when packed order is cloud order
  const u16 *sh;
  const float *boxes;
  const u32 *slots;
  u32 chunks, degree, sh_row, rows;
};

struct Group {  // views of one cloud, and the blocks that list it
  u32 cloud, tail, first_block, chunks, first_member, members, spare[2];
};

struct alignas(16) Part {  // 32 words: what painting needs to know of an instance, beside its view
  float gain[12];      // of colours: constant, then along x, y, z of the cloud's own frame
  const u32 *normals;  // of packed splats; null where there is no gain
  u32 spare[2];
  Cloud cloud;
};

struct Moving {  // instances of all views
  const View *views;
  const Part *parts;
};

struct Splat {
  float x, y, z, extent, m[9], log_opacity;
};

// A view from shared memory, four words a load.
__device__ __forceinline__ View load_view(const View &at) {
  const float4 *p = (const float4 *)&at;
  float4 a = p[0], b = p[1], c = p[2], d = p[3], e = p[4], f = p[5], g = p[6];
  return {{a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x}, {c.y, c.z, c.w}, d.x, d.y, d.z, d.w,
          e.x, e.y, e.z, e.w, f.x, f.y, f.z, f.w, g.x, g.y,
          __float_as_uint(g.z), __float_as_uint(g.w), 0, {0, 0, 0}};
}

// Addresses that come from a table are generic to the compiler; __ldg says that they are global.
__device__ __forceinline__ Splat load_splat(const float4 *at) {
  float4 p = __ldg(at), a = __ldg(at + 1), b = __ldg(at + 2), c = __ldg(at + 3);
  return {p.x, p.y, p.z, p.w, {a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x}, c.y};
}
