// Attention by lists at one SIMD level; no standard library here (see level.cpp).
//
// A row's own share of every gradient is summed over its list: pairs go both ways, so whom it gives to is whom it
// takes from. Shares are made again from what the forward pass kept of each row, so nothing is kept of a pair.
#include "attention.hpp"
#include "simd.hpp"

#include "activations.inl"

namespace {

struct Memory {  // of one row: a number a target, up to the next multiple of LANES
  uint32_t* list;  // rows of the targets
  float *scores, *theirs, *by_share, *by_theirs;
};

INLINE Memory carve(float* scratch, int64_t longest) {
  const int64_t each = longest + LANES;
  return {(uint32_t*)scratch, scratch + each, scratch + 2 * each, scratch + 3 * each, scratch + 4 * each};
}

// Rows of those that row r sees; returns how many.
STAGE int near(const AttentionArrays& a, int64_t r, uint32_t* list) {
  const int64_t anchor = a.rows[r];
  int count = 0;
  for (int64_t p = a.starts[anchor]; p < a.starts[anchor + 1]; ++p) {
    const int64_t other = a.targets[p];
    const int32_t row = a.place[other];
    if (row < 0) continue;
    if (a.centres && other != anchor) {
      float square = 0;
      for (int c = 0; c < 3; ++c) {
        const float apart = a.centres[other * 3 + c] - a.centres[anchor * 3 + c];
        square += apart * apart;
      }
      if (!(__builtin_sqrtf(square) <= a.radius)) continue;
    }
    list[count++] = (uint32_t)row;
  }
  return count;
}

// out[j] = one . rows[list[j]]; beyond `count` up to a multiple of LANES the last one again.
STAGE void products(const float* one, const float* rows, int width, const uint32_t* list, int count, float* out) {
  alignas(64) float sums[LANES][LANES], turned[LANES][LANES];
  for (int j = 0; j < count; j += LANES) {
    for (int l = 0; l < LANES; ++l) {
      const float* other = rows + (size_t)list[j + l < count ? j + l : count - 1] * width;
      vf sum = all(0);
      for (int w = 0; w < width; w += LANES) sum = sum + load(one + w) * load(other + w);
      store(sums[l], sum);
    }
    transpose(sums[0], LANES, turned[0], LANES);
    vf sum = load(turned[0]);
    for (int l = 1; l < LANES; ++l) sum = sum + load(turned[l]);
    store(out + j, sum);
  }
}

// out = sum_j shares[j] rows[list[j]]
STAGE void mix(const float* shares, const float* rows, int width, const uint32_t* list, int count, float* out) {
  for (int w = 0; w < width; w += LANES) {
    vf sum = all(0);
    for (int j = 0; j < count; ++j) sum = sum + all(shares[j]) * load(rows + (size_t)list[j] * width + w);
    store(out + w, sum);
  }
}

void forward(const AttentionArrays& a, float* scratch, int64_t longest, int64_t first, int64_t last, float* mixed,
             const AttentionSums& sums) {
  const Memory m = carve(scratch, longest);
  for (int64_t r = first; r < last; ++r) {
    const int count = near(a, r, m.list);
    products(a.query + r * a.width, a.key, a.width, m.list, count, m.scores);
    float highest = -__builtin_inff(), sum = 0;
    for (int j = 0; j < count; ++j) highest = m.scores[j] > highest ? m.scores[j] : highest;
    for (int j = 0; j < count; j += LANES) store(m.scores + j, exponential(load(m.scores + j) - all(highest)));
    for (int j = 0; j < count; ++j) sum += m.scores[j];
    const float inverse = 1 / sum;
    sums.highest[r] = highest;
    sums.inverse[r] = inverse;
    for (int j = 0; j < count; j += LANES) store(m.scores + j, load(m.scores + j) * all(inverse));
    mix(m.scores, a.value, a.value_width, m.list, count, mixed + r * a.value_width);
  }
}

void means(const AttentionArrays& a, const float* of, const float* mixed, int64_t first, int64_t last, float* mean) {
  for (int64_t r = first; r < last; ++r) {
    float lanes[LANES];
    vf sum = all(0);
    for (int w = 0; w < a.value_width; w += LANES)
      sum = sum + load(of + r * a.value_width + w) * load(mixed + r * a.value_width + w);
    store(lanes, sum);
    mean[r] = lanes[0];
    for (int l = 1; l < LANES; ++l) mean[r] += lanes[l];
  }
}

void backward(const AttentionArrays& a, float* scratch, int64_t longest, int64_t first, int64_t last,
              const AttentionSums& sums, const AttentionGradients& g) {
  const Memory m = carve(scratch, longest);
  for (int64_t r = first; r < last; ++r) {
    const int count = near(a, r, m.list);
    products(a.query + r * a.width, a.key, a.width, m.list, count, m.scores);
    products(a.key + r * a.width, a.query, a.width, m.list, count, m.theirs);
    products(g.of + r * a.value_width, a.value, a.value_width, m.list, count, m.by_share);
    products(a.value + r * a.value_width, g.of, a.value_width, m.list, count, m.by_theirs);
    const vf highest = all(sums.highest[r]), inverse = all(sums.inverse[r]), mean = all(g.mean[r]);
    for (int j = 0; j < count; j += LANES) {
      alignas(64) float most[LANES], parts[LANES], means[LANES];
      for (int l = 0; l < LANES; ++l) {
        const uint32_t other = m.list[j + l < count ? j + l : count - 1];
        most[l] = sums.highest[other];
        parts[l] = sums.inverse[other];
        means[l] = g.mean[other];
      }
      const vf share = exponential(load(m.scores + j) - highest) * inverse;
      const vf theirs = exponential(load(m.theirs + j) - load(most)) * load(parts);
      store(m.by_share + j, share * (load(m.by_share + j) - mean));
      store(m.by_theirs + j, theirs * (load(m.by_theirs + j) - load(means)));
      store(m.theirs + j, theirs);
    }
    mix(m.by_share, a.key, a.width, m.list, count, g.by_query + r * a.width);
    mix(m.by_theirs, a.query, a.width, m.list, count, g.by_key + r * a.width);
    mix(m.theirs, g.of, a.value_width, m.list, count, g.by_value + r * a.value_width);
  }
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::AttentionKernels JOIN(splat_attention_, SPLAT_LEVEL);
const splat::AttentionKernels JOIN(splat_attention_, SPLAT_LEVEL) = {forward, means, backward};
