// View-dependent colour on the steps of each Gaussian's class at one SIMD level; no standard library here (see level.cpp).
#include "simd.hpp"
#include "stored.hpp"

namespace {

// Rows of the change to opponent channels: (1, 1, 1) / sqrt 3, (1, 0, -1) / sqrt 2, (1, -2, 1) / sqrt 6.
constexpr float BRIGHT = 0.57735026918962576f, RED_BLUE = 0.70710678118654752f, GREEN = 0.40824829046386302f;

// To the nearest integer, halves to even: the sum has no room for a fraction. Codes beyond 2^22 have none either.
INLINE vf nearest(vf x) {
  constexpr float FULL = 12582912.0f, MOST = 4194304.0f;
  const vf rounded = (x + all(FULL)) - all(FULL);
  return select(absolute(x) < all(MOST), rounded, x);
}

// The same of one double, as an integer; what is no number or beyond 2^30 is -2^30 or 2^30.
INLINE int64_t code(float value, double step) {
  constexpr double FULL = 6755399441055744.0, MOST = 1073741824.0;
  const double x = (double)value / step;
  const double held = x > -MOST ? (x < MOST ? x : MOST) : -MOST;
  return (int64_t)((held + FULL) - FULL);
}

INLINE void order(int64_t& a, int64_t& b) {
  const int64_t low = a < b ? a : b;
  b = a < b ? b : a;
  a = low;
}

// Step of a Gaussian's harmonics, by the class that codes of its opacity and scales say (quantisers.classes).
INLINE float step_of(const StoredArrays& a, int64_t i) {
  const int64_t opacity = code(a.logits[i], a.opacity);
  int64_t s0 = code(a.log_scales[3 * i], a.log_scale), s1 = code(a.log_scales[3 * i + 1], a.log_scale);
  int64_t s2 = code(a.log_scales[3 * i + 2], a.log_scale);
  order(s0, s1);
  order(s1, s2);
  order(s0, s1);
  const uint64_t facts[STEP_WEIGHTS] = {1, (uint64_t)opacity, (uint64_t)opacity * (uint64_t)opacity,
                                        (uint64_t)s0, (uint64_t)s1, (uint64_t)s2};
  uint64_t total = (uint64_t)1 << (STEP_FRACTION - 1);
  for (int k = 0; k < STEP_WEIGHTS; ++k) total += (uint64_t)a.weights[k] * facts[k];
  int64_t shift = (int64_t)total >> STEP_FRACTION;
  shift = shift < -WIDEST_STEP ? -WIDEST_STEP : shift > WIDEST_STEP ? WIDEST_STEP : shift;
  double factor = 1.0;
  for (; shift > 0; --shift) factor *= 2.0;
  for (; shift < 0; ++shift) factor *= 0.5;
  return (float)(a.harmonics * factor);
}

void store_rows(const StoredArrays& a, int64_t first, int64_t last) {
  alignas(64) float planes[3][LANES] = {};
  for (int64_t i = first; i < last; ++i) {
    const vf step = all(step_of(a, i));
    for (int64_t k = 0; k < a.coefficients; k += LANES) {
      const int64_t place = 3 * (i * a.coefficients + k);
      const int64_t count = a.coefficients - k < LANES ? a.coefficients - k : LANES;
      for (int64_t c = 0; c < count; ++c)
        for (int colour = 0; colour < 3; ++colour) planes[colour][c] = a.rest[place + 3 * c + colour];
      const vf r = load(planes[0]), g = load(planes[1]), b = load(planes[2]);
      const vf y = nearest((r + g + b) * all(BRIGHT) / step) * step * all(BRIGHT);
      const vf u = nearest((r - b) * all(RED_BLUE) / step) * step * all(RED_BLUE);
      const vf v = nearest((r - (g + g) + b) * all(GREEN) / step) * step * all(GREEN);
      store(planes[0], y + u + v);
      store(planes[1], y - (v + v));
      store(planes[2], y - u + v);
      for (int64_t c = 0; c < count; ++c)
        for (int colour = 0; colour < 3; ++colour) a.stored[place + 3 * c + colour] = planes[colour][c];
    }
  }
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::StoredKernels JOIN(splat_stored_, SPLAT_LEVEL);
const splat::StoredKernels JOIN(splat_stored_, SPLAT_LEVEL) = {store_rows};
