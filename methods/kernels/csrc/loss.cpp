#include "loss.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "buffer.hpp"
#include "pool.hpp"
#include "render.hpp"

namespace splat {

double photometric(const float* image, const float* truth, const uint8_t* mask, int height, int width, int channels,
                   double dssim, float* gradient, int threads) {
  double taps[6], total = 0;
  for (int k = 0; k <= 5; ++k) {
    taps[k] = std::exp(-k * k / (2 * 1.5 * 1.5));
    total += k ? 2 * taps[k] : taps[k];
  }
  Loss loss = {};
  for (int k = 0; k <= 5; ++k) loss.taps[k] = (float)(taps[k] / total);
  const int64_t pixels = (int64_t)height * width;
  const int64_t valid = mask ? std::count_if(mask, mask + pixels, [](uint8_t m) { return m != 0; }) : pixels;
  const double count = (double)(std::max<int64_t>(valid, 1) * channels);
  loss.image = image;
  loss.truth = truth;
  loss.mask = mask;
  loss.width = width;
  loss.height = height;
  loss.channels = channels;
  loss.l1_weight = (float)((1 - dssim) / count);
  loss.ssim_weight = (float)(dssim / count);
  const int margin = (5 * channels + LANES - 1) / LANES * LANES;
  loss.row_floats = (width * channels + LANES - 1) / LANES * LANES + 2 * margin;

  const int bands = std::min(height, threads * 2);
  const size_t each = (size_t)(6 + 11 * 5) * loss.row_floats;
  Buffer<float> scratch(each * threads), maps((size_t)height * 3 * loss.row_floats);
  Buffer<double> sums((size_t)2 * height);
  // margins are zero; the kernels only write between them
  std::memset(scratch.data(), 0, scratch.size() * sizeof(float));
  std::memset(maps.data(), 0, maps.size() * sizeof(float));
  loss.maps = maps.data();
  loss.sums = sums.data();
  loss.gradient = gradient;
  const auto over_bands = [&](auto kernel) {
    parallel(threads, bands, [&](int band, int worker) {
      kernel(loss, scratch.data() + each * worker, height * band / bands, height * (band + 1) / bands);
    });
  };
  over_bands(kernels().loss_maps);
  if (gradient) {
    std::memset(scratch.data(), 0, scratch.size() * sizeof(float));
    over_bands(kernels().loss_gradient);
  }
  double difference = 0, similar = 0;
  for (int y = 0; y < height; ++y) {
    difference += sums[2 * y];
    similar += sums[2 * y + 1];
  }
  return ((1 - dssim) * difference + dssim * ((double)(valid * channels) - similar)) / count;
}

}  // namespace splat
