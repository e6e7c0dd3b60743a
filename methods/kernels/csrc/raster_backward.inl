// Gradients of one tile: for each of its Gaussians, sums over the pixels. Nothing is shared between tiles, so the
// result does not depend on threads.

namespace {

// Gradients of the sixteen pixels of a block.
struct PixelGradients {
  float feature[MAX_CHANNELS + 2][L];
  float centre[2][L];  // expected depth and distance: d depth / d weight = (z - depth) / sum of weights
  float residue[2][L];
  float left[L];       // by the final transmittance
  float median[L];
};

// Of a block within the picture whose colours alone have gradients.
template <int CHANNELS>
INLINE void read_colours(const Tiles& tiles, const PictureGradients& in, int x0, int y0, PixelGradients& out) {
  for (int j = 0; j < BLOCK; ++j) {
    const float* row = in.colour + ((size_t)(y0 + j) * tiles.width + x0) * CHANNELS;
    for (int i = 0; i < BLOCK; ++i)
      for (int c = 0; c < CHANNELS; ++c) out.feature[c][BLOCK * j + i] = row[CHANNELS * i + c];
  }
  vf by_left = all(0);
  for (int c = 0; c < CHANNELS && in.background; ++c) by_left = by_left + load(out.feature[c]) * all(in.background[c]);
  store(out.left, by_left);
}

STAGE void read_block(const Tiles& tiles, const PictureGradients& in, int features, int left, int top, int b,
                       PixelGradients& out) {
  const int x0 = left + (b % 4) * BLOCK, y0 = top + (b / 4) * BLOCK;
  const bool only_colour = in.colour && !in.alpha && !in.depth && !in.distance && !in.median;
  if (only_colour && x0 + BLOCK <= tiles.width && y0 + BLOCK <= tiles.height) {  // the usual case, without branches
    switch (in.channels) {
      case 1: return read_colours<1>(tiles, in, x0, y0, out);
      case 3: return read_colours<3>(tiles, in, x0, y0, out);
      case 6: return read_colours<6>(tiles, in, x0, y0, out);
    }
  }
  for (int l = 0; l < L; ++l) {
    const int x = x0 + l % BLOCK, y = y0 + l / BLOCK;
    const bool inside = x < tiles.width && y < tiles.height;
    const size_t pixel = inside ? (size_t)y * tiles.width + x : 0;
    float by_left = 0;
    for (int c = 0; c < in.channels; ++c) {
      const float v = inside && in.colour ? in.colour[pixel * in.channels + c] : 0;
      out.feature[c][l] = v;
      if (in.background) by_left += v * in.background[c];
    }
    const float alpha = inside && in.alpha_value ? in.alpha_value[pixel] : 0;
    const float scale = alpha > 0 ? 1 / alpha : 0;
    if (in.alpha && inside) by_left -= in.alpha[pixel];
    const float depth = in.depth && inside ? in.depth[pixel] * scale : 0;
    const float distance = in.distance && inside ? in.distance[pixel] * scale : 0;
    if (features > in.channels) out.feature[in.channels][l] = depth;
    if (features > in.channels + 1) out.feature[in.channels + 1][l] = distance;
    out.centre[0][l] = inside && in.depth_value ? in.depth_value[pixel] : 0;
    out.centre[1][l] = inside && in.distance_value ? in.distance_value[pixel] : 0;
    out.left[l] = by_left;
    out.median[l] = in.median && inside ? in.median[pixel] : 0;
  }
}

// What rounding left out of an expected depth: sum w (z - centre) / sum w. Without it a pixel with one Gaussian,
// whose depth does not depend on the weight, would get a gradient of 1e-7 z / alpha.
STAGE void residue(const float* recs, int stride, const uint32_t* list, int length, int feature, const float* weights,
                   const float* centre, float* out) {
  vf sum = all(0), total = all(0);
  const vf middle = load(centre);
  for (int k = 0; k < length; ++k) {
    const vf w = load(weights + (size_t)k * L);
    sum = sum + w * (all(recs[(size_t)list[k] * stride + R_FEATURES + feature]) - middle);
    total = total + w;
  }
  store(out, keep(total > all(0), sum / total));
}

// d loss / d ln(alpha) of each listed Gaussian at each pixel, back to front, over `alphas` in place.
// `behind` is the gradient-weighted colour of what lies behind, so no division is needed.
// For 3 channels and EXTRAS of depth and distance, or any number of both if EXTRAS is -1.
template <int EXTRAS>
STAGE void exponents(const float* recs, int stride, const uint32_t* list, int length, int channels, int features,
                      const PixelGradients& pixel, const float* weights, float* alphas) {
  constexpr int N = EXTRAS < 0 ? 1 : 3 + EXTRAS;
  vf v[N];
  for (int f = 0; f < N; ++f) v[f] = load(pixel.feature[f]);
  vf behind = load(pixel.left);
  for (int k = length - 1; k >= 0; --k) {
    const float* rec = recs + (size_t)list[k] * stride;
    const vf alpha = load(alphas + (size_t)k * L), weight = load(weights + (size_t)k * L);
    vf here = all(0);
    if constexpr (EXTRAS >= 0) {
      for (int f = 0; f < 3; ++f) here = here + v[f] * all(rec[R_FEATURES + f]);
      for (int f = 3; f < N; ++f)
        here = here + v[f] * (all(rec[R_FEATURES + f]) - load(pixel.centre[f - 3]) - load(pixel.residue[f - 3]));
    } else {
      for (int f = 0; f < channels; ++f) here = here + load(pixel.feature[f]) * all(rec[R_FEATURES + f]);
      for (int f = channels; f < features; ++f)
        here = here + load(pixel.feature[f]) * (all(rec[R_FEATURES + f]) - load(pixel.centre[f - channels]) -
                                                load(pixel.residue[f - channels]));
    }
    const vf difference = here - behind;
    vf g = weight * difference;
    behind = behind + alpha * difference;
    if (rec[R_OPACITY] > ALPHA_MAX) g = keep(alpha < all(ALPHA_MAX), g);  // no gradient through the clamp
    store(alphas + (size_t)k * L, g);
  }
}

INLINE void clear_rows(const SumRows& sums, const Entry* from, const Entry* to) {
  for (; from < to; ++from)
    for (int j = 0; j < sums.stride; j += L) store(sums.of(*from) + j, all(0));
}

// Sums over the pixels of a block for sixteen listed Gaussians as lanes; added to the rows of `entries`.
STAGE void reduce(const float* recs, int stride, const uint32_t* list, int count, int b, int features,
                   const PixelGradients& pixel, const float* weights, const float* gradients, const Entry* entries,
                   const SumRows& sums) {
  alignas(64) float rows[L][8], r[8][L], g[L][L], w[L][L];
  for (int l = 0; l < L; ++l)
    __builtin_memcpy(rows[l], recs + (size_t)list[l < count ? l : count - 1] * stride, sizeof rows[l]);
  for (int j = 0; j < 8; ++j)
    for (int l = 0; l < L; ++l) r[j][l] = rows[l][j];
  transpose(gradients, L, g[0], L);
  transpose(weights, L, w[0], L);
  const vf l11 = load(r[R_L11]), l12 = load(r[R_L12]), l22 = load(r[R_L22]);
  vf sg = all(0), su = sg, sv = sg, suu = sg, suv = sg, svv = sg, ax = sg, ay = sg;
  const float left = (b % 4) * BLOCK + 0.5f, top = (b / 4) * BLOCK + 0.5f;
  for (int i = 0; i < BLOCK; ++i) {
    const vf v = load(r[R_V0]) + l22 * all(top + i), lv = l22 * v;
    const vf start = load(r[R_U0]) + l12 * all(top + i);
    vf row_g = all(0), row_gu = row_g;
    for (int j = 0; j < BLOCK; ++j) {
      const vf u = start + l11 * all(left + j), gp = load(g[BLOCK * i + j]);
      const vf gu = gp * u;
      row_g = row_g + gp;
      row_gu = row_gu + gu;
      suu = suu + gu * u;
      ax = ax + absolute(gu);
      ay = ay + absolute(l12 * gu + lv * gp);
    }
    sg = sg + row_g;
    su = su + row_gu;
    sv = sv + row_g * v;
    suv = suv + row_gu * v;
    svv = svv + row_g * v * v;
  }
  alignas(64) float out[L][L], back[L][L];
  store(out[S_G], sg);
  store(out[S_GU], su);
  store(out[S_GV], sv);
  store(out[S_GUU], suu);
  store(out[S_GUV], suv);
  store(out[S_GVV], svv);
  store(out[S_ABS_X], ax);
  store(out[S_ABS_Y], ay);
  for (int f = 0, column = S_FEATURES; f < features || column == S_FEATURES;) {
    // sixteen sums make a row; the first row starts with the eight above
    for (; column < L; ++column, ++f) {
      vf acc = all(0);
      if (f < features)
        for (int p = 0; p < L; ++p) acc = acc + load(w[p]) * all(pixel.feature[f][p]);
      store(out[column], acc);
    }
    transpose(out[0], L, back[0], L);
    const int offset = S_FEATURES + f - L;
    for (int l = 0; l < count; ++l) {
      float* row = sums.of(entries[list[l]]) + offset;
      store(row, load(row) + load(back[l]));
    }
    column = 0;
  }
}

// The median depth's gradient goes to the one Gaussian that it is the depth of.
INLINE void median_backward(const uint32_t* list, int length, const float* weights, const PixelGradients& pixel,
                            int depth, const Entry* entries, const SumRows& sums) {
  for (int l = 0; l < L; ++l) {
    float total = 0;
    for (int k = 0; k < length; ++k) {
      const float after = total + weights[(size_t)k * L + l];
      if (total < 0.5f && after >= 0.5f) {
        sums.of(entries[list[k]])[S_FEATURES + depth] += pixel.median[l];
        break;
      }
      total = after;
    }
  }
}

// Any channels, depths: per block the contributions again, then gradients back to front, then sums over pixels.
STAGE void backward_any(const Tiles& tiles, const PictureGradients& in, const Scratch& scratch, int features, int tile,
                        const SumRows& sums) {
  const int left = tile % tiles.across * TILE, top = tile / tiles.across * TILE;
  const int stride = rec_stride(features);
  const uint32_t first = tiles.start[tile], total = tiles.start[tile + 1] - first;
  const int count = (int)tiles.processed[tile];
  const Entry* entries = tiles.entries + first;
  clear_rows(sums, entries, entries + total);
  if (count == 0) return;
  const Centres centres;
  int lengths[BLOCKS];
  const size_t capacity = (size_t)count + L;
  prepare<false>(tiles, scratch, features, left, top, first, 0, count, nullptr);
  nothing_at(scratch.recs + (size_t)count * stride, stride, (uint32_t)count - 1);
  list_blocks(tiles.blocks + first, count, (1u << BLOCKS) - 1, scratch, capacity, lengths);
  for (int b = 0; b < BLOCKS; ++b) {
    const int x = left + (b % 4) * BLOCK, y = top + (b / 4) * BLOCK;
    if (lengths[b] == 0 || x >= tiles.width || y >= tiles.height) continue;
    uint32_t* list = scratch.lists + (size_t)b * capacity;
    PixelGradients pixel;
    read_block(tiles, in, features, left, top, b, pixel);
    float ones[L];
    for (int l = 0; l < L; ++l)
      ones[l] = x + l % BLOCK < tiles.width && y + l / BLOCK < tiles.height ? 1 : 0;
    Light<L> light = {load(ones), load(ones), all(0), all(0)};
    const int k = blend<L, 0, false, true>(scratch.recs, stride, list, lengths[b], (uint32_t)count,
                                           T_MIN, pixels_of<L>(centres, b, 0), light, nullptr, scratch.weights, scratch.alphas);
    if (in.median) median_backward(list, k, scratch.weights, pixel, in.channels, entries, sums);
    for (int f = in.channels; f < features; ++f)
      residue(scratch.recs, stride, list, k, f, scratch.weights, pixel.centre[f - in.channels],
              pixel.residue[f - in.channels]);
    const auto back = in.channels != 3 ? exponents<-1>
                      : features == 3  ? exponents<0>
                      : features == 4  ? exponents<1>
                                       : exponents<2>;
    back(scratch.recs, stride, list, k, in.channels, features, pixel, scratch.weights, scratch.alphas);
    for (int j = 0; j < k; j += L)
      reduce(scratch.recs, stride, list + j, k - j < L ? k - j : L, b, features, pixel,
             scratch.weights + (size_t)j * L, scratch.alphas + (size_t)j * L, entries, sums);
  }
}

// Of a block, while Gaussians are taken away again from the last to the first. `behind` is the gradient-weighted
// colour of what lies behind, so the gradient by an alpha needs no division by it.
// After UN_BY there is a row a channel.
enum Undrawn { UN_LEFT, UN_BEHIND, UN_LAST, UN_X, UN_Y, UN_BY };

enum Wanted { COLOURS, SHAPES, MODULI, FRAGMENTS };  // each with those before it; the last in place of MODULI

// Which sums a Gaussian's row has, a bit each.
constexpr unsigned sums_of(int channels, Wanted wanted) {
  const unsigned every = (1u << (S_FEATURES + channels)) - 1, colours = every & ~((1u << S_FEATURES) - 1);
  return wanted >= MODULI ? every : wanted == SHAPES ? every & ~(1u << S_ABS_X | 1u << S_ABS_Y) : colours;
}

// One Gaussian over K registers of pixels: `sums` grows, lane by lane, and the pixels' state goes back by one.
template <int K, int CHANNELS, Wanted WANTED>
INLINE void undraw(const float* rec, float* const (&state)[K], V<float, WIDTH> (&sums)[S_FEATURES + CHANNELS]) {
  typedef V<float, WIDTH> Value;
  const auto one = [=](float x) { return broadcast<float, WIDTH>(x); };
  const auto part = [&](int k, int j) { return read<float, WIDTH>(state[k] + j * L); };
  Exponent<WIDTH> e[K];
  Value alpha[K], inverse[K], weight[K], g[K];
#pragma GCC unroll 2
  for (int k = 0; k < K; ++k) {
    e[k] = exponent<WIDTH>(rec, {part(k, UN_X), part(k, UN_Y)});
    alpha[k] = e[k].t;
  }
  exp2_of(alpha);
#pragma GCC unroll 2
  for (int k = 0; k < K; ++k) {
    const auto drawn = (e[k].t >= one(LEAST)) & (at<WIDTH>(rec, R_RANK) <= part(k, UN_LAST));
    alpha[k] = keep(drawn, minimum(alpha[k], one(ALPHA_MAX)));
    inverse[k] = reciprocal(one(1) - alpha[k]);
  }
#pragma GCC unroll 2
  for (int k = 0; k < K; ++k) {
    const Value before = part(k, UN_LEFT) * inverse[k], behind = part(k, UN_BEHIND);
    store(state[k] + UN_LEFT * L, before);
    weight[k] = before * alpha[k];
#pragma GCC unroll 6
    for (int c = 0; c < CHANNELS; ++c) sums[S_FEATURES + c] = sums[S_FEATURES + c] + weight[k] * part(k, UN_BY + c);
    if (WANTED == COLOURS) continue;
    Value here = part(k, UN_BY) * at<WIDTH>(rec, R_FEATURES);
#pragma GCC unroll 6
    for (int c = 1; c < CHANNELS; ++c) here = here + part(k, UN_BY + c) * at<WIDTH>(rec, R_FEATURES + c);
    const Value difference = here - behind;
    store(state[k] + UN_BEHIND * L, behind + alpha[k] * difference);
    g[k] = weight[k] * difference;
  }
  if (WANTED == COLOURS) return;
  if (rec[R_OPACITY] > ALPHA_MAX)  // no gradient through the clamp
    for (int k = 0; k < K; ++k) g[k] = keep(alpha[k] < one(ALPHA_MAX), g[k]);
#pragma GCC unroll 2
  for (int k = 0; k < K; ++k) {
    const Value gu = g[k] * e[k].u, gv = g[k] * e[k].v;
    sums[S_G] = sums[S_G] + g[k];
    sums[S_GU] = sums[S_GU] + gu;
    sums[S_GV] = sums[S_GV] + gv;
    sums[S_GUU] = sums[S_GUU] + gu * e[k].u;
    sums[S_GUV] = sums[S_GUV] + gu * e[k].v;
    sums[S_GVV] = sums[S_GVV] + gv * e[k].v;
    if (WANTED == MODULI) {
      sums[S_ABS_X] = sums[S_ABS_X] + absolute(gu);
      sums[S_ABS_Y] = sums[S_ABS_Y] + absolute(at<WIDTH>(rec, R_L12) * gu + at<WIDTH>(rec, R_L22) * gv);
    }
    if (WANTED == FRAGMENTS) {
      sums[S_SQUARES] = sums[S_SQUARES] + g[k] * g[k];
      sums[S_COUNT] = sums[S_COUNT] + keep(alpha[k] > one(0), one(1));
    }
  }
}

template <int S, int... I>
INLINE NF other_half(NF a, Lanes<I...>) {
  return __builtin_shufflevector(a, a, (I ^ S)...);
}

// Lane i of rows[0] becomes the sum of rows[i] over its lanes, for i in 0 to 2 S - 1; of rows that are not in
// `there`, bits of S, any number.
template <int S>
INLINE void totals(NF* rows, unsigned there) {
  typedef typename MakeLanes<WIDTH>::type Every;
#pragma GCC unroll 16
  for (int i = 0; i < S; ++i) {
    const bool low = there >> i & 1, high = there >> (i + S) & 1;
    if (low && high) {
      exchange<S>(rows[i], rows[i + S], Every());
      rows[i] = rows[i] + rows[i + S];
    } else if (low || high) {
      const NF a = low ? rows[i] : rows[i + S];
      rows[i] = a + other_half<S>(a, Every());
    }
  }
  if constexpr (S > 1) totals<S / 2>(rows, there | there >> S);
}

// The row of a Gaussian's sums over all lanes.
template <unsigned THERE, int SUMS>
INLINE void store_sums(const V<float, WIDTH> (&sums)[SUMS], float* row) {
  float kept[L];
  for (int j = 0; j < L; ++j) kept[j] = THERE >> j & 1 ? 1 : 0;
#pragma GCC unroll 4
  for (int first = 0; first < L; first += WIDTH) {
    const unsigned there = THERE >> first & ((1u << WIDTH) - 1);
    NF rows[WIDTH] = {};
#pragma GCC unroll 16
    for (int j = 0; j < WIDTH; ++j)
      if (there >> j & 1) rows[j] = sums[first + j].v;
    if (there) totals<WIDTH / 2>(rows, there);
    V<float, WIDTH> out = {rows[0]};
    store(row + first, select(read<float, WIDTH>(kept + first) > broadcast<float, WIDTH>(0), out, broadcast<float, WIDTH>(0)));
  }
}

constexpr uint32_t ROWS_AHEAD = 8;  // rows of sums that are fetched before they are written

// Few channels and nothing else: Gaussian by Gaussian, last to first, over the blocks that it is drawn in, with
// transmittances from those that the forward pass left. Each row is written once.
template <int CHANNELS, Wanted WANTED>
STAGE void backward_colour(const Tiles& tiles, const PictureGradients& in, const Scratch& scratch, int tile, const SumRows& sums) {
  constexpr int FEATURES = CHANNELS, UNDRAWN = UN_BY + CHANNELS, SUMS = S_FEATURES + CHANNELS;
  static_assert(SUMS <= L, "a row of sums");
  const int left = tile % tiles.across * TILE, top = tile / tiles.across * TILE;
  const int stride = rec_stride(FEATURES);
  const uint32_t first = tiles.start[tile], total = tiles.start[tile + 1] - first, count = tiles.processed[tile];
  const Entry* entries = tiles.entries + first;
  clear_rows(sums, entries + count, entries + total);
  if (count == 0) return;
  const Centres centres;
  for (int b = 0; b < BLOCKS; ++b) {
    if (left + (b % 4) * BLOCK >= tiles.width || top + (b / 4) * BLOCK >= tiles.height) continue;
    PixelGradients pixel;
    read_block(tiles, in, FEATURES, left, top, b, pixel);
    float* state = scratch.state + b * UNDRAWN * L;
    const float* trace = tiles.trace + ((size_t)tile * BLOCKS + b) * TRACE * L;
    store(state + UN_LEFT * L, load(trace + TR_LEFT * L));
    store(state + UN_BEHIND * L, load(pixel.left));
    for (int c = 0; c < CHANNELS; ++c) store(state + (UN_BY + c) * L, load(pixel.feature[c]));
    store(state + UN_LAST * L, load(trace + TR_LAST * L));
    const Pixels<L> pixels = pixels_of<L>(centres, b, 0);
    store(state + UN_X * L, pixels.x);
    store(state + UN_Y * L, pixels.y);
  }
  for (uint32_t begin = (count - 1) / CHUNK * CHUNK;; begin -= CHUNK) {
    const int here = count - begin < (uint32_t)CHUNK ? (int)(count - begin) : CHUNK;
    prepare<false>(tiles, scratch, FEATURES, left, top, first, begin, here, nullptr);
    for (int k = here - 1; k >= 0; --k) {
      const float* rec = scratch.recs + (size_t)k * stride;
      if (begin + k >= ROWS_AHEAD) __builtin_prefetch(sums.of(entries[begin + k - ROWS_AHEAD]), 1);
      V<float, WIDTH> total_of[SUMS];
      for (int j = 0; j < SUMS; ++j) total_of[j] = broadcast<float, WIDTH>(0);
      for (unsigned in_blocks = tiles.blocks[first + begin + k]; in_blocks;) {
        const int b = __builtin_ctz(in_blocks);
        in_blocks &= in_blocks - 1;
        float* const state = scratch.state + b * UNDRAWN * L;
        if constexpr (WIDTH == L) {
          const int c = in_blocks ? __builtin_ctz(in_blocks) : b;
          if (c != b) {
            in_blocks &= in_blocks - 1;
            undraw<2, CHANNELS, WANTED>(rec, {state, scratch.state + c * UNDRAWN * L}, total_of);
          } else undraw<1, CHANNELS, WANTED>(rec, {state}, total_of);
        } else {
          for (int part = 0; part < L; part += 2 * WIDTH)
            undraw<2, CHANNELS, WANTED>(rec, {state + part, state + part + WIDTH}, total_of);
        }
      }
      store_sums<sums_of(CHANNELS, WANTED)>(total_of, sums.of(entries[begin + k]));
    }
    if (begin == 0) break;
  }
}

template <int CHANNELS>
INLINE void backward_colours(const Tiles& tiles, const PictureGradients& in, const Scratch& scratch, int tile, const SumRows& sums) {
  if (in.fragments) backward_colour<CHANNELS, FRAGMENTS>(tiles, in, scratch, tile, sums);
  else if (in.moduli) backward_colour<CHANNELS, MODULI>(tiles, in, scratch, tile, sums);
  else if (in.shapes) backward_colour<CHANNELS, SHAPES>(tiles, in, scratch, tile, sums);
  else backward_colour<CHANNELS, COLOURS>(tiles, in, scratch, tile, sums);
}

void backward_tile(const Tiles& tiles, const PictureGradients& in, const Scratch& scratch, int features, int tile,
                   const SumRows& sums) {
  switch (features == in.channels ? features : 0) {
    case 1: return backward_colours<1>(tiles, in, scratch, tile, sums);  // a distance
    case 3: return backward_colours<3>(tiles, in, scratch, tile, sums);
    case 6: return backward_colours<6>(tiles, in, scratch, tile, sums);  // two pictures
    default: backward_any(tiles, in, scratch, features, tile, sums);
  }
}

}  // namespace
