// The compiled module splatproof._ext: what the machine offers, and the native kernels.
//
// Arrays come in through DLPack, float32, contiguous, on the CPU; the Python wrappers see to that and check
// the shapes. Outputs are written into arrays that the caller allocated.
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <string>

#include "arrays.hpp"
#include "levels.hpp"
#include "pool.hpp"
#include "roofline.hpp"

using namespace splat;

NB_MODULE(_ext, m) {
  m.doc() = "Native CPU kernels of splatproof.";
  nb::set_leak_warnings(false);  // a result that lives until the interpreter ends is no leak
  set_simd_level_from_environment();
  m.def("simd_level", [] { return std::string(kernels().name); }, "The SIMD level in use.");
  m.def("simd_levels", &simd_levels, "SIMD levels that this machine can run, slowest first.");
  m.def("set_simd_level", &set_simd_level, nb::arg("name"), "Use another level from now on.");
  m.def("threads", &threads, "Threads in use.");
  m.def("set_threads", &set_threads, nb::arg("count"), "Use so many threads from now on.");
  m.def("compiler", [] { return std::string(__VERSION__); }, "The compiler that built this module.");
  m.def("exp2", [](In<float, 1> x, Out<float, 1> y) {
    check(x.shape(0) == y.shape(0), "y");
    kernels().exp2(x.data(), y.data(), (int64_t)x.shape(0));
  }, nb::arg("x"), nb::arg("y"), "y = 2^x for x in [-100, 0], as the kernels compute it.");

  register_roofline(m);
  bind_anchors(m);
  bind_attention(m);
  bind_codec(m);
  bind_colour_head(m);
  bind_consistency(m);
  bind_diffusion(m);
  bind_field(m);
  bind_guide_depth(m);
  bind_moving_anchors(m);
  bind_raster(m);
  bind_stored(m);
  bind_training(m);
}
