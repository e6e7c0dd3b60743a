// Sums of gradients by small networks: their memory, and from there to gradients of the networks' own shapes.
#pragma once
#include <algorithm>

#include "small_networks.hpp"

namespace splat {

struct SmallNetworkGradients {  // of the shapes of the network
  float *weight0, *bias0, *weight1, *bias1;
};

inline int64_t sums_size(const SmallNetwork& n) {
  return (n.inputs + 1) * padded(n.hidden) + (n.hidden + 1) * padded(n.outputs);
}

// Takes as many floats of `memory`.
inline NetworkSums lay_out_sums(const SmallNetwork& n, float*& memory) {
  const auto take = [&](int64_t rows, int64_t columns) {
    float* here = memory;
    memory += rows * padded(columns);
    return here;
  };
  NetworkSums sums;
  sums.weight0 = take(n.inputs, n.hidden);
  sums.bias0 = take(1, n.hidden);
  sums.weight1 = take(n.hidden, n.outputs);
  sums.bias1 = take(1, n.outputs);
  return sums;
}

inline void leave_rows(const float* from, int rows, int columns, float* to) {
  for (int r = 0; r < rows; ++r) std::copy(from + r * padded(columns), from + r * padded(columns) + columns, to + r * columns);
}

inline void leave_sums(const SmallNetwork& n, const NetworkSums& sums, const SmallNetworkGradients& to) {
  leave_rows(sums.weight0, n.inputs, n.hidden, to.weight0);
  leave_rows(sums.bias0, 1, n.hidden, to.bias0);
  leave_rows(sums.weight1, n.hidden, n.outputs, to.weight1);
  leave_rows(sums.bias1, 1, n.outputs, to.bias1);
}

}  // namespace splat
