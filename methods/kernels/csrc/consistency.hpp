// The consistency step between anchors over all threads.
#pragma once
#include "sums.hpp"
#include "support.hpp"

namespace splat {

struct SupportGradients {
  const float* of_out;                        // of the loss by the features [shown, c]
  float *features, *quaternions, *scales;     // by all sites, in full; null where not asked for
  float* convolution;
  SmallNetworkGradients modulation, gate;
  float *residual, *residual_bias;
};

// Features of the shown sites after the step [shown, c]; `mixed` [shown, c] is what the backward pass reads.
void support(const SupportArrays& arrays, float* out, float* mixed, int threads);
void support_backward(const SupportArrays& arrays, float* mixed, const SupportGradients& gradients, int threads);

}  // namespace splat
