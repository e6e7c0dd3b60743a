// Layers of a memory drawn into a view, the nearest in front, for Python. Doubles, for scenes may lie far from their
// origin.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "pool.hpp"

namespace splat {
namespace {

constexpr int64_t PIECE = 1024;  // layers that a thread draws in a row
// Squares of a column in the image at most: only one that begins right at the view's near plane has more, and many of
// them in a pixel.
constexpr double MOST_SQUARES = 1 << 20;
constexpr double NONE = std::numeric_limits<double>::infinity();

void check_finite(const Camera& c, const char* what) {
  const auto finite = [](double x) { return std::isfinite(x); };
  if (!std::all_of(c.k, c.k + 6, finite) || !std::all_of(c.rotation, c.rotation + 9, finite) ||
      !std::all_of(c.translation, c.translation + 3, finite) || !std::isfinite(c.near))
    throw std::invalid_argument(std::string(what) + " has a number that is not finite");
}

// The layers that a reference camera sees; held while they are drawn.
struct LayerArrays {
  In<int64_t, 1> pixels;
  In<double, 1> depths;
  In<double, 2> positions;
  Camera camera;
  double reach;  // how many times as deep as it begins a column may end

  int64_t count() const { return (int64_t)pixels.shape(0); }
  int64_t pixel(int64_t i) const { return pixels.data()[i]; }
  double depth(int64_t i) const { return depths.data()[i]; }
  bool before(int64_t i, std::pair<int64_t, double> place) const {
    return pixel(i) < place.first || (pixel(i) == place.first && depth(i) < place.second);
  }

  // Throws std::invalid_argument where they are none, or not sorted by pixel, then depth.
  void check_all() const {
    const size_t n = pixels.shape(0);
    check(depths.shape(0) == n, "depths");
    check(positions.shape(0) == n && positions.shape(1) == 3, "positions");
    check_finite(camera, "the reference camera");
    const int64_t most = (int64_t)camera.width * camera.height;
    for (int64_t i = 0; i < (int64_t)n; ++i) {
      const double *at = positions.data() + 3 * i, d = depth(i);
      const bool sorted = i == 0 || !before(i, {pixel(i - 1), depth(i - 1)});
      const bool finite = std::isfinite(d) && std::isfinite(at[0]) && std::isfinite(at[1]) && std::isfinite(at[2]);
      if (!finite || !(d > 0) || pixel(i) < 0 || pixel(i) >= most || !sorted)
        throw std::invalid_argument(
            "layer " + std::to_string(i) + " is at pixel " + std::to_string(pixel(i)) + ", depth " + std::to_string(d) +
            ", position " + std::to_string(at[0]) + " " + std::to_string(at[1]) + " " + std::to_string(at[2]) +
            "; expected finite numbers, depths above 0, pixels below " + std::to_string(most) +
            ", all sorted by pixel, then depth");
    }
  }
};

// Where the columns of layers end, one layer after the other: in each pixel around it a finger points at the first
// layer that is as deep or deeper, and moves on with the layers, for both are sorted alike.
class Ends {
 public:
  Ends(const LayerArrays& layers, int64_t first) : layers_(layers) {
    for (int i = 0; i < 8; ++i) {
      const std::pair<int64_t, double> place = {layers.pixel(first) + offset(i), layers.depth(first)};
      int64_t low = 0, high = layers.count();
      while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (layers.before(middle, place)) low = middle + 1;
        else high = middle;
      }
      fingers_[i] = low;
    }
  }

  // Of layer i, at least as far on as the last one that was asked for.
  double of(int64_t i) {
    const int64_t width = layers_.camera.width, pixel = layers_.pixel(i), row = pixel / width, column = pixel % width;
    const double depth = layers_.depth(i), reach = depth * layers_.reach;
    double end = depth;
    const auto take = [&](double other) { end = other <= reach ? std::max(end, other) : end; };
    if (i + 1 < layers_.count() && layers_.pixel(i + 1) == pixel) take(layers_.depth(i + 1));
    for (int k = 0; k < 8; ++k) {
      const int64_t y = row + AROUND[k][0], x = column + AROUND[k][1];
      const double other = nearest(fingers_[k], pixel + offset(k), depth);
      if (y >= 0 && y < layers_.camera.height && x >= 0 && x < width) take(other);
    }
    return end;
  }

 private:
  static constexpr int AROUND[8][2] = {{-1, -1}, {-1, 0}, {-1, 1}, {0, -1}, {0, 1}, {1, -1}, {1, 0}, {1, 1}};
  int64_t offset(int k) const { return AROUND[k][0] * (int64_t)layers_.camera.width + AROUND[k][1]; }

  // Depth of that pixel's layer which is nearest in depth, of two the nearer one; NONE without a layer.
  double nearest(int64_t& finger, int64_t pixel, double depth) {
    while (finger < layers_.count() && layers_.before(finger, {pixel, depth})) ++finger;
    double best = NONE;
    for (int64_t i = std::max<int64_t>(finger - 1, 0); i <= finger && i < layers_.count(); ++i) {
      const double other = layers_.pixel(i) == pixel ? layers_.depth(i) : NONE;
      if (std::abs(other - depth) < std::abs(best - depth)) best = other;
    }
    return best;
  }

  const LayerArrays& layers_;
  int64_t fingers_[8];
};

class Canvas {
 public:
  Canvas(const LayerArrays& layers, const Camera& view)
      : layers_(layers), view_(view), nearest_((size_t)view.width * view.height) {
    for (auto& z : nearest_) z.store(NONE, std::memory_order_relaxed);
    turn(layers.camera.centre, view.translation, base_);
  }

  // Squares along the column of a layer from its own depth to its end, so close that they touch.
  void column(int64_t i, double end) {
    const double *position = layers_.positions.data() + 3 * i, *eye = layers_.camera.centre;
    const double ray[3] = {position[0] - eye[0], position[1] - eye[1], position[2] - eye[2]}, zero[3] = {0, 0, 0};
    double along[3];
    turn(ray, zero, along);
    const double depth = layers_.depth(i);
    const Point first = seen(along, 1), last = seen(along, end / depth);
    const double widths[2] = {footprint(depth, first.z), footprint(end, last.z)};
    const double steps = end > depth ? steps_between(first, last, std::min(widths[0], widths[1])) : 0;
    if (steps == 0) return square(first, depth);
    double low = 0, high = steps;
    if (!cut(first, 1.5 + widths[0] / 2, last, 1.5 + widths[1] / 2, low, high)) return;
    const double stride = std::max(1.0, (high - low) / MOST_SQUARES);
    for (double k = low; k <= high; k += stride) {
      const double here = depth + k / steps * (end - depth);
      square(seen(along, here / depth), here);
    }
  }

  void copy(double* to) const {
    for (size_t i = 0; i < nearest_.size(); ++i) to[i] = nearest_[i].load(std::memory_order_relaxed);
  }

 private:
  struct Point {
    double x, y, z;  // x and y in pixels times z, the depth in the view
  };

  void turn(const double* vector, const double* shift, double* to) const {
    for (int r = 0; r < 3; ++r) {
      const double* row = view_.rotation + 3 * r;
      to[r] = row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2] + shift[r];
    }
  }

  // The point of a layer's ray that is `share` times as far from the reference camera as the layer.
  Point seen(const double* along, double share) const {
    const double *k = view_.k, x = base_[0] + share * along[0], y = base_[1] + share * along[1],
                 z = base_[2] + share * along[2];
    return {k[0] * x + k[1] * y + k[2] * z, k[3] * x + k[4] * y + k[5] * z, z};
  }

  // Width in the view of the reference's pixel at that depth of the reference.
  double footprint(double depth, double z) const { return depth / layers_.camera.k[0] * view_.k[0] / z; }

  // Into how many parts a column is divided; 0 where it is not all in front of the view.
  double steps_between(const Point& a, const Point& b, double width) const {
    const double near = std::min(a.z, b.z), far = std::max(a.z, b.z);
    if (!(near > std::max(view_.near, 0.0))) return 0;
    const double length = std::max(std::abs(b.x / b.z - a.x / a.z), std::abs(b.y / b.z - a.y / a.z));
    // far / near: in perspective the near end of an evenly divided column has the widest steps
    const double steps = std::ceil(length / std::max(width, 1.0) * far / near);
    return std::isfinite(steps) ? steps : 0;
  }

  // Leaves of the steps from a to b, numbered from `low` to `high`, those whose squares may touch the image, or false:
  // columns beside the view's eye go on for millions of pixels. The margins are half of the squares, and more; times z
  // they grow evenly along a column, as all does that is compared.
  bool cut(const Point& a, double margin_a, const Point& b, double margin_b, double& low, double& high) const {
    const double all = high, w = view_.width, h = view_.height;
    const double sides[4][2] = {{margin_a * a.z + a.x, margin_b * b.z + b.x},
                                {(w + margin_a) * a.z - a.x, (w + margin_b) * b.z - b.x},
                                {margin_a * a.z + a.y, margin_b * b.z + b.y},
                                {(h + margin_a) * a.z - a.y, (h + margin_b) * b.z - b.y}};
    for (const auto& [first, last] : sides) {  // negative beyond that border
      if (first < 0 && last < 0) return false;
      const double crossed = all * (first / (first - last));
      if (first < 0) low = std::max(low, std::floor(crossed) - 1);
      if (last < 0) high = std::min(high, std::ceil(crossed) + 1);
    }
    return low <= high;
  }

  void square(const Point& p, double depth) {
    if (!(p.z > view_.near)) return;
    const double half = std::max(0.5, footprint(depth, p.z) / 2), x = p.x / p.z, y = p.y / p.z;
    const double left = std::ceil(x - half - 0.5), right = std::floor(x + half - 0.5);  // pixel centres in it
    const double top = std::ceil(y - half - 0.5), bottom = std::floor(y + half - 0.5);
    if (!(left < view_.width && right >= 0 && top < view_.height && bottom >= 0)) return;  // nor where one is NaN
    const int64_t first = (int64_t)std::max(left, 0.0), last = (int64_t)std::min(right, view_.width - 1.0);
    const int64_t lowest = (int64_t)std::min(bottom, view_.height - 1.0);
    for (int64_t row = (int64_t)std::max(top, 0.0); row <= lowest; ++row)
      for (int64_t column = first; column <= last; ++column)
        draw(nearest_[(size_t)(row * view_.width + column)], p.z);
  }

  // The nearest depth is the same whoever comes first.
  static void draw(std::atomic<double>& pixel, double z) {
    double there = pixel.load(std::memory_order_relaxed);
    while (z < there && !pixel.compare_exchange_weak(there, z, std::memory_order_relaxed)) {
    }
  }

  const LayerArrays& layers_;
  const Camera& view_;
  double base_[3];  // the reference camera's centre, seen from the view
  std::vector<std::atomic<double>> nearest_;
};

void draw_layers(const LayerArrays& layers, In<double, 2> k, In<double, 2> pose, int width, int height, double near,
                 Out<double, 2> depth) {
  const Camera view = make_camera(k, pose, width, height, near);
  check_finite(view, "the view's camera");
  check_image(depth, view, "depth");
  double* to = depth.data();
  nb::gil_scoped_release release;
  Canvas canvas(layers, view);
  const int64_t count = layers.count();
  parallel(threads(), (int)((count + PIECE - 1) / PIECE), [&](int piece, int) {
    Ends ends(layers, piece * PIECE);
    for (int64_t i = piece * PIECE; i < std::min(count, (piece + 1) * PIECE); ++i) canvas.column(i, ends.of(i));
  });
  canvas.copy(to);
}

}  // namespace

void bind_guide_depth(nb::module_& m) {
  nb::class_<LayerArrays>(m, "Layers", "Layers of a memory, and the camera that they are layers of.")
      .def("__init__",
           [](LayerArrays* self, In<int64_t, 1> pixels, In<double, 1> depths, In<double, 2> positions, In<double, 2> k,
              In<double, 2> world_to_camera, int width, int height, double reach) {
             const Camera camera = make_camera(k, world_to_camera, width, height, 0);
             new (self) LayerArrays{pixels, depths, positions, camera, reach};
             self->check_all();
           },
           array("pixels"), array("depths"), array("positions"), array("K"), array("world_to_camera"), nb::arg("width"),
           nb::arg("height"), nb::arg("reach"));
  m.def("draw_layers", &draw_layers, nb::arg("layers"), array("K"), array("world_to_camera"), nb::arg("width"),
        nb::arg("height"), nb::arg("near"), array("depth"),
        "Depth of what is nearest in each pixel of a view into the given array; infinite where nothing is.");
}

}  // namespace splat
