// The colour head at one SIMD level; no standard library here (see level.cpp).
#include "colour_head.hpp"
#include "simd.hpp"

#include "activations.inl"
#include "products.inl"

namespace {

struct Memory {  // of one block
  float *first, *second;        // hidden units after ReLU
  float *by_first, *by_second;  // gradients by them
  float *outputs, *by_inputs;   // [HEAD_ROWS, LANES]
};

INLINE Memory carve(float* scratch, const PackedHead& h) {
  Memory m;
  m.first = scratch;
  m.by_first = m.first + HEAD_ROWS * h.first_lanes;
  m.second = m.by_first + HEAD_ROWS * h.first_lanes;
  m.by_second = m.second + HEAD_ROWS * h.second_lanes;
  m.outputs = m.by_second + HEAD_ROWS * h.second_lanes;
  m.by_inputs = m.outputs + HEAD_ROWS * LANES;
  return m;
}

INLINE void rectify(float* values, int count) {
  for (int i = 0; i < count; i += LANES) store(values + i, maximum(all(0), load(values + i)));
}

// by = 0 where the unit did not fire.
INLINE void block_silent(const float* units, float* by, int count) {
  for (int i = 0; i < count; i += LANES) store(by + i, keep(load(units + i) > all(0), load(by + i)));
}

STAGE void evaluate(const HeadArrays& a, const PackedHead& h, const Memory& m, int64_t first, int rows) {
  const int one = h.first_lanes, two = h.second_lanes;
  for (int r = 0; r < rows; ++r) {
    const float* each = a.of_each + a.owner[first + r] * a.first;
    float* row = m.first + r * one;
    store(row + one - LANES, all(0));
    __builtin_memcpy(row, each, a.first * sizeof(float));
  }
  product({a.colours + first * 3, 3, 1}, {h.of_colour, one}, rows, one, 3, {m.first, one}, m.first, one);
  rectify(m.first, rows * one);
  product({m.first, one, 1}, {h.second, two}, rows, two, a.first, {h.second_bias, 0}, m.second, two);
  rectify(m.second, rows * two);
  product({m.second, two, 1}, {h.third, LANES}, rows, LANES, a.second, {h.third_bias, 0}, m.outputs, LANES);
  for (int r = 0; r < rows; ++r) store(m.outputs + r * LANES, sigmoid(load(m.outputs + r * LANES)));
}

void forward(const HeadArrays& a, const PackedHead& h, float* scratch, int64_t first, int64_t last, float* adapted) {
  const Memory m = carve(scratch, h);
  const int rows = (int)(last - first);
  evaluate(a, h, m, first, rows);
  for (int r = 0; r < rows; ++r) {
    const float *out = m.outputs + r * LANES, *colour = a.colours + (first + r) * 3, share = out[3];
    for (int c = 0; c < 3; ++c) adapted[(first + r) * 3 + c] = share * colour[c] + (1 - share) * out[c];
  }
}

void backward(const HeadArrays& a, const PackedHead& h, const float* of, float* scratch, int64_t first, int64_t last,
              float* by_colours, float* by_each, const HeadSums& sums) {
  const Memory m = carve(scratch, h);
  const int rows = (int)(last - first), one = h.first_lanes, two = h.second_lanes;
  evaluate(a, h, m, first, rows);
  for (int r = 0; r < rows; ++r) {
    float* out = m.outputs + r * LANES;
    const float *colour = a.colours + (first + r) * 3, *given = of + (first + r) * 3, share = out[3];
    float by[LANES] = {};
    for (int c = 0; c < 3; ++c) {
      by_colours[(first + r) * 3 + c] = share * given[c];
      by[3] += given[c] * (colour[c] - out[c]);
      by[c] = given[c] * (1 - share) * out[c] * (1 - out[c]);
    }
    by[3] *= share * (1 - share);
    __builtin_memcpy(out, by, sizeof by);
  }
  product({m.second, 1, two}, {m.outputs, LANES}, a.second, LANES, rows, {sums.third, LANES}, sums.third, LANES);
  add_rows(m.outputs, LANES, rows, LANES, sums.third_bias);
  product({m.outputs, LANES, 1}, {h.third_transposed, two}, rows, two, HEAD_OUTPUTS, {nullptr, 0}, m.by_second, two);
  block_silent(m.second, m.by_second, rows * two);
  product({m.first, 1, one}, {m.by_second, two}, a.first, two, rows, {sums.second, two}, sums.second, two);
  add_rows(m.by_second, two, rows, two, sums.second_bias);
  product({m.by_second, two, 1}, {h.second_transposed, one}, rows, one, a.second, {nullptr, 0}, m.by_first, one);
  block_silent(m.first, m.by_first, rows * one);
  product({a.colours + first * 3, 1, 3}, {m.by_first, one}, 3, one, rows, {sums.of_colour, one}, sums.of_colour, one);
  product({m.by_first, one, 1}, {h.of_colour_transposed, LANES}, rows, LANES, a.first, {nullptr, 0}, m.by_inputs, LANES);
  for (int r = 0; r < rows; ++r) {
    const float* by = m.by_first + r * one;
    float* each = by_each + a.owner[first + r] * a.first;
    for (int i = 0; i < a.first; ++i) each[i] += by[i];
    for (int c = 0; c < 3; ++c) by_colours[(first + r) * 3 + c] += m.by_inputs[r * LANES + c];
  }
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::HeadKernels JOIN(splat_head_, SPLAT_LEVEL);
const splat::HeadKernels JOIN(splat_head_, SPLAT_LEVEL) = {forward, backward};
