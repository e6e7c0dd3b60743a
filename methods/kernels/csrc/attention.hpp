// Attention of anchors to those near them, and the gradients of that. Plain data only: this header is compiled for
// several SIMD levels.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

struct AttentionArrays {
  const float *query, *key;  // [count, width], rows padded with zeros to a multiple of LANES
  const float* value;        // [count, value_width], likewise
  int64_t count;
  int width, value_width;
  const int64_t* rows;       // [count], ascending: which of the stored anchors a row is
  const int64_t* starts;     // [stored + 1] into targets
  const int64_t* targets;    // of each stored anchor those near it, itself among them; pairs go both ways
  const int32_t* place;      // [stored]: row of an anchor, -1 where it has none
  const float* centres;      // [stored, 3], null where whoever is listed counts
  float radius;              // farther targets do not count, but an anchor always sees itself
};

struct AttentionSums {  // of each row's softmax
  float *highest, *inverse;  // [count]: largest score; 1 / sum of exp(score - largest)
};

struct AttentionGradients {
  const float* of;                  // [count, value_width]: by what was mixed
  const float* mean;                // [count]: inner product of that and what was mixed
  float *by_query, *by_key;         // [count, width]
  float* by_value;                  // [count, value_width]
};

struct AttentionKernels {
  // What rows [first, last) mix, [count, value_width]. `longest` is the most targets that an anchor has.
  void (*forward)(const AttentionArrays&, float* scratch, int64_t longest, int64_t first, int64_t last, float* mixed,
                  const AttentionSums&);
  // mean[r] of rows [first, last), with the rounding that `backward` has: an anchor that sees none but itself then
  // gives exactly nothing to its scores.
  void (*means)(const AttentionArrays&, const float* of, const float* mixed, int64_t first, int64_t last, float* mean);
  void (*backward)(const AttentionArrays&, float* scratch, int64_t longest, int64_t first, int64_t last,
                   const AttentionSums&, const AttentionGradients&);
};

// Floats of scratch that a kernel needs.
static inline int64_t attention_scratch(int64_t longest) { return 5 * (longest + LANES); }

}  // namespace splat
