// The photometric training loss.
#pragma once
#include <cstdint>

namespace splat {

// (1 - dssim) mean |image - truth| + dssim (1 - mean SSIM) over the pixels where mask is set (null: all), and its
// gradient by the image where `gradient` is not null. Images are [height, width, channels].
double photometric(const float* image, const float* truth, const uint8_t* mask, int height, int width, int channels,
                   double dssim, float* gradient, int threads);

}  // namespace splat
