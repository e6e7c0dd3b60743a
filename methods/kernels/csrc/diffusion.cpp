// Diffusion between the edges of an image, for Python. One thread: a sweep over a photo's depths takes microseconds.
#include "diffusion.hpp"

#include <algorithm>

#include "arrays.hpp"
#include "buffer.hpp"
#include "levels.hpp"

SPLAT_TABLES(splat::DiffusionKernels, diffusion)

namespace splat {
namespace {

using Plane = In<float, 2>;

// A plane with room around it: zeros beside and behind its rows, and a row of zeros above and below them.
class Framed {
 public:
  Framed(int64_t height, int64_t stride) : stride_(stride), memory_((size_t)((height + 2) * stride + 2 * LANES)) {
    std::fill(memory_.data(), memory_.data() + memory_.size(), 0.0f);
  }
  float* rows() { return memory_.data() + LANES + stride_; }
  void take(const Plane& from) {
    const int64_t width = (int64_t)from.shape(1);
    for (int64_t y = 0; y < (int64_t)from.shape(0); ++y)
      std::copy(from.data() + y * width, from.data() + (y + 1) * width, rows() + y * stride_);
  }

 private:
  int64_t stride_;
  Buffer<float> memory_;
};

void smooth(Plane values, Plane across, Plane down, int sweeps, Out<float, 2> smoothed) {
  const int64_t h = (int64_t)values.shape(0), w = (int64_t)values.shape(1);
  check(h > 0 && w > 0 && h < 1 << 24 && w < 1 << 24, "values");
  check((int64_t)across.shape(0) == h && (int64_t)across.shape(1) == w - 1, "across");
  check((int64_t)down.shape(0) == h - 1 && (int64_t)down.shape(1) == w, "down");
  check((int64_t)smoothed.shape(0) == h && (int64_t)smoothed.shape(1) == w, "smoothed");
  nb::gil_scoped_release release;
  const int64_t stride = (w + LANES - 1) / LANES * LANES;
  Framed right(h, stride), below(h, stride), now(h, stride), next(h, stride);
  right.take(across);
  below.take(down);
  now.take(values);
  const DiffusionArrays a = {right.rows(), below.rows(), h, stride};
  float *from = now.rows(), *to = next.rows();
  for (int i = 0; i < sweeps; ++i) {
    diffusion_in_use().sweep(a, from, to);
    std::swap(from, to);
  }
  for (int64_t y = 0; y < h; ++y) std::copy(from + y * stride, from + y * stride + w, smoothed.data() + y * w);
}

}  // namespace

void bind_diffusion(nb::module_& m) {
  m.def("diffuse", &smooth, array("values"), array("across"), array("down"), nb::arg("sweeps"), array("smoothed"),
        "Sweeps of exchange with the four neighbours into the given array.");
}

}  // namespace splat
