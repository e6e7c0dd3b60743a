// What this machine could do: throughput of idealised loops, and the work that an image cannot do without.
#pragma once
#include <nanobind/nanobind.h>

namespace splat {

// Adds stage_seconds, roofline and count_pairs to the module.
void register_roofline(nanobind::module_& m);

}  // namespace splat
