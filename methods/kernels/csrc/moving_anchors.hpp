// Decoding of a hierarchy of anchors over all threads.
#pragma once
#include <vector>

#include "hierarchy.hpp"
#include "sums.hpp"

namespace splat {

// Networks are given in the order of HierarchyModel, each as it is stored.

// Whether the pyramid may show a Gaussian of each anchor [count], moved by its drift [count, 3] or null.
void hierarchy_visible(const HierarchyArrays& anchors, const std::vector<SmallNetwork>& networks,
                       const Pyramid& pyramid, const float* drift, uint8_t* out, int threads);
void hierarchy_decode(const HierarchyArrays& anchors, const std::vector<SmallNetwork>& networks,
                      const HierarchyOutputs& out, int threads);
// Writes the gradients in full, zero for anchors that were not decoded; `by_networks` is empty where they are not
// asked for.
void hierarchy_backward(const HierarchyArrays& anchors, const std::vector<SmallNetwork>& networks,
                        HierarchyGradients gradients, const std::vector<SmallNetworkGradients>& by_networks,
                        int threads);

}  // namespace splat
