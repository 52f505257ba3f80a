// Depth [count] m as uint16 millimetres, 0 where nothing is seen: as `gn0.render.depth` says.
KERNEL(depth_millimetres)(const float *depth, i64 count, u16 *millimetres) {
  i64 i = (i64)blockIdx.x * blockDim.x + threadIdx.x;
  if (i >= count) return;
  float metres = depth[i];  // NaN is not below infinity either
  float steps = fminf(fmaxf(rintf(metres * 1000.f), 1.f), 65535.f);
  millimetres[i] = metres < INFINITY ? (u16)steps : (u16)0;
}
