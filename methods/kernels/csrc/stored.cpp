// View-dependent colour as a small file gives it back, over all threads, for Python.
#include "stored.hpp"

#include <algorithm>

#include "arrays.hpp"
#include "levels.hpp"
#include "pool.hpp"

SPLAT_TABLES(splat::StoredKernels, stored)

namespace splat {
namespace {

void store_harmonics(In<float, 3> rest, In<float, 2> log_scales, In<float, 1> logits, double log_scale, double opacity,
                     double harmonics, In<int64_t, 1> weights, Out<float, 3> stored) {
  const int64_t n = (int64_t)rest.shape(0);
  check(rest.shape(2) == 3, "rest");
  check((int64_t)log_scales.shape(0) == n && log_scales.shape(1) == 3, "log_scales");
  check((int64_t)logits.shape(0) == n, "logits");
  check(weights.shape(0) == STEP_WEIGHTS, "weights");
  check((int64_t)stored.shape(0) == n && stored.shape(1) == rest.shape(1) && stored.shape(2) == 3, "stored");
  if (!(log_scale > 0 && opacity > 0 && harmonics > 0)) throw std::invalid_argument("a step is not above 0");
  StoredArrays a = {rest.data(), log_scales.data(), logits.data(), (int64_t)rest.shape(1), log_scale, opacity,
                    harmonics, {}, stored.data()};
  std::copy(weights.data(), weights.data() + STEP_WEIGHTS, a.weights);
  nb::gil_scoped_release release;
  const StoredKernels& kernels = stored_in_use();
  over_gaussians(threads(), n, [&](int64_t first, int64_t last) { kernels.store(a, first, last); });
}

}  // namespace

void bind_stored(nb::module_& m) {
  m.def("store_harmonics", &store_harmonics, array("rest"), array("log_scales"), array("logits"),
        nb::arg("log_scale"), nb::arg("opacity"), nb::arg("harmonics"), array("weights"), array("stored"),
        "View-dependent colour on the steps of each Gaussian's class, into the given array.");
}

}  // namespace splat
