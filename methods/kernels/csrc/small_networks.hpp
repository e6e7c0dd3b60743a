// Networks of one hidden layer on planes, and the sums of gradients by them. Plain data only: this header is compiled
// for several SIMD levels.
//
// A plane has one row a number and one lane a sample.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

constexpr int GROUP = 32;  // samples that are worked on together, a multiple of LANES

static inline int64_t padded(int64_t columns) { return (columns + LANES - 1) / LANES * LANES; }

// A network as it is stored, [inputs, hidden] and [hidden, outputs].
struct SmallNetwork {
  const float *weight0, *bias0, *weight1, *bias1;
  int inputs, hidden, outputs;
};

// Sums over samples of the gradients by a network; rows are padded to a multiple of LANES.
struct NetworkSums {
  float *weight0, *bias0, *weight1, *bias1;
};

}  // namespace splat
