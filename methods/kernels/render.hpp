// One rendered image: forward, and backward from what the forward pass kept.
#pragma once
#include <cstdint>

#include "binning.hpp"
#include "types.hpp"

namespace splat {

const Kernels& kernels();  // of the SIMD level in use

struct State {
  Camera camera;
  int64_t count = 0;
  int channels = 0, stride = 0;
  Buffer<float> geo, features;
  Buffer<uint8_t> drawn;
  Buffer<uint32_t> processed;
  Bins bins;

  int across() const { return (camera.width + TILE - 1) / TILE; }
  int tiles() const { return across() * ((camera.height + TILE - 1) / TILE); }
  Tiles view();
  Projection projection(float* radii);
  size_t bytes() const;
};

void forward(const Model& model, Pictures pictures, float* radii, int threads, State& state);
void backward(const Model& model, PictureGradients pictures, const ModelGradients& out, int threads, State& state);

}  // namespace splat
