#include "render.hpp"

#include <algorithm>
#include <atomic>
#include <stdexcept>
#include <vector>

#include "pool.hpp"
#include "scratch.hpp"
#include "stages.hpp"

namespace splat {
namespace {

std::atomic<size_t> most_rows{(size_t)1 << 22};  // 256 MB at 3 channels
std::atomic<uint64_t> listed{0};

// First tiles of runs of tiles that hold at most `most` pairs each (or are a single tile), and the end.
std::vector<int> bands_of(const Bins& bins, int tiles, size_t most) {
  std::vector<int> bands = {0};
  for (int t = 0; t < tiles; ++t)
    if (t > bands.back() && bins.start[t + 1] - bins.start[bands.back()] > most) bands.push_back(t);
  bands.push_back(tiles);
  return bands;
}

}  // namespace

uint64_t pairs_listed() { return listed; }

void set_backward_rows(size_t count) { most_rows = std::max<size_t>(count, 1); }

Tiles State::view() {
  State& l = laid();
  return {l.geo.data(), features.size() ? features.data() : nullptr, stride, channels == 3 && !drawn_before,
          l.bins.entries.data(), l.bins.start.data(), l.processed.data(), l.blocks.size() ? l.blocks.data() : nullptr,
          l.trace.size() ? l.trace.data() : nullptr, stop, reach, across(), camera.width, camera.height};
}

Projection State::projection(float* radii) {
  return {laid().geo.data(), features.size() ? features.data() : nullptr, stride, radii, laid().drawn.data()};
}

size_t State::bytes() const {
  return geo.bytes() + features.bytes() + drawn.bytes() + processed.bytes() + blocks.bytes() + trace.bytes() +
         bins.entries.bytes() + bins.start.bytes() + bins.row_start.bytes();
}

void lay_out(const Model& model, const Pictures& pictures, float* radii, int threads, State& state) {
  StageClock clock;
  state.count = model.count;
  state.channels = model.channels;
  state.stop = model.stop;
  state.reach = model.reach;
  state.stride = (model.channels + 2 + 3) / 4 * 4;
  const size_t n = (size_t)model.count;
  const Camera& camera = state.camera;
  state.geo.resize(n * GEO);
  state.features.resize(in_geo(state.channels, features_of(pictures)) ? 0 : n * state.stride);
  state.drawn.resize(n);
  state.processed.resize(state.tiles());
  const Kernels& k = kernels();
  const Projection projection = state.projection(radii);
  over_gaussians(threads, model.count,
                 [&](int64_t first, int64_t last) { k.project(camera, model, projection, first, last); });
  clock.lap(STAGE_PROJECT);
  bin(k, camera, state.geo.data(), state.drawn.data(), model.reach, model.count, threads, state.bins);
  listed += state.bins.entries.size();
  clock.lap(STAGE_BIN);
}

void forward(const Model& model, Pictures pictures, float* radii, int threads, State& state) {
  lay_out(model, pictures, radii, threads, state);
  StageClock clock;
  const Kernels& k = kernels();
  const Camera& camera = state.camera;
  const size_t pixels = (size_t)camera.width * camera.height;
  for (size_t i = 0; i < pixels * pictures.contributors; ++i) {
    pictures.ids[i] = -1;
    pictures.weights[i] = 0;
  }
  state.blocks.resize(state.bins.entries.size());
  state.trace.resize((size_t)state.tiles() * BLOCKS * TRACE * LANES);
  const Scratches scratch(threads, CHUNK, features_of(pictures));
  const Tiles tiles = state.view();
  parallel(threads, state.tiles(),
           [&](int tile, int worker) { k.render_tile(tiles, pictures, scratch[worker], tile); });
  clock.lap(STAGE_BLEND);
}

void forward_again(const Model& model, Pictures pictures, State& before, int threads, State& state) {
  state.drawn_before = &before.laid();
  state.camera = before.camera;
  state.count = model.count;
  state.channels = model.channels;
  state.stop = before.stop;
  state.reach = before.reach;
  state.stride = (model.channels + 3) / 4 * 4;
  state.features.resize((size_t)model.count * state.stride);
  over_gaussians(threads, model.count, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      float* to = state.features.data() + i * state.stride;
      std::copy(model.colours + i * model.channels, model.colours + (i + 1) * model.channels, to);
      std::fill(to + model.channels, to + state.stride, 0.0f);
    }
  });
  const Scratches scratch(threads, CHUNK, features_of(pictures));
  const Tiles tiles = state.view();
  parallel(threads, state.tiles(),
           [&](int tile, int worker) { kernels().render_tile_again(tiles, pictures, scratch[worker], tile); });
}

void backward(const Model& model, PictureGradients pictures, const ModelGradients& out, int threads, State& state) {
  StageClock clock;
  const Kernels& k = kernels();
  pictures.moduli = out.screen_absolute != nullptr;
  pictures.fragments = out.fragments != nullptr;
  pictures.shapes = needs_shapes(out) || pictures.fragments;
  const int features = model.channels + (pictures.distance ? 2 : pictures.depth || pictures.median ? 1 : 0);
  if (pictures.fragments && (pictures.moduli || features != 3))
    throw std::invalid_argument("fragments are told of three colours, without absolute gradients and depth");
  if (model.count > 0 && !state.features.size() && !in_geo(model.channels, features))
    throw std::invalid_argument("gradients by the distance, of a picture without it");
  const int stride = sum_stride(features);
  const Tiles tiles = state.view();
  const int count = state.tiles();
  uint32_t longest = 0;
  for (int t = 0; t < count; ++t) longest = std::max(longest, tiles.processed[t]);
  const Scratches scratch(threads, longest, features);
  const Projection projection = state.projection(nullptr);
  const auto finish = [&](const float* sums, const uint32_t* row_start) {
    clock.lap(STAGE_BLEND_BACKWARD);
    over_gaussians(threads, model.count, [&](int64_t first, int64_t last) {
      k.backward_project(state.camera, model, projection, sums, stride, row_start, out, first, last);
    });
    clock.lap(STAGE_PROJECT_BACKWARD);
  };
  const Bins& bins = state.laid().bins;
  const std::vector<int> bands = bands_of(bins, count, most_rows);
  size_t rows = 0;
  for (size_t b = 0; b + 1 < bands.size(); ++b)
    rows = std::max<size_t>(rows, bins.start[bands[b + 1]] - bins.start[bands[b]]);
  Buffer<float> sums(rows * stride);
  const auto draw = [&](const Tiles& tiles, int from, int to) {
    const SumRows into = {sums.data(), bands.size() <= 2 ? 0 : tiles.start[from], stride};
    parallel(threads, to - from, [&](int i, int worker) {
      k.backward_tile(tiles, pictures, scratch[worker], features, from + i, into);
    });
  };
  if (bands.size() <= 2) {
    draw(tiles, 0, count);
    finish(sums.data(), bins.row_start.data());
    return;
  }
  // A band's rows lie tile after tile. Each Gaussian adds up its own in the order of the tiles, as it would with all of
  // them at hand, into one.
  const size_t n = (size_t)model.count, pairs = bins.entries.size();
  Buffer<Entry> entries(pairs);
  Buffer<uint32_t> places(pairs), next(n), total_start(n + 1);
  parallel(threads, count, [&](int tile, int) {
    for (uint32_t e = bins.start[tile]; e < bins.start[tile + 1]; ++e) {
      entries[e] = {bins.entries[e].gaussian, e};
      places[bins.entries[e].row] = e;
    }
  });
  total_start[0] = 0;
  for (size_t i = 0; i < n; ++i) total_start[i + 1] = total_start[i] + (bins.row_start[i] < bins.row_start[i + 1]);
  Buffer<float> total((size_t)total_start[n] * stride);
  std::fill(total.data(), total.data() + total.size(), 0.0f);
  std::copy(bins.row_start.data(), bins.row_start.data() + n, next.data());
  Tiles in_bands = tiles;
  in_bands.entries = entries.data();
  for (size_t b = 0; b + 1 < bands.size(); ++b) {
    draw(in_bands, bands[b], bands[b + 1]);
    const uint32_t begin = bins.start[bands[b]], end = bins.start[bands[b + 1]];
    over_gaussians(threads, model.count, [&](int64_t first, int64_t last) {
      for (int64_t i = first; i < last; ++i) {
        float* to = total.data() + (size_t)total_start[i] * stride;
        for (uint32_t& row = next[i]; row < bins.row_start[i + 1] && places[row] < end; ++row) {
          const float* from = sums.data() + (size_t)(places[row] - begin) * stride;
          for (int j = 0; j < stride; ++j) to[j] += from[j];
        }
      }
    });
  }
  finish(total.data(), total_start.data());
}

}  // namespace splat
