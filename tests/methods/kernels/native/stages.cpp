// All stages of a training step on a seeded scene, without Python: `stages FILE` writes, for each SIMD level of the
// machine, its name on a line of standard output, and its loss, gradients and updated means to FILE as floats.
// Ends with 1 where two threads give other bits than one.
#include <cmath>
#include <cstdio>
#include <cstring>
#include <vector>

#include "adam.hpp"
#include "levels.hpp"
#include "step.hpp"

using namespace splat;

namespace {

constexpr int64_t COUNT = 400;
constexpr int WIDTH = 75, HEIGHT = 50, COEFFICIENTS = 16;

struct Random {  // xorshift: the same numbers with any compiler and C library
  uint64_t state = 88172645463325252ull;
  float operator()(float low, float high) {
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return low + (high - low) * (float)(state >> 40) / 16777216.0f;
  }
};

using Floats = std::vector<float>;

Floats step_of(int threads) {
  Random draw;
  const auto drawn = [&](int64_t count, float low, float high) {
    Floats values((size_t)count);
    for (float& v : values) v = draw(low, high);
    return values;
  };
  Floats means(3 * COUNT), photo = drawn(3 * WIDTH * HEIGHT, 0, 1);
  for (int64_t i = 0; i < COUNT; ++i) {
    const float z = draw(2, 6);
    means[3 * i] = draw(-0.6f, 0.6f) * z;
    means[3 * i + 1] = draw(-0.5f, 0.5f) * z;
    means[3 * i + 2] = z;
  }
  const Floats quaternions = drawn(4 * COUNT, -1, 1), scales = drawn(3 * COUNT, -4, -1.5f);
  const Floats opacities = drawn(COUNT, -2, 6), sh = drawn(3 * COEFFICIENTS * COUNT, -0.3f, 0.3f);
  const float background[] = {0.2f, 0.5f, 0.7f};
  Model model = {};
  model.means = means.data();
  model.quaternions = quaternions.data();
  model.scales = scales.data();
  model.opacities = opacities.data();
  model.sh = sh.data();
  model.count = COUNT;
  model.channels = 3;
  model.sh_used = model.sh_stored = COEFFICIENTS;
  model.raw = true;
  Camera camera = {};
  for (int i = 0; i < 3; ++i) camera.rotation[4 * i] = 1;
  const double k[] = {70, 0, WIDTH / 2.0, 0, 70, HEIGHT / 2.0};
  std::memcpy(camera.k, k, sizeof k);
  camera.low_x = camera.low_y = -1.5;
  camera.high_x = camera.high_y = 1.5;
  camera.near = 0.01;
  camera.width = WIDTH;
  camera.height = HEIGHT;

  const int64_t sizes[] = {3, 4, 3, 1, 3 * COEFFICIENTS, 2, 2, 1};  // of a row of each output
  Floats out[8];
  for (int i = 0; i < 8; ++i) out[i].resize((size_t)(sizes[i] * COUNT));
  ModelGradients by = {};
  by.means = out[0].data();
  by.quaternions = out[1].data();
  by.scales = out[2].data();
  by.opacities = out[3].data();
  by.sh = out[4].data();
  by.screen = out[5].data();
  by.screen_absolute = out[6].data();
  const Photo target = {photo.data(), nullptr, 0.2};
  Floats all = {(float)photometric_step(model, camera, background, target, by, out[7].data(), threads)};
  for (const Floats& values : out) all.insert(all.end(), values.begin(), values.end());
  Floats first(means.size()), second(means.size());
  adam_step({{{means.data(), first.data(), second.data(), out[0].data()}, COUNT, 3, 1e-2}}, 1, 0.9, 0.999, 1e-15, nullptr,
            threads);
  all.insert(all.end(), means.begin(), means.end());
  return all;
}

}  // namespace

int main(int, char** arguments) {
  std::FILE* file = std::fopen(arguments[1], "wb");
  if (!file) return 2;
  for (const std::string& level : simd_levels()) {
    set_simd_level(level);
    const Floats one = step_of(1), two = step_of(2);
    if (std::memcmp(one.data(), two.data(), one.size() * sizeof(float))) return 1;
    std::printf("%s\n", level.c_str());
    if (std::fwrite(one.data(), sizeof(float), one.size(), file) != one.size()) return 2;
  }
  return std::fclose(file) ? 2 : 0;
}
