// A smooth field over space: features of four grids at a place, read by a network of one hidden layer, and the
// gradients of that. Plain data only: this header is compiled for several SIMD levels.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

constexpr int FIELD_GRIDS = 4;
constexpr int FIELD_CHANNELS = 4;                          // features of a grid at a sample
constexpr int FIELD_FEATURES = FIELD_GRIDS * FIELD_CHANNELS;
constexpr int FIELD_ROWS = 32;                             // places that are worked on together
static_assert(FIELD_FEATURES == LANES, "features fill one row of lanes");

struct FieldArrays {
  const float* places;               // [count, 3]: 0 to 1 on each axis; the border's features hold outside
  int64_t count;
  const float* grids[FIELD_GRIDS];   // [n, n, n, channels], z first
  int sides[FIELD_GRIDS];            // n, at least 2
  int width, outputs;                // hidden units, and numbers at a place, at most LANES
};

struct PackedField {  // columns padded with zeros to a multiple of LANES
  int lanes;                                          // of the hidden units
  const float *hidden, *hidden_bias, *hidden_turned;  // [features, lanes], [lanes], [width, LANES]
  const float *out, *out_bias, *out_turned;           // [width, LANES], [LANES], [outputs, lanes]
};

// Sums over places of the gradients by the network, laid out as the packed network is.
struct FieldSums {
  float *hidden, *hidden_bias, *out, *out_bias;
};

struct FieldKernels {
  // Features and values of places [first, last), at most FIELD_ROWS.
  void (*forward)(const FieldArrays&, const PackedField&, float* scratch, int64_t first, int64_t last, float* features,
                  float* values);
  // From their features and gradients `of`: gradients by the features; those by the network are added to the sums.
  void (*backward)(const FieldArrays&, const PackedField&, const float* features, const float* of, float* scratch,
                   int64_t first, int64_t last, float* by_features, const FieldSums&);
  // Gradients by one grid, added to what is there, of all places.
  void (*scatter)(const FieldArrays&, int grid, const float* by_features, float* by_grid);
};

// Floats of scratch that a kernel needs.
static inline int64_t field_scratch(const PackedField& f) { return (int64_t)FIELD_ROWS * (3 * f.lanes + LANES); }

}  // namespace splat
