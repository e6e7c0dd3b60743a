// One training step but for the optimiser: render, loss and the gradients of all parameters.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

struct Photo {
  const float* truth;   // [height, width, 3]
  const uint8_t* mask;  // [height, width], or null
  double dssim;
};

// The photometric loss of the rendered view. Where it is finite, gradients and radii are written in full.
double photometric_step(const Model& model, const Camera& camera, const float* background, const Photo& photo,
                        const ModelGradients& out, float* radii, int threads);

}  // namespace splat
