// Which Gaussians each tile draws, nearest first.
#pragma once
#include "buffer.hpp"
#include "types.hpp"

namespace splat {

struct Bins {
  Buffer<uint32_t> entries;     // Gaussians, tile after tile
  Buffer<uint32_t> start;       // [tiles + 1] into entries
  Buffer<uint32_t> slot_start;  // [n + 1] into slots
  Buffer<uint32_t> slots;       // positions in entries, Gaussian after Gaussian, by tile number
};

// Sort by depth (stable: ties by index) and list, for each tile, the Gaussians whose support meets its pixels.
// Throws std::length_error where there are 2^32 pairs or more.
void bin(const Kernels& kernels, const Camera& camera, const float* geo, const uint8_t* drawn, float reach,
         int64_t count, int threads, Bins& out);

}  // namespace splat
