#include "render.hpp"

#include <algorithm>
#include <vector>

#include "pool.hpp"
#include "stages.hpp"

namespace splat {
namespace {

// Scratch of all threads for at most `rows` Gaussians of a tile at once.
class Scratches {
 public:
  Scratches(int threads, size_t rows, int features) {
    rows = (rows + LANES - 1) / LANES * LANES;
    const size_t recs = rows * rec_stride(features), rows16 = rows * LANES;
    const size_t state = (size_t)BLOCKS * (8 + features) * LANES, lists = (size_t)BLOCKS * (rows + LANES);
    const size_t each = recs + 2 * rows16 + state + lists;
    memory_.resize(each * threads);
    std::fill(memory_.data(), memory_.data() + each * threads, 0.0f);
    for (int t = 0; t < threads; ++t) {
      float* p = memory_.data() + each * t;
      Scratch s;
      s.recs = p;
      s.weights = p + recs;
      s.alphas = s.weights + rows16;
      s.state = s.alphas + rows16;
      s.lists = reinterpret_cast<uint32_t*>(s.state + state);
      each_.push_back(s);
    }
  }
  const Scratch& operator[](int thread) const { return each_[thread]; }

 private:
  Buffer<float> memory_;
  std::vector<Scratch> each_;
};

}  // namespace

Tiles State::view() {
  return {geo.data(), features.data(), stride, bins.entries.data(), bins.start.data(),
          processed.data(), across(), camera.width, camera.height};
}

Projection State::projection(float* radii) { return {geo.data(), features.data(), stride, radii, drawn.data()}; }

size_t State::bytes() const {
  return geo.bytes() + features.bytes() + drawn.bytes() + processed.bytes() + bins.entries.bytes() +
         bins.start.bytes() + bins.slot_start.bytes() + bins.slots.bytes();
}

void forward(const Model& model, Pictures pictures, float* radii, int threads, State& state) {
  StageClock clock;
  state.count = model.count;
  state.channels = model.channels;
  state.stride = (model.channels + 2 + 3) / 4 * 4;
  const size_t n = (size_t)model.count;
  const Camera& camera = state.camera;
  state.geo.resize(n * GEO);
  state.features.resize(n * state.stride);
  state.drawn.resize(n);
  state.processed.resize(state.tiles());
  const Kernels& k = kernels();
  const Projection projection = state.projection(radii);
  over_gaussians(threads, model.count,
                 [&](int64_t first, int64_t last) { k.project(camera, model, projection, first, last); });
  clock.lap(STAGE_PROJECT);
  bin(k, camera, state.geo.data(), state.drawn.data(), model.count, threads, state.bins);
  clock.lap(STAGE_BIN);

  const size_t pixels = (size_t)camera.width * camera.height;
  for (size_t i = 0; i < pixels * pictures.contributors; ++i) {
    pictures.ids[i] = -1;
    pictures.weights[i] = 0;
  }
  const Scratches scratch(threads, CHUNK, features_of(pictures));
  const Tiles tiles = state.view();
  parallel(threads, state.tiles(),
           [&](int tile, int worker) { k.render_tile(tiles, pictures, scratch[worker], tile); });
  clock.lap(STAGE_BLEND);
}

void backward(const Model& model, PictureGradients pictures, const ModelGradients& out, int threads, State& state) {
  StageClock clock;
  const Kernels& k = kernels();
  const int features = model.channels + (pictures.distance ? 2 : pictures.depth || pictures.median ? 1 : 0);
  const int stride = sum_stride(features);
  const Tiles tiles = state.view();
  const int count = state.tiles();
  uint32_t longest = 0;
  for (int t = 0; t < count; ++t) longest = std::max(longest, tiles.processed[t]);
  const Scratches scratch(threads, longest, features);
  Buffer<float> sums(state.bins.entries.size() * stride);
  parallel(threads, count, [&](int tile, int worker) {
    k.backward_tile(tiles, pictures, scratch[worker], features, tile, sums.data() + (size_t)tiles.start[tile] * stride,
                    stride);
  });
  clock.lap(STAGE_BLEND_BACKWARD);
  const Projection projection = state.projection(nullptr);
  over_gaussians(threads, model.count, [&](int64_t first, int64_t last) {
    k.backward_project(state.camera, model, projection, sums.data(), stride, state.bins.slot_start.data(),
                       state.bins.slots.data(), out, first, last);
  });
  clock.lap(STAGE_PROJECT_BACKWARD);
}

}  // namespace splat
