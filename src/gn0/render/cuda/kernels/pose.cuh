// What may stand for a pose: rows of a matrix [4, 4], checked as `gn0.render.renderer.check_views` does.

__device__ __forceinline__ bool is_finite(const double *m, int count) {
  bool finite = true;
  for (int k = 0; k < count; k++) finite = finite && fabs(m[k]) <= 1.7976931348623157e308;
  return finite;
}

__device__ __forceinline__ bool is_rigid(const double *m, double tolerance) {
  bool rigid = true;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      double dot = m[4 * i] * m[4 * j] + m[4 * i + 1] * m[4 * j + 1] + m[4 * i + 2] * m[4 * j + 2];
      rigid = rigid && fabs(dot - (i == j ? 1.0 : 0.0)) < tolerance;
    }
  for (int k = 0; k < 4; k++) rigid = rigid && fabs(m[12 + k] - (k == 3 ? 1.0 : 0.0)) < tolerance;
  double volume = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                  m[2] * (m[4] * m[9] - m[5] * m[8]);
  return rigid && volume > 0.0;
}
