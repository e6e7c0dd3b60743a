// L1 and SSIM of an image against a photo, and their gradient. Rows are interleaved channels, so a window that
// moves by one pixel moves by `channels` floats and no channel needs a plane of its own. The image is worked on in
// strips, from top to bottom, so that the rows that a window spans stay in the first-level cache.

namespace {

constexpr int REACH = 5;  // the window has 2 * 5 + 1 taps
constexpr int SPAN = 2 * REACH + 1;
constexpr int RING = SPAN + 1;  // rows that are at hand: two windows, one below the other, are worked on at once
constexpr int SOURCES = 4;  // a, b, a^2 + b^2, a b: SSIM takes both variances in sum
constexpr int MAPS = 3;     // SSIM's derivatives by the local means of a, a^2 and a b
constexpr int STRIP_ROWS_AHEAD = 3;  // rows of a strip that are fetched before they are needed: no prefetcher sees them coming
constexpr float SSIM_C1 = 1e-4f, SSIM_C2 = 9e-4f;

// Buffers of one strip of LOSS_STRIP floats or less that starts at `left`; everything has `margin` floats more on both
// sides, and what is blurred twice has two margins. C channels, so that where a window lies is known beforehand; 0
// is any number.
template <int C>
struct Strip {
  const Loss* loss;
  int left, floats;                      // a multiple of LANES, the last ones beyond the row perhaps
  float *source[SOURCES], *map[2][MAPS]; // rows before they are blurred along x: with two margins, with one
  float *valid[2], *a[2], *b[2];         // two rows, with one margin; without
  float *blurred[RING], *derived[RING];  // sources with one margin, maps without

  int channels() const { return C ? C : loss->channels; }
  int margin() const { return C ? loss_margin(C) : loss->margin; }
  int wide() const { return LOSS_STRIP + 2 * margin(); }
};

// Floats [from, from + count) of a row, zero outside it and where the mask is not set.
INLINE void read_part(const float* image, const Loss& loss, int channels, int y, int from, int count, float* out) {
  const int floats = loss.width * channels, begin = from < 0 ? -from : 0;
  const int end = floats - from < count ? floats - from : count;
  for (int i = 0; i < begin; ++i) out[i] = 0;
  for (int i = end < begin ? begin : end; i < count; ++i) out[i] = 0;
  if (end <= begin) return;
  const float* row = image + (size_t)y * floats + from;
  if (loss.mask) {
    const uint8_t* mask = loss.mask + (size_t)y * loss.width;
    for (int i = begin; i < end; ++i) out[i] = mask[(from + i) / channels] ? row[i] : 0;
  } else __builtin_memcpy(out + begin, row + begin, (end - begin) * sizeof(float));
}

// 1 where a float of a row counts, else 0.
INLINE void read_valid(const Loss& loss, int channels, int y, int from, int count, float* out) {
  const int floats = loss.width * channels;
  for (int i = 0; i < count; ++i) {
    const int at = from + i;
    const bool inside = at >= 0 && at < floats;
    out[i] = inside && (!loss.mask || loss.mask[(size_t)y * loss.width + at / channels]) ? 1.0f : 0.0f;
  }
}

INLINE void clear(float* row, int count) {
  for (int i = 0; i < count; i += L) store(row + i, all(0));
}

#if defined(__AVX512F__)
template <int K>  // lanes K and following of `a`, then those of `b`
INLINE vf shifted(vf a, vf b) {
  return {(NF)_mm512_alignr_epi32((__m512i)b.v, (__m512i)a.v, K)};
}

// blur_row of vectors out of registers: from memory nearly every one of them would lie on two lines.
template <int C>
INLINE void blur_lines(const float* row, float* out, int count, const vf taps[REACH + 1]) {
  static_assert(REACH == 5 && REACH * C < L, "a vector to either side");
  vf before = load(row - L), here = load(row);
  for (int i = 0; i < count; i += L) {
    const vf after = load(row + i + L);
    vf sum = here * taps[0];
    sum = sum + (shifted<L - C>(before, here) + shifted<C>(here, after)) * taps[1];
    sum = sum + (shifted<L - 2 * C>(before, here) + shifted<2 * C>(here, after)) * taps[2];
    sum = sum + (shifted<L - 3 * C>(before, here) + shifted<3 * C>(here, after)) * taps[3];
    sum = sum + (shifted<L - 4 * C>(before, here) + shifted<4 * C>(here, after)) * taps[4];
    sum = sum + (shifted<L - 5 * C>(before, here) + shifted<5 * C>(here, after)) * taps[5];
    store(out + i, sum);
    before = here;
    here = after;
  }
}
#endif

// out[i] = sum_k taps[k] row[i + k channels] for i in [0, count), a multiple of LANES.
template <int C>
INLINE void blur_row(const float* row, float* out, int count, int channels, const Loss& loss) {
  vf taps[REACH + 1];
  for (int k = 0; k <= REACH; ++k) taps[k] = all(loss.taps[k]);
#if defined(__AVX512F__)
  if constexpr (C == 3) return blur_lines<C>(row, out, count, taps);
#endif
  for (int i = 0; i < count; i += L) {
    vf sum = load(row + i) * taps[0];
#pragma GCC unroll 5
    for (int k = 1; k <= REACH; ++k)
      sum = sum + (load(row + i - k * channels) + load(row + i + k * channels)) * taps[k];
    store(out + i, sum);
  }
}

// The same along y, for two windows, the second a row below the first: rows follow one another in the ring from the
// oldest on, and each is read once for both.
template <int N>
INLINE void blur_columns(float* const* ring, int oldest, int offset, int stride, const float* taps, vf out[2][N]) {
  const float* rows[RING];
#pragma GCC unroll 12
  for (int k = 0; k < RING; ++k) rows[k] = ring[oldest + k < RING ? oldest + k : oldest + k - RING] + offset;
#pragma GCC unroll 4
  for (int n = 0; n < N; ++n) {
    vf row[RING];
#pragma GCC unroll 12
    for (int k = 0; k < RING; ++k) row[k] = load(rows[k] + n * stride);
#pragma GCC unroll 2
    for (int w = 0; w < 2; ++w) {
      vf sum = row[REACH + w] * all(taps[0]);
#pragma GCC unroll 5
      for (int k = 1; k <= REACH; ++k) sum = sum + (row[REACH + w - k] + row[REACH + w + k]) * all(taps[k]);
      out[w][n] = sum;
    }
  }
}

INLINE bool inside(const Loss& loss, int y) { return y >= 0 && y < loss.height; }

INLINE float row_sum(vf v) {
  float values[L], sum = 0;
  store(values, v);
  for (int l = 0; l < L; ++l) sum += values[l];
  return sum;
}

// Row y of the sources, blurred along x, into the ring.
template <int C>
STAGE void take_row(const Strip<C>& s, int y, float* out) {
  const Loss& loss = *s.loss;
  if (!inside(loss, y)) {
    clear(out, SOURCES * s.wide());
    return;
  }
  const int all_of = s.floats + 4 * s.margin(), from = s.left - 2 * s.margin();
  if (y + STRIP_ROWS_AHEAD < loss.height)
    for (int i = 0; i < all_of; i += L) {
      const size_t later = (size_t)(y + STRIP_ROWS_AHEAD) * loss.width * loss.channels + (size_t)(from + i < 0 ? 0 : from + i);
      __builtin_prefetch(loss.image + later);
      __builtin_prefetch(loss.truth + later);
    }
  read_part(loss.image, loss, s.channels(), y, from, all_of, s.source[0]);
  read_part(loss.truth, loss, s.channels(), y, from, all_of, s.source[1]);
  for (int i = 0; i < all_of; i += L) {
    const vf a = load(s.source[0] + i), b = load(s.source[1] + i);
    store(s.source[2] + i, a * a + b * b);
    store(s.source[3] + i, a * b);
  }
  for (int m = 0; m < SOURCES; ++m) blur_row<C>(s.source[m] + s.margin(), out + m * s.wide(), s.floats + 2 * s.margin(), s.channels(), loss);
}

// SSIM around the pixels of rows y and y + 1, the oldest of whose rows in the ring is given: its sums over the strip,
// and its derivatives blurred along x in `out` unless these are null. A row outside of the image has none.
template <int C>
STAGE void derive_rows(const Strip<C>& s, int y, int oldest, float* const out[2], float sums[2]) {
  const Loss& loss = *s.loss;
  if (loss.mask)
    for (int w = 0; w < 2; ++w)
      if (inside(loss, y + w)) read_valid(loss, s.channels(), y + w, s.left - s.margin(), s.wide(), s.valid[w]);
  vf similar[2] = {all(0), all(0)};
  const int from = out[0] ? 0 : s.margin(), to = s.floats + (out[0] ? 2 : 1) * s.margin();
  for (int i = from; i < to; i += L) {
    vf mean[2][SOURCES];
    blur_columns<SOURCES>(s.blurred, oldest, i, s.wide(), loss.taps, mean);
#pragma GCC unroll 2
    for (int w = 0; w < 2; ++w) {
      const vf two = all(2), ma = mean[w][0], mb = mean[w][1], both = ma * ma + mb * mb, product = ma * mb;
      const vf a1 = two * product + all(SSIM_C1), a2 = two * (mean[w][3] - product) + all(SSIM_C2);
      const vf r1 = reciprocal(both + all(SSIM_C1)), r2 = reciprocal(mean[w][2] - both + all(SSIM_C2));
      // where nothing counts, `valid` is 0: the maps are 0 there, as the second blur needs them
      const vf scale = load(s.valid[w] + i) * r1 * r2, ssim = a1 * a2 * scale, by_aa = all(0) - ssim * r2;
      if (i >= s.margin() && i < s.margin() + s.floats) similar[w] = similar[w] + ssim;
      if (!out[0]) continue;
      store(s.map[w][0] + i, two * mb * (a2 - a1) * scale - two * ma * (ssim * r1 + by_aa));
      store(s.map[w][1] + i, by_aa);
      store(s.map[w][2] + i, two * a1 * scale);
    }
  }
  for (int w = 0; w < 2; ++w) {
    sums[w] = inside(loss, y + w) ? row_sum(similar[w]) : 0;
    if (!out[w]) continue;
    if (inside(loss, y + w))
      for (int m = 0; m < MAPS; ++m)
        blur_row<C>(s.map[w][m] + s.margin(), out[w] + m * LOSS_STRIP, s.floats, s.channels(), loss);
    else clear(out[w], MAPS * LOSS_STRIP);
  }
}

// The sums of |a - b| over rows y and y + 1 of the strip, of those of them that are before `last`; their gradients too,
// where there are to be any.
template <int C>
STAGE void compare_rows(const Strip<C>& s, int y, int last, int oldest, float sums[2]) {
  const Loss& loss = *s.loss;
  const int floats = loss.width * loss.channels, end = floats - s.left < s.floats ? floats - s.left : s.floats;
  const int rows = last - y < 2 ? last - y : 2;
  for (int w = 0; w < rows; ++w) {
    read_part(loss.image, loss, s.channels(), y + w, s.left, s.floats, s.a[w]);
    read_part(loss.truth, loss, s.channels(), y + w, s.left, s.floats, s.b[w]);
    if (loss.gradient && loss.mask)
      read_valid(loss, s.channels(), y + w, s.left - s.margin(), s.wide(), s.valid[w]);
  }
  vf sum[2] = {all(0), all(0)};
  for (int i = 0; i < s.floats; i += L) {
    vf mean[2][MAPS];
    if (loss.gradient) blur_columns<MAPS>(s.derived, oldest, i, LOSS_STRIP, loss.taps, mean);
#pragma GCC unroll 2
    for (int w = 0; w < 2; ++w) {
      const vf a = load(s.a[w] + i), b = load(s.b[w] + i);
      sum[w] = sum[w] + absolute(a - b);
      if (!loss.gradient) continue;
      const vf by_ssim = mean[w][0] + all(2) * a * mean[w][1] + b * mean[w][2];
      const vf sign = keep(b < a, all(1)) - keep(a < b, all(1));
      const vf valid = load(s.valid[w] + s.margin() + i);
      store(s.a[w] + i, valid * (all(loss.l1_weight) * sign - all(loss.ssim_weight) * by_ssim));
    }
  }
  for (int w = 0; w < rows; ++w) {
    sums[w] = row_sum(sum[w]);
    if (loss.gradient) __builtin_memcpy(loss.gradient + (size_t)(y + w) * floats + s.left, s.a[w], end * sizeof(float));
  }
}

template <int C>
INLINE void loss_strips(const Loss& loss, float* scratch, int first, int last) {
  Strip<C> s;
  s.loss = &loss;
  const auto take = [&](int count) { scratch += count; return scratch - count; };
  for (float*& row : s.source) row = take(s.wide() + 2 * s.margin());
  for (int w = 0; w < 2; ++w) {
    for (float*& row : s.map[w]) row = take(s.wide());
    s.valid[w] = take(s.wide());
    s.a[w] = take(LOSS_STRIP);
    s.b[w] = take(LOSS_STRIP);
  }
  for (float*& row : s.blurred) row = take(SOURCES * s.wide());
  for (float*& row : s.derived) row = take(MAPS * LOSS_STRIP);
  for (int y = first; y < last; ++y) loss.sums[2 * y] = loss.sums[2 * y + 1] = 0;
  const int more = loss.gradient ? REACH : 0;  // rows of SSIM whose windows reach into these rows
  for (s.left = 0; s.left < loss.width * loss.channels; s.left += LOSS_STRIP) {
    const int rest = loss.width * loss.channels - s.left;
    s.floats = rest < LOSS_STRIP ? (rest + L - 1) / L * L : LOSS_STRIP;
    if (!loss.mask)
      for (float* valid : s.valid) read_valid(loss, s.channels(), 0, s.left - s.margin(), s.wide(), valid);
    for (int y = first - more - REACH, taken = 0, derived = 0; y < last + more + REACH; y += 2, taken += 2) {
      for (int w = 0; w < 2; ++w) take_row(s, y + w, s.blurred[(taken + w) % RING]);
      if (taken < 2 * REACH) continue;
      const int centre = y - REACH;
      float* out[2] = {};
      for (int w = 0; more && w < 2; ++w) out[w] = s.derived[(derived + w) % RING];
      float similar[2], different[2];
      derive_rows(s, centre, (taken + 2) % RING, out, similar);
      for (int w = 0; w < 2; ++w)
        if (centre + w >= first && centre + w < last) loss.sums[2 * (centre + w) + 1] += similar[w];
      derived += 2;
      if (derived <= 2 * more) continue;
      compare_rows(s, centre - more, last, derived % RING, different);
      for (int w = 0; w < 2 && centre - more + w < last; ++w) loss.sums[2 * (centre - more + w)] += different[w];
    }
  }
}

// Rows [first, last): sums of |a - b| and of SSIM into loss.sums, and the gradient by the image.
void loss_rows(const Loss& loss, float* scratch, int first, int last) {
  if (loss.channels == 3) loss_strips<3>(loss, scratch, first, last);
  else loss_strips<0>(loss, scratch, first, last);
}

}  // namespace
