// Adam's update of one run of numbers.

namespace {

INLINE void adam_lanes(const AdamRate& r, vf& value, vf gradient, vf& first, vf& second) {
  first = first + (gradient - first) * all(r.first_part);
  second = second * all(r.second_keep) + gradient * gradient * all(r.second_part);
  const vf spread = square_root(second) * all(r.spread) + all(r.epsilon);
  value = value - all(r.rate) * (first / spread);
}

void adam(const AdamRate& r, const AdamTensor& t, int64_t begin, int64_t end) {
  int64_t i = begin;
  for (; i + L <= end; i += L) {
    vf value = load(t.value + i), first = load(t.first + i), second = load(t.second + i);
    adam_lanes(r, value, load(t.gradient + i), first, second);
    store(t.value + i, value);
    store(t.first + i, first);
    store(t.second + i, second);
  }
  if (i == end) return;
  float rest[4][L] = {};
  float* in[4] = {t.value + i, const_cast<float*>(t.gradient) + i, t.first + i, t.second + i};
  for (int a = 0; a < 4; ++a)
    for (int l = 0; l < end - i; ++l) rest[a][l] = in[a][l];
  vf value = load(rest[0]), first = load(rest[2]), second = load(rest[3]);
  adam_lanes(r, value, load(rest[1]), first, second);
  store(rest[0], value);
  store(rest[2], first);
  store(rest[3], second);
  for (int a = 0; a < 4; ++a)
    for (int l = 0; a != 1 && l < end - i; ++l) in[a][l] = rest[a][l];
}

}  // namespace
