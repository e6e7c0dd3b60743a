// View-dependent colour as a small file gives it back. Plain data only: this header is compiled for several SIMD levels.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

constexpr int STEP_WEIGHTS = 6;  // of opacity and scales, in 2^-STEP_FRACTION of a class
constexpr int STEP_FRACTION = 16;
constexpr int WIDEST_STEP = 3;  // steps are 2^-3 to 2^3 times the base

struct StoredArrays {
  const float *rest, *log_scales, *logits;  // n x coefficients x 3, n x 3, n
  int64_t coefficients;
  double log_scale, opacity, harmonics;  // steps
  int64_t weights[STEP_WEIGHTS];
  float* stored;  // like `rest`
};

struct StoredKernels {
  // Gaussians [first, last).
  void (*store)(const StoredArrays&, int64_t first, int64_t last);
};

}  // namespace splat
