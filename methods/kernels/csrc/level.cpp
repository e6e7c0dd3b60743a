// The kernels of one SIMD level. Compiled once for each level with its own flags; no standard library here,
// because an inline function compiled for AVX-512 must never be the one that the linker keeps for all.
#include "simd.hpp"

#include "harmonics.inl"
#include "projection.inl"
#include "projection_backward.inl"
#include "ellipse.inl"
#include "raster.inl"
#include "footprint.inl"
#include "raster_backward.inl"
#include "loss.inl"
#include "adam.inl"

namespace {

void exp2_many(const float* x, float* y, int64_t count) {
  for (int64_t i = 0; i < count; i += L) {
    float in[L], out[L];
    for (int l = 0; l < L; ++l) in[l] = i + l < count ? x[i + l] : 0;
    vf values[] = {load(in)};
    exp2_of(values);
    store(out, values[0]);
    for (int l = 0; l < L && i + l < count; ++l) y[i + l] = out[l];
  }
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)
#define STRING2(a) #a
#define STRING(a) STRING2(a)

extern const splat::Kernels JOIN(splat_kernels_, SPLAT_LEVEL);
const splat::Kernels JOIN(splat_kernels_, SPLAT_LEVEL) = {STRING(SPLAT_LEVEL), project, footprints, spans, render_tile<false>, render_tile<true>,
                                                         backward_tile, backward_project, loss_rows, adam, exp2_many};
