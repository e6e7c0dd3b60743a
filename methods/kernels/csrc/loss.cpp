#include "loss.hpp"

#include <algorithm>
#include <cmath>

#include "buffer.hpp"
#include "pool.hpp"
#include "render.hpp"

namespace splat {

namespace {

// (sum of |a - b|) over what counts, and its gradient: all of the loss where structure has no weight.
double absolute_differences(const Loss& loss, int threads) {
  Buffer<double> sums((size_t)loss.height);
  parallel(threads, loss.height, [&](int y, int) {
    double sum = 0;
    for (size_t pixel = (size_t)y * loss.width; pixel < (size_t)(y + 1) * loss.width; ++pixel) {
      const bool counts = !loss.mask || loss.mask[pixel];
      for (size_t i = pixel * loss.channels; i < (pixel + 1) * loss.channels; ++i) {
        const float difference = counts ? loss.image[i] - loss.truth[i] : 0;
        sum += std::abs(difference);
        if (loss.gradient) loss.gradient[i] = loss.l1_weight * (float)((difference > 0) - (difference < 0));
      }
    }
    sums[y] = sum;
  });
  double total = 0;
  for (int y = 0; y < loss.height; ++y) total += sums[y];
  return total;
}

}  // namespace

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
  loss.gradient = gradient;
  if (dssim == 0) return absolute_differences(loss, threads) / count;
  loss.margin = loss_margin(channels);

  // a band repeats the work on 20 rows of its neighbours
  const int bands = std::min(std::max(1, height / 20), threads);
  const size_t each = loss_scratch(loss.margin);
  Buffer<float> scratch(each * threads);
  Buffer<double> sums((size_t)2 * height);
  loss.sums = sums.data();
  const Kernels& k = kernels();
  parallel(threads, bands, [&](int band, int worker) {
    k.loss_rows(loss, scratch.data() + each * worker, (int)((int64_t)height * band / bands),
                (int)((int64_t)height * (band + 1) / bands));
  });
  double difference = 0, similar = 0;
  for (int y = 0; y < height; ++y) {
    difference += sums[2 * y];
    similar += sums[2 * y + 1];
  }
  return ((1 - dssim) * difference + dssim * ((double)(valid * channels) - similar)) / count;
}

}  // namespace splat
