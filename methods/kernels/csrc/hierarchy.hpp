// Moving anchors in layers, decoded into Gaussians, and the gradients of that. Plain data only: this header is
// compiled for several SIMD levels.
//
// A layer of m anchors to each stored one has planes (see small_networks.hpp) of m * GROUP lanes, node by node, so a
// network's outputs for child j are that child's lanes as they are.
#pragma once
#include <cstdint>

#include "small_networks.hpp"

namespace splat {

constexpr int MOST_LEVELS = 7;   // layers of anchors, N - 1
constexpr int RESIDUALS = 3;     // networks of a layer of anchors
enum Residual { POSITION, SCALE, FEATURE };
constexpr int HEADS = 3;         // networks that read features and view
enum Head { COLOUR_HEAD, OPACITY_HEAD, SHAPE_HEAD };
constexpr int MOST_NETWORKS = (MOST_LEVELS - 1) * RESIDUALS + 1 + HEADS;
constexpr int OCTAVES = 4;                      // of the code of positions and of time
constexpr int CODE = 3 * (1 + 2 * OCTAVES);     // numbers of the code of a position
constexpr int TIME_CODE = 1 + 2 * OCTAVES;      // likewise of a time
constexpr int VIEW = 4;                         // distance and direction
constexpr int GAUSSIAN = 14;                    // numbers that are decoded of one

// What is stored of anchors; what a block reads of one is a record.
struct HierarchyArrays {
  const float *features, *instances, *centres, *velocities, *log_scales, *peaks, *log_spans;
  const float* offsets[MOST_LEVELS];  // [stored, k^i, 3] for layers i = 1 to N - 2, and [stored, K, 3]
  const int64_t* index;               // [count], ascending: anchors to decode; null: all
  int64_t stored, count;
  bool own_features;  // features and gradients by them have one row a decoded anchor instead of one a stored anchor
  int levels;         // N - 1
  int k, gaussians;   // children of an anchor in the layers of anchors; K
  int f, h;           // numbers of a feature and of an instance
  float period, time;
  float camera[3];
  float unit, middle[3];  // what is decoded is scaled and moved out of the anchors' frame
};

static inline int64_t row_of(const HierarchyArrays& a, int64_t i) { return a.index ? a.index[i] : i; }
static inline int64_t feature_row(const HierarchyArrays& a, int64_t i) { return a.own_features ? i : row_of(a, i); }

// Where things lie in the memory of a block, in floats from its beginning.
struct HierarchyPlaces {
  // rows of a record
  int instances, centres, velocities, log_scales, peak, log_span, offsets[MOST_LEVELS], width;
  int nodes[MOST_LEVELS];
  // planes: of a record, of a layer, of the last layer
  int64_t record, sine, cosine, life, inputs[MOST_LEVELS], log_scales_of[MOST_LEVELS], sizes[MOST_LEVELS],
      held[MOST_LEVELS], hidden[MOST_NETWORKS], moved, heads[HEADS], distance, decoded;
  int64_t by_record, by_at[MOST_LEVELS], by_log_scales[MOST_LEVELS], by_held[MOST_LEVELS], by_inputs, by_outputs,
      by_hidden, by_life, turned;
  int64_t rows, row_stride;  // [GROUP, row_stride]: records or Gaussians of one anchor after another
  int64_t size;
};

struct HierarchyModel {
  HierarchyPlaces places;
  SmallNetwork networks[MOST_NETWORKS];  // of layers 1 to N - 2; of the last positions; heads. Residual
                                         // networks read the time too: what it adds is in their bias.
  int leaf_position, heads;                  // numbers of the first network of these
};

struct HierarchyOutputs {
  float *means, *quaternions, *scales, *opacities, *colours;
  int64_t *rows, *slots;
};

struct HierarchyGradients {
  // of the loss by what was decoded; null is zero
  const float *means, *quaternions, *scales, *opacities, *colours;
  // by the stored anchors; null where not asked for
  float *features, *instances, *centres, *velocities, *log_scales, *peaks, *log_spans;
  float* offsets[MOST_LEVELS];
};

// What an image may show: points before the near plane and between four planes through the camera, all in the
// anchors' unit.
struct Pyramid {
  float rotation[9], shift[3];  // from the anchors' frame into the camera's
  float near;
  float sides[4][3];            // unit normals in the camera's frame, inwards
  float sigmas, blur;           // reach of a Gaussian in scales, and in distances from the camera
};

struct HierarchyKernels {
  // Of anchors [first, last), at most GROUP: whether a ball around one of the last anchors that holds its Gaussians
  // meets the pyramid. `drift` [count, 3] is added to positions; null: nothing is.
  void (*visible)(const HierarchyArrays&, const HierarchyModel&, const Pyramid&, const float* drift, uint8_t* out,
                  float* memory, int64_t first, int64_t last);
  void (*decode)(const HierarchyArrays&, const HierarchyModel&, const HierarchyOutputs&, float* memory, int64_t first,
                 int64_t last);
  // Gradients by these anchors; those by the networks are added to the sums.
  void (*backward)(const HierarchyArrays&, const HierarchyModel&, const HierarchyGradients&, const NetworkSums*,
                   float* memory, int64_t first, int64_t last);
};

}  // namespace splat
