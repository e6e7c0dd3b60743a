// The field at one SIMD level; no standard library here (see level.cpp).
#include "field.hpp"
#include "simd.hpp"

#include "activations.inl"
#include "products.inl"

namespace {

typedef float Four __attribute__((vector_size(4 * FIELD_CHANNELS)));

struct Cell {  // of a grid around a place
  int64_t corner;    // sample of the lowest corner
  int64_t up, over;  // samples to the next row and layer
  float share[3];    // of the higher corner along each axis
};

INLINE Cell cell_at(const float* place, int side) {
  int64_t low[3];
  Cell c;
  for (int axis = 0; axis < 3; ++axis) {
    const float top = (float)(side - 1), wanted = place[axis] * top;
    const float at = wanted > 0 ? (wanted < top ? wanted : top) : 0;  // NaN becomes 0: there is no such sample
    const int64_t whole = (int64_t)at;
    low[axis] = whole < side - 2 ? whole : side - 2;
    c.share[axis] = at - (float)low[axis];
  }
  c.up = side;
  c.over = (int64_t)side * side;
  c.corner = (low[2] * side + low[1]) * side + low[0];
  return c;
}

// Weights of the eight corners, x fastest.
INLINE void corner_weights(const Cell& c, float* weights) {
  for (int i = 0; i < 8; ++i)
    weights[i] = (i & 1 ? c.share[0] : 1 - c.share[0]) * (i & 2 ? c.share[1] : 1 - c.share[1]) *
                 (i & 4 ? c.share[2] : 1 - c.share[2]);
}

INLINE int64_t corner_sample(const Cell& c, int i) {
  return c.corner + (i & 1) + (i & 2 ? c.up : 0) + (i & 4 ? c.over : 0);
}

struct Memory {  // of one block
  float *before, *after;  // hidden units before and after their activation
  float *by_hidden, *given;
};

INLINE Memory carve(float* scratch, const PackedField& f) {
  Memory m;
  m.before = scratch;
  m.after = m.before + FIELD_ROWS * f.lanes;
  m.by_hidden = m.after + FIELD_ROWS * f.lanes;
  m.given = m.by_hidden + FIELD_ROWS * f.lanes;
  return m;
}

// Hidden units of places whose features are known; SiLU is x sigmoid(x).
STAGE void hidden_units(const PackedField& f, const Memory& m, const float* features, int rows) {
  product({features, FIELD_FEATURES, 1}, {f.hidden, f.lanes}, rows, f.lanes, FIELD_FEATURES, {f.hidden_bias, 0},
          m.before, f.lanes);
  for (int i = 0; i < rows * f.lanes; i += LANES) {
    const vf x = load(m.before + i);
    store(m.after + i, x * sigmoid(x));
  }
}

STAGE void gather(const FieldArrays& a, int64_t first, int rows, float* features) {
  for (int g = 0; g < FIELD_GRIDS; ++g)
    for (int r = 0; r < rows; ++r) {
      const Cell c = cell_at(a.places + (first + r) * 3, a.sides[g]);
      float weights[8];
      corner_weights(c, weights);
      Four sum = {};
      for (int i = 0; i < 8; ++i) {
        Four sample;
        __builtin_memcpy(&sample, a.grids[g] + corner_sample(c, i) * FIELD_CHANNELS, sizeof sample);
        sum += weights[i] * sample;
      }
      __builtin_memcpy(features + r * FIELD_FEATURES + g * FIELD_CHANNELS, &sum, sizeof sum);
    }
}

void forward(const FieldArrays& a, const PackedField& f, float* scratch, int64_t first, int64_t last, float* features,
             float* values) {
  const Memory m = carve(scratch, f);
  const int rows = (int)(last - first);
  float* mine = features + first * FIELD_FEATURES;
  gather(a, first, rows, mine);
  hidden_units(f, m, mine, rows);
  product({m.after, f.lanes, 1}, {f.out, LANES}, rows, LANES, a.width, {f.out_bias, 0}, m.given, LANES);
  for (int r = 0; r < rows; ++r)
    __builtin_memcpy(values + (first + r) * a.outputs, m.given + r * LANES, a.outputs * sizeof(float));
}

void backward(const FieldArrays& a, const PackedField& f, const float* features, const float* of, float* scratch,
              int64_t first, int64_t last, float* by_features, const FieldSums& sums) {
  const Memory m = carve(scratch, f);
  const int rows = (int)(last - first);
  const float* mine = features + first * FIELD_FEATURES;
  hidden_units(f, m, mine, rows);
  for (int r = 0; r < rows; ++r) {
    store(m.given + r * LANES, all(0));
    __builtin_memcpy(m.given + r * LANES, of + (first + r) * a.outputs, a.outputs * sizeof(float));
  }
  product({m.after, 1, f.lanes}, {m.given, LANES}, a.width, LANES, rows, {sums.out, LANES}, sums.out, LANES);
  add_rows(m.given, LANES, rows, LANES, sums.out_bias);
  product({m.given, LANES, 1}, {f.out_turned, f.lanes}, rows, f.lanes, a.outputs, {nullptr, 0}, m.by_hidden, f.lanes);
  for (int i = 0; i < rows * f.lanes; i += LANES) {
    const vf x = load(m.before + i), s = sigmoid(x);
    store(m.by_hidden + i, load(m.by_hidden + i) * s * (all(1) + x * (all(1) - s)));
  }
  product({mine, 1, FIELD_FEATURES}, {m.by_hidden, f.lanes}, FIELD_FEATURES, f.lanes, rows, {sums.hidden, f.lanes},
          sums.hidden, f.lanes);
  add_rows(m.by_hidden, f.lanes, rows, f.lanes, sums.hidden_bias);
  product({m.by_hidden, f.lanes, 1}, {f.hidden_turned, LANES}, rows, LANES, a.width, {nullptr, 0},
          by_features + first * FIELD_FEATURES, LANES);
}

void scatter(const FieldArrays& a, int grid, const float* by_features, float* by_grid) {
  for (int64_t p = 0; p < a.count; ++p) {
    const Cell c = cell_at(a.places + p * 3, a.sides[grid]);
    float weights[8];
    corner_weights(c, weights);
    Four by;
    __builtin_memcpy(&by, by_features + p * FIELD_FEATURES + grid * FIELD_CHANNELS, sizeof by);
    for (int i = 0; i < 8; ++i) {
      float* at = by_grid + corner_sample(c, i) * FIELD_CHANNELS;
      Four sum;
      __builtin_memcpy(&sum, at, sizeof sum);
      sum += weights[i] * by;
      __builtin_memcpy(at, &sum, sizeof sum);
    }
  }
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::FieldKernels JOIN(splat_field_, SPLAT_LEVEL);
const splat::FieldKernels JOIN(splat_field_, SPLAT_LEVEL) = {forward, backward, scatter};
