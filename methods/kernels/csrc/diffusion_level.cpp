// A sweep of the diffusion at one SIMD level; no standard library here (see level.cpp).
#include "diffusion.hpp"
#include "simd.hpp"

namespace {

void sweep(const DiffusionArrays& a, const float* values, float* to) {
  for (int64_t y = 0; y < a.height; ++y)
    for (int64_t x = y * a.stride; x < (y + 1) * a.stride; x += LANES) {
      const vf here = load(values + x);
      const vf right = load(a.across + x) * (load(values + x + 1) - here);
      const vf left = load(a.across + x - 1) * (here - load(values + x - 1));
      const vf below = load(a.down + x) * (load(values + x + a.stride) - here);
      const vf above = load(a.down + x - a.stride) * (here - load(values + x - a.stride));
      store(to + x, here + all(0.25f) * ((right - left) + (below - above)));
    }
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::DiffusionKernels JOIN(splat_diffusion_, SPLAT_LEVEL);
const splat::DiffusionKernels JOIN(splat_diffusion_, SPLAT_LEVEL) = {sweep};
