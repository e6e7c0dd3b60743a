// Arrays from Python as the bindings take them: float32, contiguous, on the CPU, checked against each other.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <optional>
#include <stdexcept>
#include <string>

#include "types.hpp"

namespace splat {

namespace nb = nanobind;

template <class T, int N>
using In = nb::ndarray<nb::pytorch, const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T, int N>
using Out = nb::ndarray<nb::pytorch, T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class A>
using Maybe = std::optional<A>;

template <class A>
auto* data(const Maybe<A>& array) {
  return array ? array->data() : nullptr;
}

// An array argument: taken as it is or refused, for a copy of an output would lose what is written into it.
inline auto array(const char* name) { return nb::arg(name).noconvert(); }

// Throws std::invalid_argument where the parts of a camera do not fit together.
Camera make_camera(const In<double, 2>& k, const In<double, 2>& pose, int width, int height, double near);

// What a set of Gaussians is given as; held while kernels read it.
struct ModelArrays {
  In<float, 2> means, quaternions, scales;
  In<float, 1> opacities;
  Maybe<In<float, 2>> colours;
  Maybe<In<float, 3>> sh, sh_rest;
  int sh_used;
  bool raw, antialiased;
  double stop, sigmas;

  // Throws std::invalid_argument where they do not fit together.
  Model model() const;
};

using Background = Maybe<In<float, 1>>;

inline void check(bool good, const char* what) {
  if (!good) throw std::invalid_argument(std::string(what) + " has the wrong shape");
}

template <class A>
void check_image(const A& a, const Camera& c, const char* what) {
  check(a.shape(0) == (size_t)c.height && a.shape(1) == (size_t)c.width, what);
}

template <class A>
void check_image(const Maybe<A>& a, const Camera& c, const char* what) {
  if (a) check_image(*a, c, what);
}

template <class A>
void check_rows(const Maybe<A>& a, int64_t n, size_t columns, const char* what) {
  check(!a || (a->shape(0) == (size_t)n && a->size() == (size_t)n * columns), what);
}

void bind_anchors(nb::module_& m);
void bind_attention(nb::module_& m);
void bind_codec(nb::module_& m);
void bind_colour_head(nb::module_& m);
void bind_consistency(nb::module_& m);
void bind_diffusion(nb::module_& m);
void bind_field(nb::module_& m);
void bind_guide_depth(nb::module_& m);
void bind_moving_anchors(nb::module_& m);
void bind_raster(nb::module_& m);
void bind_stored(nb::module_& m);
void bind_training(nb::module_& m);

}  // namespace splat
