// The idealised loops of one SIMD level, as plain functions.
#pragma once
#include <cstdint>

namespace splat {

struct RooflineLoops {
  // Each returns the number of operations done, and adds something to `sink` that depends on all of them.
  int64_t (*fma)(int64_t rounds, float* sink);                        // floating-point operations
  int64_t (*blend)(int blocks, int64_t rounds, float* sink);          // pairs of Gaussian and pixel
  int64_t (*blend_backward)(int blocks, int64_t rounds, float* sink);
  // x = x a + y over n floats (a multiple of 64)
  void (*stream)(float* x, const float* y, int64_t n);
};
constexpr int MOST_BLOCKS = 4;  // blocks of sixteen pixels in flight, for blend and blend_backward

}  // namespace splat
