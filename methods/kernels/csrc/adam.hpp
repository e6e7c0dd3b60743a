// Adam over several tensors at once.
#pragma once
#include <cstdint>
#include <vector>

#include "types.hpp"

namespace splat {

struct AdamGroup {
  AdamTensor tensor;
  int64_t rows, width;
  double rate;
};

// Update number `step` (from 1) of all tensors; only the rows that are set where `rows` is not null.
void adam_step(const std::vector<AdamGroup>& groups, int64_t step, double beta1, double beta2, double epsilon,
               const uint8_t* rows, int threads);

}  // namespace splat
