// The consistency step at one SIMD level; no standard library here (see level.cpp). Planes have a pair or a site a lane.
#include "support.hpp"
#include "simd.hpp"

#include "activations.inl"
#include "products.inl"
#include "planes.inl"

namespace {

struct Planes {
  float* memory;
  int64_t each;
  __attribute__((always_inline)) float* operator[](SupportPlane i) const { return memory + i * each; }
};

// Rows of an array, which(i) for lanes i below `count`, as a plane; the other lanes are 0.
template <class Which>
INLINE void gather(const float* from, int width, int64_t count, Which which, const Planes& m, SupportPlane to) {
  const int64_t stride = padded(width);
  float* rows = m[ROWS];
  clear((GROUP - count) * stride, rows + count * stride);
  for (int64_t i = 0; i < count; ++i) {
    float* row = rows + i * stride;
    piece(from, which(i), width, row);
  }
  to_planes(rows, stride, width, m[to]);
}

INLINE void scatter(const Planes& m, SupportPlane from, int width, int64_t count, float* to) {
  const int64_t stride = padded(width);
  to_rows(m[from], width, m[ROWS], stride);
  for (int64_t i = 0; i < count; ++i) {
    const float* row = m[ROWS] + i * stride;
    leave(row, i, width, to);
  }
}

STAGE void write_codes(const SupportArrays& a, const SupportState& s, int64_t first, int64_t last, float* code) {
  clear(PAIR_CODE * GROUP, code);
  for (int64_t pair = first; pair < last; ++pair, ++code) {
    const float* told = s.told + s.place[a.sites[pair]] * TOLD;
    float offset[3], along, apart;
    code[0] = pair_cosine(a, pair, told, offset, &along, &apart) * told[3];
    for (int c = 0; c < 3; ++c) code[(1 + c) * GROUP] = told[4 + c];
  }
}

// What was given, what the convolution makes of it and, where it is modulated, by how much.
STAGE void open_pairs(const SupportArrays& a, const SupportState& s, const Planes& m, int cell, int64_t first,
                      int64_t last) {
  gather(a.features, a.c, last - first, [&](int64_t i) { return a.neighbours[first + i]; }, m, GIVEN);
  product({a.convolution + (int64_t)cell * a.c * a.c, 1, a.c}, {m[GIVEN], GROUP}, a.c, GROUP, a.c, {nullptr, 0},
          m[ADDED], GROUP);
  if (!a.modulated) return;
  write_codes(a, s, first, last, m[CODE_PLANE]);
  evaluate(a.modulation, m[CODE_PLANE], GROUP, m[HIDDEN_PLANE], m[GAMMA]);
}

INLINE void multiply(const float* a, const float* b, int64_t count, float* to) {
  each(count, to, [=](int64_t i) { return load(a + i) * load(b + i); });
}

void pairs(const SupportArrays& a, const SupportState& s, float* added, float* memory, int cell, int64_t first,
           int64_t last) {
  const Planes m = {memory, support_plane(a)};
  open_pairs(a, s, m, cell, first, last);
  if (a.modulated) multiply(m[ADDED], m[GAMMA], (int64_t)a.c * GROUP, m[ADDED]);
  scatter(m, ADDED, a.c, last - first, added + first * a.c);
}

// What was mixed in GIVEN, the residual in ADDED and the gate, a row, in GAMMA.
STAGE void open_sites(const SupportArrays& a, const SupportState& s, const Planes& m, int64_t first, int64_t last) {
  gather(s.mixed, a.c, last - first, [&](int64_t i) { return first + i; }, m, GIVEN);
  product({a.residual, 1, a.c}, {m[GIVEN], GROUP}, a.c, GROUP, a.c, {a.residual_bias, 1, true}, m[ADDED], GROUP);
  float* gate = m[GAMMA];
  if (a.gated) evaluate(a.gate, m[GIVEN], GROUP, m[HIDDEN_PLANE], gate);
  each(GROUP, gate, [&](int64_t i) { return a.gated ? sigmoid(load(gate + i)) : all(1); });
}

void sites(const SupportArrays& a, const SupportState& s, float* out, float* memory, int64_t first, int64_t last) {
  const Planes m = {memory, support_plane(a)};
  open_sites(a, s, m, first, last);
  gather(a.features, a.c, last - first, [&](int64_t i) { return a.seen[first + i]; }, m, BY);
  const float *own = m[BY], *change = m[ADDED], *gate = m[GAMMA];
  each((int64_t)a.c * GROUP, m[BY_ADDED],
       [=](int64_t i) { return load(own + i) + load(gate + i % GROUP) * load(change + i); });
  scatter(m, BY_ADDED, a.c, last - first, out + first * a.c);
}

void sites_backward(const SupportArrays& a, const SupportState& s, const float* by_out, float* by_mixed,
                    const SiteSums& sums, float* memory, int64_t first, int64_t last) {
  const Planes m = {memory, support_plane(a)};
  open_sites(a, s, m, first, last);
  gather(by_out, a.c, last - first, [&](int64_t i) { return first + i; }, m, BY);
  const float *by = m[BY], *change = m[ADDED], *gate = m[GAMMA];
  for (int i = 0; i < GROUP; i += LANES) {
    const vf open = load(gate + i);
    vf sum = all(0);
    for (int c = 0; c < a.c; ++c) {
      sum = sum + load(by + c * GROUP + i) * load(change + c * GROUP + i);
      store(m[BY_ADDED] + c * GROUP + i, load(by + c * GROUP + i) * open);
    }
    store(m[BY_GAMMA] + i, sum * open * (all(1) - open));
  }
  add_products(m[GIVEN], a.c, m[BY_ADDED], a.c, GROUP, m[TURNED], sums.residual, sums.residual_bias);
  product({a.residual, a.c, 1}, {m[BY_ADDED], GROUP}, a.c, GROUP, a.c, {nullptr, 0}, m[BY], GROUP);
  if (a.gated)
    pull(a.gate, &sums.gate, m[GIVEN], m[HIDDEN_PLANE], m[BY_GAMMA], GROUP, m[BY_HIDDEN], m[TURNED], m[BY]);
  scatter(m, BY, a.c, last - first, by_mixed + first * a.c);
}

void pairs_backward(const SupportArrays& a, const SupportState& s, const float* by_mixed, float* by_given,
                    float* by_code, const PairSums& sums, float* memory, int cell, int64_t first, int64_t last) {
  const Planes m = {memory, support_plane(a)};
  const int64_t size = (int64_t)a.c * GROUP;
  open_pairs(a, s, m, cell, first, last);
  gather(by_mixed, a.c, last - first, [&](int64_t i) { return s.place[a.sites[first + i]]; }, m, BY);
  const float* by_added = m[a.modulated ? BY_ADDED : BY];
  if (a.modulated) {
    multiply(m[BY], m[GAMMA], size, m[BY_ADDED]);
    multiply(m[BY], m[ADDED], size, m[BY_GAMMA]);
    clear(PAIR_CODE * GROUP, m[BY_CODE]);
    pull(a.modulation, &sums.modulation, m[CODE_PLANE], m[HIDDEN_PLANE], m[BY_GAMMA], GROUP, m[BY_HIDDEN], m[TURNED],
         m[BY_CODE]);
    scatter(m, BY_CODE, PAIR_CODE, last - first, by_code + first * PAIR_CODE);
  }
  add_products(m[GIVEN], a.c, by_added, a.c, GROUP, m[TURNED], sums.convolution, nullptr);
  product({a.convolution + (int64_t)cell * a.c * a.c, a.c, 1}, {by_added, GROUP}, a.c, GROUP, a.c, {nullptr, 0},
          m[ADDED], GROUP);
  scatter(m, ADDED, a.c, last - first, by_given + first * a.c);
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::SupportKernels JOIN(splat_support_, SPLAT_LEVEL);
const splat::SupportKernels JOIN(splat_support_, SPLAT_LEVEL) = {pairs, sites, sites_backward, pairs_backward};
