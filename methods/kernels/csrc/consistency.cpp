#include "consistency.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "buffer.hpp"
#include "levels.hpp"
#include "pool.hpp"

SPLAT_TABLES(splat::SupportKernels, support)

namespace splat {
namespace {

constexpr int64_t MOST_PARTS = 32;   // partial sums of gradients over sites, whatever the number of threads
constexpr int64_t SMALLEST = 512;    // pairs of a piece of a cell
constexpr int64_t PIECES = 64;       // about as many pieces at most, beside one a cell

// The base covariance of a site: what orders its axes, and the quaternion of norm 1.
struct Shape {
  int order[3];  // axes, longest first
  float values[3], sum, q[4], inverse;

  Shape(const float* quaternion, const float* scales) {
    float square = 0, largest = 0;
    for (int c = 0; c < 4; ++c) largest = std::max(largest, std::abs(quaternion[c]));
    for (int c = 0; c < 4; ++c) {
      q[c] = largest > 0 ? quaternion[c] / largest : (c == 0 ? 1.0f : 0.0f);
      square += q[c] * q[c];
    }
    const float length = 1 / std::sqrt(square);
    for (float& part : q) part *= length;
    inverse = largest > 0 ? length / largest : 0;
    for (int i = 0; i < 3; ++i) order[i] = i;
    std::stable_sort(order, order + 3, [&](int i, int j) { return scales[i] > scales[j]; });
    sum = 0;
    for (int i = 0; i < 3; ++i) {
      values[i] = scales[order[i]] * scales[order[i]];
      sum += values[i];
    }
  }

  // The axis is column j of the rotation matrix; with (a, b, c) = (j, j + 1, j + 2) modulo 3 and imaginary parts v,
  // its components are 1 - 2 (v_b^2 + v_c^2), 2 (v_a v_b + w v_c) and 2 (v_a v_c - w v_b).
  void axis(float* out) const {
    const int a = order[0], b = (a + 1) % 3, c = (a + 2) % 3;
    const float w = q[0], *v = q + 1;
    out[a] = 1 - 2 * (v[b] * v[b] + v[c] * v[c]);
    out[b] = 2 * (v[a] * v[b] + w * v[c]);
    out[c] = 2 * (v[a] * v[c] - w * v[b]);
  }

  void pull_axis(const float* by, float* by_quaternion) const {
    const int a = order[0], b = (a + 1) % 3, c = (a + 2) % 3;
    const float w = q[0], *v = q + 1;
    float by_unit[4];
    by_unit[0] = 2 * (by[b] * v[c] - by[c] * v[b]);
    by_unit[1 + a] = 2 * (by[b] * v[b] + by[c] * v[c]);
    by_unit[1 + b] = 2 * (by[b] * v[a] - by[c] * w) - 4 * by[a] * v[b];
    by_unit[1 + c] = 2 * (by[b] * w + by[c] * v[a]) - 4 * by[a] * v[c];
    float along = 0;
    for (int i = 0; i < 4; ++i) along += by_unit[i] * q[i];
    for (int i = 0; i < 4; ++i) by_quaternion[i] = (by_unit[i] - along * q[i]) * inverse;
  }

  void tell(float* told) const {
    axis(told);
    told[3] = 1 - values[1] / values[0];
    for (int i = 0; i < 3; ++i) told[4 + i] = values[i] / sum;
  }

  void pull_told(const float* by, const float* told, const float* scales, float* by_quaternion, float* by_scales) const {
    pull_axis(by, by_quaternion);
    float along = 0, by_values[3];
    for (int i = 0; i < 3; ++i) along += by[4 + i] * told[4 + i];
    for (int i = 0; i < 3; ++i) by_values[i] = (by[4 + i] - along) / sum;
    by_values[1] -= by[3] / values[0];
    by_values[0] += by[3] * values[1] / (values[0] * values[0]);
    for (int i = 0; i < 3; ++i) by_scales[order[i]] = 2 * scales[order[i]] * by_values[i];
  }
};

struct Piece {  // of a cell's pairs
  int cell;
  int64_t first, last;
};

std::vector<Piece> pieces_of(const SupportArrays& a) {
  const int64_t each = std::max(SMALLEST, (a.pairs / PIECES + GROUP - 1) / GROUP * GROUP);
  std::vector<Piece> found;
  for (int cell = 0; cell < CELLS; ++cell)
    for (int64_t first = cell ? a.ends[cell - 1] : 0; first < a.ends[cell]; first += each)
      found.push_back({cell, first, std::min(first + each, a.ends[cell])});
  return found;
}

// task(first, last) over groups of [from, to).
template <class Task>
void by_groups(int64_t from, int64_t to, Task task) {
  for (int64_t first = from; first < to; first += GROUP) task(first, std::min(to, first + GROUP));
}

struct Opened {
  std::vector<int64_t> place;
  Buffer<float> told;
  SupportState state;

  Opened(const SupportArrays& a, float* mixed, int threads) : place((size_t)a.count, -1), state{} {
    for (int64_t i = 0; i < a.shown; ++i) place[(size_t)a.seen[i]] = i;
    if (a.modulated) {
      told.resize((size_t)(a.shown * TOLD));
      over_gaussians(threads, a.shown, [&](int64_t first, int64_t last) {
        for (int64_t i = first; i < last; ++i)
          Shape(a.quaternions + a.seen[i] * 4, a.scales + a.seen[i] * 3).tell(told.data() + i * TOLD);
      });
    }
    state = {place.data(), told.data(), mixed};
  }
};

int64_t pair_sums_size(const SupportArrays& a) { return a.c * padded(a.c) + sums_size(a.modulation); }
PairSums pair_sums(const SupportArrays& a, float* memory) {
  PairSums sums;
  sums.convolution = memory;
  memory += a.c * padded(a.c);
  sums.modulation = lay_out_sums(a.modulation, memory);
  return sums;
}

int64_t site_sums_size(const SupportArrays& a) { return (a.c + 1) * padded(a.c) + sums_size(a.gate); }
SiteSums site_sums(const SupportArrays& a, float* memory) {
  SiteSums sums;
  sums.residual = memory;
  sums.residual_bias = memory + a.c * padded(a.c);
  memory += (a.c + 1) * padded(a.c);
  sums.gate = lay_out_sums(a.gate, memory);
  return sums;
}

void add_to(float* total, const float* part, int64_t size) {
  for (int64_t i = 0; i < size; ++i) total[i] += part[i];
}

void pull_sites(const SupportArrays& a, const SupportState& s, const SupportGradients& g, float* by_mixed, int threads) {
  const int64_t groups = (a.shown + GROUP - 1) / GROUP, parts = std::clamp<int64_t>(groups / 4, 1, MOST_PARTS);
  const int64_t each = support_plane(a) * SUPPORT_PLANES, size = site_sums_size(a);
  Buffer<float> memory((size_t)(each * threads)), sums((size_t)(size * parts));
  std::fill(sums.data(), sums.data() + sums.size(), 0.0f);
  parallel(threads, (int)parts, [&](int part, int worker) {
    const SiteSums here = site_sums(a, sums.data() + size * part);
    by_groups(groups * part / parts * GROUP, std::min(a.shown, groups * (part + 1) / parts * GROUP),
              [&](int64_t first, int64_t last) {
                support_in_use().sites_backward(a, s, g.of_out, by_mixed, here, memory.data() + each * worker, first, last);
              });
  });
  for (int64_t part = 1; part < parts; ++part) add_to(sums.data(), sums.data() + size * part, size);
  const SiteSums total = site_sums(a, sums.data());
  leave_rows(total.residual, a.c, a.c, g.residual);
  leave_rows(total.residual_bias, 1, a.c, g.residual_bias);
  leave_sums(a.gate, total.gate, g.gate);
}

void pull_pairs(const SupportArrays& a, const SupportState& s, const SupportGradients& g, const float* by_mixed,
                float* by_given, float* by_code, int threads) {
  const std::vector<Piece> pieces = pieces_of(a);
  const int64_t each = support_plane(a) * SUPPORT_PLANES, size = pair_sums_size(a);
  Buffer<float> memory((size_t)(each * threads)), sums((size_t)(size * (int64_t)pieces.size()));
  std::fill(sums.data(), sums.data() + sums.size(), 0.0f);
  parallel(threads, (int)pieces.size(), [&](int i, int worker) {
    const Piece& piece = pieces[(size_t)i];
    const PairSums here = pair_sums(a, sums.data() + size * i);
    by_groups(piece.first, piece.last, [&](int64_t first, int64_t last) {
      support_in_use().pairs_backward(a, s, by_mixed, by_given, by_code, here, memory.data() + each * worker, piece.cell,
                                      first, last);
    });
  });
  Buffer<float> total((size_t)size);
  std::fill(total.data(), total.data() + size, 0.0f);
  const int64_t weights = (int64_t)a.c * padded(a.c), by = (int64_t)a.c * a.c;
  std::fill(g.convolution, g.convolution + CELLS * by, 0.0f);
  for (size_t i = 0; i < pieces.size(); ++i) {
    float* here = sums.data() + size * (int64_t)i;
    float* to = g.convolution + pieces[i].cell * by;
    for (int r = 0; r < a.c; ++r) add_to(to + r * a.c, here + r * padded(a.c), a.c);
    add_to(total.data() + weights, here + weights, size - weights);
  }
  leave_sums(a.modulation, pair_sums(a, total.data()).modulation, g.modulation);
}

// From the codes of pairs to the shapes of those who received.
void pull_shapes(const SupportArrays& a, const SupportState& s, const SupportGradients& g, const float* by_code) {
  std::vector<float> by_told((size_t)(a.shown * TOLD), 0.0f);
  for (int64_t pair = 0; pair < a.pairs; ++pair) {
    const int64_t site = s.place[a.sites[pair]];
    const float *told = s.told + site * TOLD, *by = by_code + pair * PAIR_CODE;
    float offset[3], along, apart, *to = by_told.data() + site * TOLD;
    const float cosine = pair_cosine(a, pair, told, offset, &along, &apart);
    to[3] += by[0] * cosine;
    for (int c = 0; c < 3; ++c) {
      to[c] += by[0] * told[3] * 2 * along / apart * offset[c];
      to[4 + c] += by[1 + c];
    }
  }
  for (int64_t i = 0; i < a.shown; ++i) {
    const int64_t row = a.seen[i];
    float by_quaternion[4], by_scales[3];
    Shape(a.quaternions + row * 4, a.scales + row * 3)
        .pull_told(by_told.data() + i * TOLD, s.told + i * TOLD, a.scales + row * 3, by_quaternion, by_scales);
    if (g.quaternions) std::copy(by_quaternion, by_quaternion + 4, g.quaternions + row * 4);
    if (g.scales) std::copy(by_scales, by_scales + 3, g.scales + row * 3);
  }
}

}  // namespace

void support(const SupportArrays& a, float* out, float* mixed, int threads) {
  const Opened opened(a, mixed, threads);
  const std::vector<Piece> pieces = pieces_of(a);
  const int64_t each = support_plane(a) * SUPPORT_PLANES;
  Buffer<float> memory((size_t)(each * threads)), added((size_t)(a.pairs * a.c));
  parallel(threads, (int)pieces.size(), [&](int i, int worker) {
    const Piece& piece = pieces[(size_t)i];
    by_groups(piece.first, piece.last, [&](int64_t first, int64_t last) {
      support_in_use().pairs(a, opened.state, added.data(), memory.data() + each * worker, piece.cell, first, last);
    });
  });
  std::fill(mixed, mixed + a.shown * a.c, 0.0f);
  for (int64_t pair = 0; pair < a.pairs; ++pair)
    add_to(mixed + opened.place[(size_t)a.sites[pair]] * a.c, added.data() + pair * a.c, a.c);
  parallel(threads, (int)((a.shown + GROUP - 1) / GROUP), [&](int group, int worker) {
    const int64_t first = (int64_t)group * GROUP;
    support_in_use().sites(a, opened.state, out, memory.data() + each * worker, first, std::min(a.shown, first + GROUP));
  });
}

void support_backward(const SupportArrays& a, float* mixed, const SupportGradients& g, int threads) {
  const Opened opened(a, mixed, threads);
  Buffer<float> by_mixed((size_t)(a.shown * a.c)), by_given((size_t)(a.pairs * a.c)),
      by_code((size_t)(a.modulated ? a.pairs * PAIR_CODE : 0));
  pull_sites(a, opened.state, g, by_mixed.data(), threads);
  pull_pairs(a, opened.state, g, by_mixed.data(), by_given.data(), by_code.data(), threads);
  if (g.features) {
    std::fill(g.features, g.features + a.count * a.c, 0.0f);
    for (int64_t i = 0; i < a.shown; ++i) add_to(g.features + a.seen[i] * a.c, g.of_out + i * a.c, a.c);
    for (int64_t pair = 0; pair < a.pairs; ++pair)
      add_to(g.features + a.neighbours[pair] * a.c, by_given.data() + pair * a.c, a.c);
  }
  if (g.quaternions) std::fill(g.quaternions, g.quaternions + a.count * 4, 0.0f);
  if (g.scales) std::fill(g.scales, g.scales + a.count * 3, 0.0f);
  if (a.modulated && (g.quaternions || g.scales)) pull_shapes(a, opened.state, g, by_code.data());
}

}  // namespace splat
