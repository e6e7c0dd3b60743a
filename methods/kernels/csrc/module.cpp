// The compiled module splatproof._ext: what the machine offers, and the native kernels.
//
// Arrays come in through DLPack, float32, contiguous, on the CPU; the Python wrappers see to that and check
// the shapes. Outputs are written into arrays that the caller allocated.
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdlib>
#include <stdexcept>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "pool.hpp"
#include "render.hpp"
#include "roofline.hpp"

using namespace splat;

extern const Kernels splat_kernels_portable;
#if defined(__x86_64__)
extern const Kernels splat_kernels_avx2, splat_kernels_avx512;
#endif

namespace {

// Levels that this machine can run, slowest first.
std::vector<const Kernels*> levels() {
  std::vector<const Kernels*> found = {&splat_kernels_portable};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    found.push_back(&splat_kernels_avx2);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
      found.push_back(&splat_kernels_avx512);
  }
#endif
  return found;
}

const Kernels* current = nullptr;

void set_simd_level(const std::string& name) {
  std::string known;
  for (const Kernels* k : levels()) {
    if (name == k->name) {
      current = k;
      return;
    }
    known += std::string(known.empty() ? "" : ", ") + k->name;
  }
  throw std::invalid_argument("SIMD level '" + name + "' is not one that this machine has: " + known);
}

const Kernels& from_environment() {
  const char* name = std::getenv("SPLATPROOF_SIMD");
  if (name && *name) set_simd_level(name);
  else current = levels().back();
  return *current;
}

}  // namespace

const Kernels& splat::kernels() { return *current; }

NB_MODULE(_ext, m) {
  m.doc() = "Native CPU kernels of splatproof.";
  nb::set_leak_warnings(false);  // a result that lives until the interpreter ends is no leak
  from_environment();
  m.def("simd_level", [] { return std::string(current->name); }, "The SIMD level in use.");
  m.def("simd_levels", [] {
    std::vector<std::string> names;
    for (const Kernels* k : levels()) names.push_back(k->name);
    return names;
  }, "SIMD levels that this machine can run, slowest first.");
  m.def("set_simd_level", &set_simd_level, nb::arg("name"), "Use another level from now on.");
  m.def("threads", &threads, "Threads in use.");
  m.def("set_threads", &set_threads, nb::arg("count"), "Use so many threads from now on.");
  m.def("compiler", [] { return std::string(__VERSION__); }, "The compiler that built this module.");
  m.def("exp2", [](In<float, 1> x, Out<float, 1> y) {
    check(x.shape(0) == y.shape(0), "y");
    current->exp2(x.data(), y.data(), (int64_t)x.shape(0));
  }, nb::arg("x"), nb::arg("y"), "y = 2^x for x in [-100, 0], as the kernels compute it.");

  register_roofline(m);
  bind_anchors(m);
  bind_colour_head(m);
  bind_field(m);
  bind_raster(m);
  bind_training(m);
}
