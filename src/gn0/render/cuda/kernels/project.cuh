// One splat in one view: the rules of `gn0.render.cpu_project`.
//
// The 2D covariance is kept as a factor F = J W M, its determinant as a sum of squared minors, so
// that thin splats lose no digits. The exponent of a splat is (qx dx + qy dy)^2 + qk dy^2. Depth is
// computed operation for operation as on the CPU, so that what ties there ties here; the rest may
// differ in its last bits. Every pass that calls `project` gets the same bits.

#define LOG2_E 1.4426950408889634f
#define LN_2 0.6931471805599453f
#define SLACK 0.01f     // px: rounding of a footprint's box
#define EDGE 0.02f      // px: rounding of a footprint's rows
#define LARGEST 1e9f    // px: a larger footprint overflows further on
#define ROUND_UP 1.000004f

struct Footprint {
  float u, v, qx, qy, qk, log_o, z, rx, ry;
};

__device__ __forceinline__ float root(float x) { return x * fast_rsqrt(x); }  // x > 0

__device__ __forceinline__ bool project(const Splat &s, const View &w, u32 flags, Footprint &f) {
  float x = s.x - w.eye[0], y = s.y - w.eye[1], z = s.z - w.eye[2];
  float X = fmaf(w.r[0], x, fmaf(w.r[1], y, w.r[2] * z));
  float Y = fmaf(w.r[3], x, fmaf(w.r[4], y, w.r[5] * z));
  float Z = w.r[6] * x + w.r[7] * y + w.r[8] * z + 0.f;  // + 0: no negative zero among the keys
  bool inside = w.near <= Z && w.far >= Z && s.extent >= 0.f;
  bool pinhole = !(flags & ORTHO);
  float iz = pinhole ? fast_rcp(inside ? Z : 1.f) : 1.f;
  float tx = X * iz, ty = Y * iz;
  float u = fmaf(w.fx, tx, w.cx), v = fmaf(w.fy, ty, w.cy);
  // J clamps x/z and y/z to the picture widened by 0.3 of its half angle
  tx = pinhole ? fminf(w.lim_xp, fmaxf(-w.lim_xn, tx)) : 0.f;
  ty = pinhole ? fminf(w.lim_yp, fmaxf(-w.lim_yn, ty)) : 0.f;
  float jx = w.fx * iz, jy = w.fy * iz;
  float m0 = jx * fmaf(-tx, w.r[6], w.r[0]), n0 = jy * fmaf(-ty, w.r[6], w.r[3]);
  float m1 = jx * fmaf(-tx, w.r[7], w.r[1]), n1 = jy * fmaf(-ty, w.r[7], w.r[4]);
  float m2 = jx * fmaf(-tx, w.r[8], w.r[2]), n2 = jy * fmaf(-ty, w.r[8], w.r[5]);
  float f0 = fmaf(m0, s.m[0], fmaf(m1, s.m[3], m2 * s.m[6]));
  float f1 = fmaf(m0, s.m[1], fmaf(m1, s.m[4], m2 * s.m[7]));
  float f2 = fmaf(m0, s.m[2], fmaf(m1, s.m[5], m2 * s.m[8]));
  float g0 = fmaf(n0, s.m[0], fmaf(n1, s.m[3], n2 * s.m[6]));
  float g1 = fmaf(n0, s.m[1], fmaf(n1, s.m[4], n2 * s.m[7]));
  float g2 = fmaf(n0, s.m[2], fmaf(n1, s.m[5], n2 * s.m[8]));
  float a0 = fmaf(f0, f0, fmaf(f1, f1, f2 * f2));
  float d0 = fmaf(g0, g0, fmaf(g1, g1, g2 * g2));
  float b = fmaf(f0, g0, fmaf(f1, g1, f2 * g2));
  float e0 = f0 * g1 - f1 * g0, e1 = f0 * g2 - f2 * g0, e2 = f1 * g2 - f2 * g1;
  float thin = fmaf(e0, e0, fmaf(e1, e1, e2 * e2));
  float a = a0 + DILATION, d = d0 + DILATION;
  float det = fmaf(DILATION, a0 + d, thin);
  float half_inverse_d = 0.5f * fast_rcp(d), inverse_det = fast_rcp(det);
  float qx = root(0.5f * d * inverse_det);
  f.u = u, f.v = v, f.z = Z;
  f.qx = qx, f.qy = -2.f * half_inverse_d * b * qx, f.qk = half_inverse_d;
  f.log_o = s.log_opacity;
  f.rx = s.extent * root(a), f.ry = s.extent * root(d);
  // what float32 cannot hold is dropped: comparisons with NaN are false
  inside = inside && f.rx < LARGEST && f.ry < LARGEST && qx > 0.f;
  if (flags & ANTIALIASED) {
    float share = thin * inverse_det;
    inside = inside && share > 0.f;
    f.log_o += 0.5f * LN_2 * fast_log2(inside ? share : 1.f);
    float squared = 2.f * (f.log_o - LOG_ALPHA_MIN);
    inside = inside && squared > 0.f && s.extent > 0.f;  // a share may be rounded to above 1
    float shrink = root(inside ? squared : 1.f) * fast_rcp(s.extent);
    f.rx *= shrink, f.ry *= shrink;
  }
  return inside;
}

struct Box {  // of pixels whose centres lie within a footprint's box
  int x0, x1, y0, y1;
};

__device__ __forceinline__ bool bound(const Footprint &f, const View &w, Box &box) {
  float x0 = fmaxf(ceilf(f.u - f.rx - 0.5f - SLACK), 0.f);
  float x1 = fminf(floorf(f.u + f.rx - 0.5f + SLACK) + 1.f, w.width);
  float y0 = fmaxf(ceilf(f.v - f.ry - 0.5f - SLACK), 0.f);
  float y1 = fminf(floorf(f.v + f.ry - 0.5f + SLACK) + 1.f, w.height);
  if (!(x0 < x1 && y0 < y1)) return false;
  box = {(int)x0, (int)x1, (int)y0, (int)y1};
  return true;
}

// The ellipse (qx dx + qy dy)^2 + qk dy^2 <= tau, beyond which opacity is under 1/255, cut by
// columns of pixels. Rounded outwards: no pixel that it covers is ever missed.
struct Ellipse {
  float peak, inner, steep, mixed, scale;
};

__device__ __forceinline__ Ellipse outline(const Footprint &f) {
  float tau = fmaxf(f.log_o - LOG_ALPHA_MIN, 1e-6f) * ROUND_UP;
  float square = fmaf(f.qy, f.qy, f.qk);
  Ellipse e;
  e.peak = f.qy * root(tau * fast_rcp(f.qk)) * fast_rcp(f.qx);  // lowest point at dx = -peak
  e.inner = tau * square * ROUND_UP;
  e.steep = f.qk * f.qx * f.qx;
  e.mixed = f.qx * f.qy;
  e.scale = fast_rcp(square);
  return e;
}

// Rows of pixels, from `top` on, that the ellipse reaches between columns dx0 and dx1 (pixel
// centres, from its own). Clamped to y0..y1 by the caller, in float.
__device__ __forceinline__ float2 cut_rows(const Ellipse &e, float dx0, float dx1) {
  float low = fminf(fmaxf(-e.peak, dx0), dx1), high = fminf(fmaxf(e.peak, dx0), dx1);
  float down = root(fmaxf(fmaf(-e.steep * low, low, e.inner), 1e-30f));
  float up = root(fmaxf(fmaf(-e.steep * high, high, e.inner), 1e-30f));
  return make_float2((-up - e.mixed * high) * e.scale, (down - e.mixed * low) * e.scale);
}
