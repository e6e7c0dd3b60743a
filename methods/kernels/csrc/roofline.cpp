#include "roofline.hpp"

#include <nanobind/ndarray.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "buffer.hpp"
#include "levels.hpp"
#include "pool.hpp"
#include "render.hpp"
#include "roofline_loops.hpp"
#include "stages.hpp"

SPLAT_TABLES(splat::RooflineLoops, roofline)

namespace nb = nanobind;

namespace splat {
namespace {

using Numbers = std::map<std::string, double>;
using Rows = nb::ndarray<nb::pytorch, const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// Least wall seconds of `repeats` turns in which every thread runs task(thread) once.
template <class Task>
double least_seconds(int repeats, Task task) {
  double least = 1e30;
  for (int i = 0; i < repeats; ++i) {
    const auto start = std::chrono::steady_clock::now();
    parallel(threads(), threads(), [&](int t, int) { task(t); });
    least = std::min(least, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  return least;
}

// Operations a second of all threads together, by a loop that returns how many it did.
template <class Loop>
double rate(double seconds, Loop loop) {
  constexpr int REPEATS = 5;
  std::vector<int64_t> done(threads());
  std::vector<float> sinks((size_t)threads() * 64);
  int64_t rounds = 16;
  for (;;) {  // as many rounds as take the wished time
    const double took = least_seconds(3, [&](int t) { done[t] = loop(rounds, &sinks[(size_t)t * 64]); });
    if (took >= seconds / REPEATS / 2) break;
    rounds *= 2;
  }
  const double took = least_seconds(REPEATS, [&](int t) { done[t] = loop(rounds, &sinks[(size_t)t * 64]); });
  int64_t total = 0;
  for (int64_t d : done) total += d;
  return total / took;
}

// Bytes a second of x = x a + y over arrays of `bytes` in all, shared out among the threads.
double bandwidth(double seconds, int64_t bytes) {
  const int n = threads();
  const int64_t each = std::max<int64_t>(1, bytes / 8 / n / 64) * 64;
  Buffer<float> x((size_t)(each * n)), y((size_t)(each * n));
  const auto touch = [&](int t) {
    std::fill(x.data() + each * t, x.data() + each * (t + 1), 1.0f);
    std::fill(y.data() + each * t, y.data() + each * (t + 1), 1.0f);
  };
  least_seconds(1, touch);
  const auto passes = [&](int64_t rounds) {
    return [&, rounds](int t) {
      for (int64_t i = 0; i < rounds; ++i) roofline_in_use().stream(x.data() + each * t, y.data() + each * t, each);
    };
  };
  int64_t rounds = 1;
  while (least_seconds(3, passes(rounds)) < seconds / 10) rounds *= 2;
  return 12.0 * (double)(each * n) * (double)rounds / least_seconds(5, passes(rounds));
}

Numbers roofline(double seconds, int64_t bytes) {
  if (!(seconds > 0 && seconds <= 60) || bytes < 1 || bytes > ((int64_t)1 << 33))
    throw std::invalid_argument("seconds must be in (0, 60], bytes in [1, 2^33]");
  const RooflineLoops& l = roofline_in_use();
  Numbers out;
  out["flops"] = rate(seconds, l.fma);
  double blend = 0, backward = 0;
  for (int b = 1; b <= MOST_BLOCKS; ++b) {
    blend = std::max(blend, rate(seconds / MOST_BLOCKS, [&](int64_t n, float* s) { return l.blend(b, n, s); }));
    backward = std::max(
        backward, rate(seconds / MOST_BLOCKS, [&](int64_t n, float* s) { return l.blend_backward(b, n, s); }));
  }
  out["blend_pairs"] = blend;
  out["blend_backward_pairs"] = backward;
  out["bytes"] = bandwidth(seconds, bytes);
  return out;
}

// Rows of `splats`, nearest first: x, y (pixels), the inverse covariance's a, b, c, opacity, and the half-extents
// of the support along x and y. In double precision, one thread, no SIMD.
Numbers count_pairs(Rows splats, int width, int height) {
  if (splats.shape(1) != 8 || width < 1 || height < 1) throw std::invalid_argument("splats must be [n, 8]");
  const int across = (width + BLOCK - 1) / BLOCK, down = (height + BLOCK - 1) / BLOCK;
  std::vector<double> light((size_t)across * down * LANES, 1.0);
  std::vector<int> open((size_t)across * down, 0);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) ++open[(size_t)(y / BLOCK) * across + x / BLOCK];
  int64_t contributing = 0, lanes = 0;
  for (size_t i = 0; i < splats.shape(0); ++i) {
    const double* s = splats.data() + 8 * i;
    if (!(s[5] * 255 >= 1)) continue;
    const double limit = 2 * std::log(255 * s[5]);
    const int left = (int)std::max(0.0, std::floor((s[0] - s[6] - 0.5) / BLOCK));
    const int right = (int)std::min(across - 1.0, std::floor((s[0] + s[6] - 0.5) / BLOCK));
    const int top = (int)std::max(0.0, std::floor((s[1] - s[7] - 0.5) / BLOCK));
    const int bottom = (int)std::min(down - 1.0, std::floor((s[1] + s[7] - 0.5) / BLOCK));
    for (int by = top; by <= bottom; ++by)
      for (int bx = left; bx <= right; ++bx) {
        int& pixels = open[(size_t)by * across + bx];
        if (pixels == 0) continue;
        double* t = &light[((size_t)by * across + bx) * LANES];
        bool some = false;
        for (int l = 0; l < LANES; ++l) {
          const int x = bx * BLOCK + l % BLOCK, y = by * BLOCK + l / BLOCK;
          if (x >= width || y >= height) continue;
          const double dx = x + 0.5 - s[0], dy = y + 0.5 - s[1];
          const double power = s[2] * dx * dx + 2 * s[3] * dx * dy + s[4] * dy * dy;
          if (power > limit) continue;
          some = true;
          if (t[l] < T_MIN) continue;  // full
          const double after = t[l] * (1 - std::min(s[5] * std::exp(-0.5 * power), (double)ALPHA_MAX));
          if (after >= T_MIN) ++contributing;
          else --pixels;
          t[l] = after;
        }
        if (some) lanes += LANES;
      }
  }
  return {{"contributing", (double)contributing}, {"lanes", (double)lanes}};
}

Numbers seconds_of_stages() {
  static const char* names[STAGES] = {"project", "bin", "blend", "blend_backward", "project_backward"};
  Numbers out;
  for (int i = 0; i < STAGES; ++i) out[names[i]] = stage_seconds[i].load(std::memory_order_relaxed);
  return out;
}

}  // namespace

void register_roofline(nb::module_& m) {
  m.def("stage_seconds", &seconds_of_stages, "Wall seconds of each stage of the last render and backward pass.");
  m.def("roofline", &roofline, nb::arg("seconds"), nb::arg("bytes"), nb::call_guard<nb::gil_scoped_release>(),
        "What all threads together could do a second at the SIMD level in use: flops (multiply-adds count two), "
        "blend_pairs and blend_backward_pairs (Gaussian and pixel), bytes (x = x a + y over `bytes` of memory). "
        "Each is measured for some `seconds`.");
  m.def("count_pairs", &count_pairs, nb::arg("splats"), nb::arg("width"), nb::arg("height"),
        nb::call_guard<nb::gil_scoped_release>(),
        "Pairs that an image cannot do without: contributing, and lanes of 4x4 blocks that hold some pixel of a "
        "support before the block is full. Rows of `splats`, nearest first: x, y, a, b, c, opacity, half-extents.");
}

}  // namespace splat
