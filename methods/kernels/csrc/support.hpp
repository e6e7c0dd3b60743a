// The consistency step between anchors of neighbouring voxels, and its gradients. Plain data only: this header is
// compiled for several SIMD levels.
#pragma once
#include "small_networks.hpp"

namespace splat {

constexpr int CELLS = 27;     // of the convolution's kernel
constexpr int PAIR_CODE = 4;  // what modulates a pair: its alignment, three shares
constexpr int TOLD = 7;       // of a site that receives: axis, how unique it is, shares of the eigenvalues

struct SupportArrays {
  const float *features, *centres, *quaternions, *scales;  // [n, c], [n, 3], [n, 4], [n, 3]
  const int64_t *sites, *neighbours;                       // [pairs], cell by cell: who receives, who gives
  const int64_t* seen;                                     // [shown]: whose features are asked for
  int64_t count, pairs, shown;
  int64_t ends[CELLS];       // of each cell's pairs
  const float* convolution;  // [CELLS, c, c]
  SmallNetwork modulation, gate;
  const float *residual, *residual_bias;  // [c, c], [c]
  int c;
  bool modulated, gated;
};

struct SupportState {
  const int64_t* place;  // [n]: which of the sites that are shown it is
  float* told;           // [shown, TOLD]
  float* mixed;          // [shown, c]: sums of what was added to each site
};

struct PairSums {
  float* convolution;  // [c, lanes]
  NetworkSums modulation;
};
struct SiteSums {
  float *residual, *residual_bias;
  NetworkSums gate;
};

// Planes of a block of pairs or sites, each of as many rows as the widest.
enum SupportPlane {
  ROWS, GIVEN, ADDED, CODE_PLANE, HIDDEN_PLANE, GAMMA, BY, BY_ADDED, BY_GAMMA, BY_CODE, BY_HIDDEN, TURNED, SUPPORT_PLANES
};
static inline int64_t support_plane(const SupportArrays& a) {
  int widest = a.c > PAIR_CODE ? a.c : PAIR_CODE;
  if (a.modulation.hidden > widest) widest = a.modulation.hidden;
  if (a.gate.hidden > widest) widest = a.gate.hidden;
  return padded(widest) * GROUP;
}

struct SupportKernels {
  // What pairs [first, last) of a cell, at most GROUP, add to their sites: rows of `added` [pairs, c].
  void (*pairs)(const SupportArrays&, const SupportState&, float* added, float* memory, int cell, int64_t first,
                int64_t last);
  // Features of shown sites [first, last): rows of `out` [shown, c].
  void (*sites)(const SupportArrays&, const SupportState&, float* out, float* memory, int64_t first, int64_t last);
  // From gradients by these, those by what was mixed; those by the networks are added to the sums.
  void (*sites_backward)(const SupportArrays&, const SupportState&, const float* by_out, float* by_mixed,
                         const SiteSums&, float* memory, int64_t first, int64_t last);
  // From those, the gradients by what each pair was given [pairs, c] and by its code [pairs, PAIR_CODE].
  void (*pairs_backward)(const SupportArrays&, const SupportState&, const float* by_mixed, float* by_given,
                         float* by_code, const PairSums&, float* memory, int cell, int64_t first, int64_t last);
};

// Offset of a pair's giving site from the receiving one, and cos^2 of its angle with the axis, 0 for the site itself.
static inline float pair_cosine(const SupportArrays& a, int64_t pair, const float* axis, float* offset, float* along,
                                float* apart) {
  *along = *apart = 0;
  for (int c = 0; c < 3; ++c) {
    offset[c] = a.centres[a.neighbours[pair] * 3 + c] - a.centres[a.sites[pair] * 3 + c];
    *along += offset[c] * axis[c];
    *apart += offset[c] * offset[c];
  }
  if (!(*apart > 0)) *apart = 1;
  return *along * *along / *apart;
}

}  // namespace splat
