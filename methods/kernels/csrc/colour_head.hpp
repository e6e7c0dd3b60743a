// Colours of Gaussians that a small network adapts to the light of a view, and the gradients of that. Plain data only:
// this header is compiled for several SIMD levels.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

constexpr int HEAD_ROWS = 32;    // Gaussians that are worked on together
constexpr int HEAD_OUTPUTS = 4;  // a colour, and the share of the Gaussian's own in the mix

struct HeadArrays {
  const float* colours;   // [count, 3]
  const float* of_each;   // [anchors, first]: what the first layer makes of an anchor, bias included
  const int64_t* owner;   // [count], ascending: anchor of each Gaussian
  int64_t count, anchors;
  int first, second;      // units of the two hidden layers
};

struct PackedHead {  // columns padded with zeros to a multiple of LANES
  int first_lanes, second_lanes;
  const float *of_colour, *of_colour_transposed;               // [3, first lanes], [first, LANES]
  const float *second, *second_bias, *second_transposed;       // [first, second lanes], [second, first lanes]
  const float *third, *third_bias, *third_transposed;          // [second, LANES], [HEAD_OUTPUTS, second lanes]
};

// Sums over Gaussians of the gradients by the weights, laid out as the packed weights are.
struct HeadSums {
  float *of_colour, *second, *second_bias, *third, *third_bias;
};

struct HeadKernels {
  // Adapted colours of Gaussians [first, last), at most HEAD_ROWS.
  void (*forward)(const HeadArrays&, const PackedHead&, float* scratch, int64_t first, int64_t last, float* adapted);
  // From their gradients `of`: gradients by colours; those by the anchors and weights are added to what is there.
  void (*backward)(const HeadArrays&, const PackedHead&, const float* of, float* scratch, int64_t first, int64_t last,
                   float* by_colours, float* by_each, const HeadSums&);
};

// Floats of scratch that a kernel needs.
static inline int64_t head_scratch(const PackedHead& h) {
  return (int64_t)HEAD_ROWS * (2 * (h.first_lanes + h.second_lanes) + 2 * LANES);
}

}  // namespace splat
