// Decoding of anchors over all threads.
#pragma once
#include <vector>

#include "buffer.hpp"
#include "decode.hpp"

namespace splat {

// One network as it is stored: [inputs, hidden], [hidden], [hidden, outputs], [outputs].
struct StoredNetwork {
  const float *weight0, *bias0, *weight1, *bias1;
  int hidden, outputs;
};
// Gradients by it, of the same shapes.
struct NetworkGradients {
  float *weight0, *bias0, *weight1, *bias1;
};

// One forward pass, and what its backward pass needs.
class Decoded {
 public:
  // Opens the anchors: counts the Gaussians.
  Decoded(const AnchorArrays& anchors, const StoredNetwork* networks, int threads);
  int64_t count() const { return starts_.empty() ? 0 : starts_.back(); }
  int64_t anchors() const { return anchors_; }
  size_t bytes() const { return packed_.bytes() + hidden_.bytes() + opacity_.bytes() + kept_.bytes(); }

  // Writes the Gaussians; `anchors` as before.
  void fill(const AnchorArrays& anchors, const DecodeOutputs& out, int threads);
  // Writes the gradients in full, zero for anchors that were not decoded; `by_networks` is null where they are not
  // asked for.
  void backward(const AnchorArrays& anchors, DecodeGradients gradients, const NetworkGradients* by_networks,
                int threads) const;

 private:
  int64_t blocks() const { return (anchors_ + ANCHORS - 1) / ANCHORS; }
  template <class Task>
  void over_blocks(int threads, Task task) const;
  size_t sums_size() const;
  WeightSums lay_out_sums(float* memory) const;

  int64_t anchors_;
  PackedNetworks networks_;
  DecodeState state_;
  std::vector<int64_t> starts_;  // [blocks + 1]: Gaussians before each block
  Buffer<float> packed_, hidden_, opacity_, kept_;
};

}  // namespace splat
