// Who is who before agents: persons by number, from instances by their place in a view. `persons`
// [N, places] say who has which place, 0 nobody.

// Pictures [N, pixels].
KERNEL(name_people)(const u32 *numbers, const u8 *persons, int places, u64 pixels, u64 size,
                    u8 *out) {
  u64 k = (u64)blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= size) return;
  u32 number = numbers[k];
  out[k] = number ? persons[k / pixels * places + number - 1] : 0;
}

// Rows [N, PEOPLE_MOST, 6] by person: the share that is seen, pixels, and their box. `seen`
// [N * places, 7] counts the pixels that show somebody, those alone, those of both, and the box.
KERNEL(tell_seen)(const u32 *seen, const u8 *persons, int places, int size, float *out) {
  int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k >= size) return;
  int i = k / PEOPLE_MOST, person = k % PEOPLE_MOST + 1;
  const u32 *found = 0;
  for (int p = 0; p < places; p++)
    if (persons[i * places + p] == person) found = seen + ((i64)i * places + p) * 7;
  float *row = out + (i64)k * 6;
  row[0] = found && found[1] ? (float)((double)found[2] / (double)found[1]) : 0.f;
  row[1] = found ? (float)found[0] : 0.f;
  for (int c = 0; c < 4; c++) row[2 + c] = found ? (float)found[3 + c] : 0.f;
}
