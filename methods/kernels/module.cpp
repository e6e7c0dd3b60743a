// The compiled module splatbench._ext: what the machine offers, and the native kernels.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>

namespace nb = nanobind;

NB_MODULE(_ext, m) {
  m.doc() = "Native CPU kernels of splatbench.";
}
