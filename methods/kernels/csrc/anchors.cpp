#include "anchors.hpp"

#include <algorithm>
#include <cstring>

#include "levels.hpp"
#include "pool.hpp"
#include "render.hpp"

SPLAT_TABLES(splat::DecodeKernels, decode)

namespace splat {
namespace {

constexpr int64_t MOST_SUMS = 32;  // partial sums of the networks' gradients, whatever the number of threads

// Numbers of a padded weight matrix or bias, from memory that is handed out piece by piece.
float* take(float*& memory, size_t count) {
  float* piece = memory;
  memory += count;
  return piece;
}

// out[r, column + c] = in[r, c], and its transpose.
void place(const float* in, int rows, int columns, float* out, int stride) {
  for (int r = 0; r < rows; ++r) std::copy(in + r * columns, in + (r + 1) * columns, out + (size_t)r * stride);
}
void place_transposed(const float* in, int rows, int columns, float* out, int stride) {
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c) out[(size_t)c * stride + r] = in[r * columns + c];
}

// Zeroes the rows of the gradients that no decoded anchor from `first` to `last` writes, up to the next decoded one.
void clear_between(const AnchorArrays& a, const DecodeGradients& g, int64_t first, int64_t last) {
  const auto clear = [&](int64_t from, int64_t to) {
    const auto zero = [&](float* by, int64_t width) {
      if (by && to > from) std::memset(by + from * width, 0, (size_t)((to - from) * width) * sizeof(float));
    };
    zero(g.by_centres, 3);
    zero(g.by_offsets, (int64_t)a.k * 3);
    if (!a.own_features) zero(g.by_features, a.f);
    zero(g.by_log_scales, 6);
  };
  if (first == 0) clear(0, a.count ? row_of(a, 0) : a.stored);
  for (int64_t i = first; i < last; ++i) clear(row_of(a, i) + 1, i + 1 < a.count ? row_of(a, i + 1) : a.stored);
}

}  // namespace

Decoded::Decoded(const AnchorArrays& anchors, const StoredNetwork* stored, int threads)
    : anchors_(anchors.count), networks_{}, state_{} {
  PackedNetworks& n = networks_;
  n.inputs = anchors.f + (anchors.with_distance ? 4 : 3);
  const int in = lanes_of(n.inputs);
  size_t layers = 0;
  for (int i = 0; i < NETWORKS; ++i) {
    n.layers[i] = {stored[i].hidden, stored[i].outputs, n.hidden_lanes, n.output_lanes, nullptr, nullptr, nullptr};
    n.hidden_lanes += lanes_of(stored[i].hidden);
    n.output_lanes += lanes_of(stored[i].outputs);
    layers += (size_t)(stored[i].hidden + 1) * lanes_of(stored[i].outputs) +
              (size_t)stored[i].outputs * lanes_of(stored[i].hidden);
  }
  const size_t size = (size_t)(n.inputs + 1) * n.hidden_lanes + (size_t)n.hidden_lanes * in + layers;
  packed_.resize(size);
  std::fill(packed_.data(), packed_.data() + size, 0.0f);
  float* memory = packed_.data();
  float *weight = take(memory, (size_t)n.inputs * n.hidden_lanes), *bias = take(memory, n.hidden_lanes),
        *transposed = take(memory, (size_t)n.hidden_lanes * in);
  n.weight = weight;
  n.bias = bias;
  n.transposed = transposed;
  for (int i = 0; i < NETWORKS; ++i) {
    PackedLayer& layer = n.layers[i];
    const int lanes = lanes_of(layer.outputs), units = lanes_of(layer.hidden);
    place(stored[i].weight0, n.inputs, layer.hidden, weight + layer.first, n.hidden_lanes);
    place(stored[i].bias0, 1, layer.hidden, bias + layer.first, 0);
    place_transposed(stored[i].weight0, n.inputs, layer.hidden, transposed + (size_t)layer.first * in, in);
    float *second = take(memory, (size_t)layer.hidden * lanes), *second_bias = take(memory, lanes),
          *second_transposed = take(memory, (size_t)layer.outputs * units);
    place(stored[i].weight1, layer.hidden, layer.outputs, second, lanes);
    place(stored[i].bias1, 1, layer.outputs, second_bias, 0);
    place_transposed(stored[i].weight1, layer.hidden, layer.outputs, second_transposed, units);
    layer.weight = second;
    layer.bias = second_bias;
    layer.transposed = second_transposed;
  }
  hidden_.resize((size_t)anchors_ * n.hidden_lanes);
  opacity_.resize((size_t)anchors_ * anchors.k);
  state_ = {hidden_.data(), opacity_.data(), nullptr};
  starts_.assign(blocks() + 1, 0);
  over_blocks(threads, [&](int64_t block, int64_t first, int64_t last, float* scratch) {
    starts_[block + 1] = decode_in_use().open(anchors, networks_, state_, scratch, first, last);
  });
  for (int64_t b = 0; b < blocks(); ++b) starts_[b + 1] += starts_[b];
}

// task(block, first anchor, last anchor, scratch)
template <class Task>
void Decoded::over_blocks(int threads, Task task) const {
  constexpr int64_t PIECE = 8;
  const int64_t each = decode_scratch(networks_);
  Buffer<float> scratch((size_t)(each * threads));
  parallel(threads, (int)((blocks() + PIECE - 1) / PIECE), [&](int piece, int worker) {
    for (int64_t b = piece * PIECE; b < std::min(blocks(), (piece + 1) * PIECE); ++b)
      task(b, b * ANCHORS, std::min(anchors_, (b + 1) * ANCHORS), scratch.data() + each * worker);
  });
}

void Decoded::fill(const AnchorArrays& anchors, const DecodeOutputs& out, int threads) {
  kept_.resize((size_t)count() * KEPT);
  state_.kept = kept_.data();
  over_blocks(threads, [&](int64_t block, int64_t first, int64_t last, float* scratch) {
    decode_in_use().fill(anchors, networks_, state_, out, scratch, first, last, starts_[block]);
  });
}

size_t Decoded::sums_size() const {
  size_t size = (size_t)(networks_.inputs + 1) * networks_.hidden_lanes;
  for (const PackedLayer& layer : networks_.layers) size += (size_t)(layer.hidden + 1) * lanes_of(layer.outputs);
  return size;
}

WeightSums Decoded::lay_out_sums(float* memory) const {
  WeightSums sums;
  sums.weight = take(memory, (size_t)networks_.inputs * networks_.hidden_lanes);
  sums.bias = take(memory, networks_.hidden_lanes);
  for (int i = 0; i < NETWORKS; ++i) {
    const PackedLayer& layer = networks_.layers[i];
    sums.layer_weight[i] = take(memory, (size_t)layer.hidden * lanes_of(layer.outputs));
    sums.layer_bias[i] = take(memory, lanes_of(layer.outputs));
  }
  return sums;
}

void Decoded::backward(const AnchorArrays& anchors, DecodeGradients g, const NetworkGradients* by_networks,
                       int threads) const {
  g.by_networks = by_networks != nullptr;
  const int64_t parts = std::clamp<int64_t>(blocks() / 4, 1, MOST_SUMS), each = decode_scratch(networks_);
  const size_t size = sums_size();
  Buffer<float> scratch((size_t)(each * threads)), sums(size * parts);
  parallel(threads, (int)parts, [&](int part, int worker) {
    float* mine = sums.data() + size * part;
    std::fill(mine, mine + size, 0.0f);
    const WeightSums here = lay_out_sums(mine);
    for (int64_t b = blocks() * part / parts; b < blocks() * (part + 1) / parts; ++b) {
      const int64_t first = b * ANCHORS, last = std::min(anchors_, first + ANCHORS);
      decode_in_use().backward(anchors, networks_, state_, g, here, scratch.data() + each * worker, first, last, starts_[b]);
      clear_between(anchors, g, first, last);
    }
  });
  if (anchors_ == 0) clear_between(anchors, g, 0, 0);
  if (!by_networks) return;
  for (int64_t part = 1; part < parts; ++part)
    for (size_t i = 0; i < size; ++i) sums[i] += sums[size * part + i];
  const WeightSums total = lay_out_sums(sums.data());
  const auto leave = [](const float* from, int stride, int rows, int columns, float* to) {
    for (int r = 0; r < rows; ++r) std::copy(from + (size_t)r * stride, from + (size_t)r * stride + columns, to + (size_t)r * columns);
  };
  for (int i = 0; i < NETWORKS; ++i) {
    const PackedLayer& layer = networks_.layers[i];
    const int lanes = lanes_of(layer.outputs);
    leave(total.weight + layer.first, networks_.hidden_lanes, networks_.inputs, layer.hidden, by_networks[i].weight0);
    leave(total.bias + layer.first, 0, 1, layer.hidden, by_networks[i].bias0);
    leave(total.layer_weight[i], lanes, layer.hidden, layer.outputs, by_networks[i].weight1);
    leave(total.layer_bias[i], 0, 1, layer.outputs, by_networks[i].bias1);
  }
}

}  // namespace splat
