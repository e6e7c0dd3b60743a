// Which Gaussians each tile draws, nearest first.
#pragma once
#include "buffer.hpp"
#include "types.hpp"

namespace splat {

struct Bins {
  Buffer<Entry> entries;       // tile after tile; rows are those of a Gaussian after another's, by tile number
  Buffer<uint32_t> start;      // [tiles + 1] into entries
  Buffer<uint32_t> row_start;  // [n + 1]: first row of each Gaussian
};

// Sort by depth (stable: ties by index) and list, for each tile, the Gaussians whose support meets its pixels.
// Throws std::length_error where there are 2^32 pairs or more.
void bin(const Kernels& kernels, const Camera& camera, const float* geo, const uint8_t* drawn, float reach,
         int64_t count, int threads, Bins& out);

}  // namespace splat
