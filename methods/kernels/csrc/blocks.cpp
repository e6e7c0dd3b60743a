// Pictures of parts of a model, each alone, from one projection and one sort.
#include <stdexcept>
#include <vector>

#include "pool.hpp"
#include "render.hpp"
#include "scratch.hpp"

namespace splat {

void forward_blocks(const Model& model, const Camera& camera, const int64_t* block, int count, Pictures first,
                    int threads) {
  State state;
  state.camera = camera;
  Buffer<float> radii((size_t)model.count);
  lay_out(model, first, radii.data(), threads, state);
  const Kernels& k = kernels();
  const int tiles = state.tiles();
  const size_t parts = (size_t)count * tiles;
  if (parts >> 31) throw std::length_error("more than 2^31 tiles of blocks; render fewer blocks at once");

  // The lists of all tiles again, block after block: a part of a sorted list is sorted.
  const Bins& bins = state.bins;
  Buffer<uint32_t> start(parts + 1), processed(parts);
  Buffer<Entry> entries(bins.entries.size());
  std::fill(start.data(), start.data() + parts + 1, 0u);
  parallel(threads, tiles, [&](int tile, int) {
    for (uint32_t e = bins.start[tile]; e < bins.start[tile + 1]; ++e)
      ++start[(size_t)block[bins.entries[e].gaussian] * tiles + tile + 1];
  });
  for (size_t p = 0; p < parts; ++p) start[p + 1] += start[p];
  parallel(threads, tiles, [&](int tile, int) {
    std::vector<uint32_t> next(count);
    for (int b = 0; b < count; ++b) next[b] = start[(size_t)b * tiles + tile];
    for (uint32_t e = bins.start[tile]; e < bins.start[tile + 1]; ++e)
      entries[next[block[bins.entries[e].gaussian]]++] = bins.entries[e];
  });

  const size_t pixels = (size_t)camera.width * camera.height;
  const Scratches scratch(threads, CHUNK, features_of(first));
  parallel(threads, (int)parts, [&](int i, int worker) {
    const int b = i / tiles;
    Tiles view = state.view();
    view.entries = entries.data();
    view.start = start.data() + (size_t)b * tiles;
    view.processed = processed.data() + (size_t)b * tiles;
    Pictures pictures = first;
    pictures.colour += b * pixels * first.channels;
    pictures.alpha += b * pixels;
    pictures.depth += b * pixels;
    k.render_tile(view, pictures, scratch[worker], i % tiles);
  });
}

}  // namespace splat
