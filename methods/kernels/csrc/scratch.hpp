// Scratch memory of the threads that draw tiles.
#pragma once
#include <algorithm>
#include <vector>

#include "buffer.hpp"
#include "types.hpp"

namespace splat {

// Scratch of all threads for at most `rows` Gaussians of a tile at once.
class Scratches {
 public:
  Scratches(int threads, size_t rows, int features) {
    rows = (rows + LANES - 1) / LANES * LANES;
    const size_t recs = (rows + LANES) * rec_stride(features), rows16 = (rows + LANES) * LANES;
    const size_t state = (size_t)BLOCKS * (8 + features) * LANES, lists = (size_t)BLOCKS * (rows + LANES);
    const size_t each = recs + 2 * rows16 + state + lists;
    memory_.resize(each * threads);
    std::fill(memory_.data(), memory_.data() + each * threads, 0.0f);
    for (int t = 0; t < threads; ++t) {
      float* p = memory_.data() + each * t;
      Scratch s;
      s.recs = p;
      s.weights = p + recs;
      s.alphas = s.weights + rows16;
      s.state = s.alphas + rows16;
      s.lists = reinterpret_cast<uint32_t*>(s.state + state);
      each_.push_back(s);
    }
  }
  const Scratch& operator[](int thread) const { return each_[thread]; }

 private:
  Buffer<float> memory_;
  std::vector<Scratch> each_;
};

}  // namespace splat
