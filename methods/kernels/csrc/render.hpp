// One rendered image: forward, and backward from what the forward pass kept.
#pragma once
#include <cstdint>

#include "binning.hpp"
#include "levels.hpp"
#include "types.hpp"

namespace splat {

struct State {
  Camera camera;
  int64_t count = 0;
  int channels = 0, stride = 0;
  float stop = T_MIN, reach = 0;  // of the model
  Buffer<float> geo, features;
  Buffer<uint8_t> drawn;
  Buffer<uint32_t> processed;
  Buffer<uint16_t> blocks;
  Buffer<float> trace;
  Bins bins;
  State* drawn_before = nullptr;  // the picture whose layout and light this one has, with other colours

  int across() const { return (camera.width + TILE - 1) / TILE; }
  int tiles() const { return across() * ((camera.height + TILE - 1) / TILE); }
  Tiles view();
  Projection projection(float* radii);
  State& laid() { return drawn_before ? *drawn_before : *this; }
  size_t bytes() const;
};

// Project and sort into tiles: what every picture of the model with as many features as these shares, from this camera.
void lay_out(const Model& model, const Pictures& pictures, float* radii, int threads, State& state);
void forward(const Model& model, Pictures pictures, float* radii, int threads, State& state);

// The colour of a picture of the same Gaussians from the same camera with other colours: `state` stays with
// `before`, which must outlive it. Its channels are those of the model, which has colours alone.
void forward_again(const Model& model, Pictures pictures, State& before, int threads, State& state);

// Pairs of Gaussian and tile that all pictures of this process so far were made of: work that does not depend on
// the machine's load, nor on threads.
uint64_t pairs_listed();

// Pairs of Gaussian and tile whose gradients are held at once by every backward pass from now on. Fewer take less
// memory and more time; the result has the same bits.
void set_backward_rows(size_t count);
void backward(const Model& model, PictureGradients pictures, const ModelGradients& out, int threads, State& state);


// Each block alone, as if the others' Gaussians were not there. Outputs are [count, height, width, ...]; block[i] is
// in [0, count).
void forward_blocks(const Model& model, const Camera& camera, const int64_t* block, int count, Pictures first,
                    int threads);

}  // namespace splat
