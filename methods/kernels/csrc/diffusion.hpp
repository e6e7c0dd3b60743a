// Values of pixels that are exchanged with the four neighbours, sweep by sweep. Plain data only: this header is compiled
// for several SIMD levels.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

// Rows of `stride` floats, a multiple of LANES. Around the rows [0, height) one more row on either side, and LANES floats
// before and behind, may be read; weights there, and those of exchanges over the image's border, are 0.
struct DiffusionArrays {
  const float *across, *down;  // weight of the exchange with the pixel to the right, and with the one below
  int64_t height, stride;
};

struct DiffusionKernels {
  // One sweep: values to `to`, both laid out like the weights.
  void (*sweep)(const DiffusionArrays&, const float* values, float* to);
};

}  // namespace splat
