// Anchors in view decoded into Gaussians by three small networks, and the gradients of that. Plain data only: this
// header is compiled for several SIMD levels. "Lanes" are columns padded with zeros to a multiple of LANES.
#pragma once
#include <cstdint>

#include "types.hpp"

namespace splat {

constexpr int NETWORKS = 3;
enum Network { OPACITY_NETWORK, SHAPE_NETWORK, COLOUR_NETWORK };
constexpr int ANCHORS = 32;  // anchors that are worked on together
constexpr int SHAPE = 7;     // outputs of a Gaussian's shape: three scales, a quaternion
constexpr int KEPT = 4;      // of a Gaussian for the backward pass: sigmoids of its scales, 1 / |quaternion|

// Static: each SIMD level and the portable code have their own.
static constexpr int lanes_of(int columns) { return (columns + LANES - 1) / LANES * LANES; }

struct AnchorArrays {
  const float *centres, *offsets, *features, *log_scales;  // [stored, 3], [stored, k, 3], [stored, f], [stored, 6]
  const int64_t* index;                                    // [count], ascending: anchors to decode; null: all
  int64_t stored, count;
  int k, f;
  float camera[3];
  bool with_distance;
  bool own_features;  // features and gradients by them have one row a decoded anchor instead of one a stored anchor
};

static inline int64_t row_of(const AnchorArrays& a, int64_t i) { return a.index ? a.index[i] : i; }
static inline int64_t feature_row(const AnchorArrays& a, int64_t i) { return a.own_features ? i : row_of(a, i); }

struct PackedLayer {  // from the hidden units of one network to its outputs
  int hidden, outputs;
  int first;               // of its hidden units among those of all networks, a multiple of LANES
  int first_output;        // likewise
  const float* weight;     // [hidden, output lanes]
  const float* bias;       // [output lanes]
  const float* transposed; // [outputs, hidden lanes]
};

struct PackedNetworks {
  int inputs, hidden_lanes, output_lanes;  // the lanes: of all networks together
  const float* weight;                     // [inputs, hidden lanes]
  const float* bias;                       // [hidden lanes]
  const float* transposed;                 // [hidden lanes, input lanes]
  PackedLayer layers[NETWORKS];
};

// What the forward pass keeps, one entry a decoded anchor or Gaussian.
struct DecodeState {
  float* hidden;   // [count, hidden lanes], after ReLU
  float* opacity;  // [count, k], after tanh; a Gaussian is there where it is > 0
  float* kept;     // [Gaussians, KEPT]
};

struct DecodeOutputs {
  float *means, *quaternions, *scales, *opacities, *colours;
  int64_t *rows, *slots;
};

struct DecodeGradients {
  // of the loss by what was decoded; null is zero
  const float *means, *quaternions, *scales, *opacities, *colours;
  // what was decoded
  const float *out_quaternions, *out_scales, *out_colours;
  // by the anchors, for all that are stored; null where not asked for
  float *by_centres, *by_offsets, *by_features, *by_log_scales;
  bool by_networks;
};

// Sums over anchors of the gradients by the networks, laid out as the packed weights are.
struct WeightSums {
  float *weight, *bias;
  float *layer_weight[NETWORKS], *layer_bias[NETWORKS];
};

struct DecodeKernels {
  // Hidden units and opacities of anchors [first, last), at most ANCHORS; returns how many Gaussians there are.
  int64_t (*open)(const AnchorArrays&, const PackedNetworks&, const DecodeState&, float* scratch, int64_t first,
                  int64_t last);
  // Their Gaussians, from place `at` of the outputs on.
  void (*fill)(const AnchorArrays&, const PackedNetworks&, const DecodeState&, const DecodeOutputs&, float* scratch,
               int64_t first, int64_t last, int64_t at);
  // Gradients by these anchors; those by the networks are added to the sums.
  void (*backward)(const AnchorArrays&, const PackedNetworks&, const DecodeState&, const DecodeGradients&,
                   const WeightSums&, float* scratch, int64_t first, int64_t last, int64_t at);
};

// Floats of scratch that a kernel needs.
static inline int64_t decode_scratch(const PackedNetworks& n) {
  return (int64_t)ANCHORS * (2 * lanes_of(n.inputs) + n.hidden_lanes + n.output_lanes + 12);
}

}  // namespace splat
