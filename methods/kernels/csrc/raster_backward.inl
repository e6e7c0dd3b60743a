// Gradients of one tile. Per block: the contributions again, front to back; then back to front the gradient
// by each exponent; then, with sixteen Gaussians as lanes, sums over the pixels. Nothing is shared between
// tiles, so the result does not depend on threads.

namespace {

// Gradients of the sixteen pixels of a block.
struct PixelGradients {
  float feature[MAX_CHANNELS + 2][L];
  float centre[2][L];  // expected depth and distance: d depth / d weight = (z - depth) / sum of weights
  float residue[2][L];
  float left[L];       // by the final transmittance
  float median[L];
};

STAGE void read_block(const Tiles& tiles, const PictureGradients& in, int features, int left, int top, int b,
                       PixelGradients& out) {
  const int x0 = left + (b % 4) * BLOCK, y0 = top + (b / 4) * BLOCK;
  const bool only_colour = in.colour && in.channels == 3 && !in.alpha && !in.depth && !in.distance && !in.median;
  if (only_colour && x0 + BLOCK <= tiles.width && y0 + BLOCK <= tiles.height) {  // the usual case, without branches
    for (int j = 0; j < BLOCK; ++j) {
      const float* row = in.colour + ((size_t)(y0 + j) * tiles.width + x0) * 3;
      for (int i = 0; i < BLOCK; ++i)
        for (int c = 0; c < 3; ++c) out.feature[c][BLOCK * j + i] = row[3 * i + c];
    }
    vf by_left = all(0);
    for (int c = 0; c < 3 && in.background; ++c) by_left = by_left + load(out.feature[c]) * all(in.background[c]);
    store(out.left, by_left);
    return;
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

// The contributions of a block again. Returns how many entries were drawn.
STAGE int repeat(const float* recs, int stride, const uint32_t* list, int length, const Block& block, Light light,
                 float* weights, float* alphas) {
  for (int k = 0; k < length; ++k) {
    Contribution c;
    const bool live = contribute(recs + (size_t)list[k] * stride, block, light, c);
    store(alphas + (size_t)k * L, c.alpha);
    store(weights + (size_t)k * L, c.weight);
    if (!live) return k;  // this one contributes nothing
  }
  return length;
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

// Sums over the pixels of a block for sixteen listed Gaussians as lanes; rows are added to `sums`.
STAGE void reduce(const float* recs, int stride, const uint32_t* list, int count, int b, int features,
                   const PixelGradients& pixel, const float* weights, const float* gradients, float* sums,
                   int sums_stride) {
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
      float* row = sums + (size_t)list[l] * sums_stride + offset;
      store(row, load(row) + load(back[l]));
    }
    column = 0;
  }
}

// The median depth's gradient goes to the one Gaussian that it is the depth of.
INLINE void median_backward(const uint32_t* list, int length, const float* weights, const PixelGradients& pixel,
                            int depth, float* sums, int sums_stride) {
  for (int l = 0; l < L; ++l) {
    float total = 0;
    for (int k = 0; k < length; ++k) {
      const float after = total + weights[(size_t)k * L + l];
      if (total < 0.5f && after >= 0.5f) {
        sums[(size_t)list[k] * sums_stride + S_FEATURES + depth] += pixel.median[l];
        break;
      }
      total = after;
    }
  }
}

void backward_tile(const Tiles& tiles, const PictureGradients& in, const Scratch& scratch, int features, int tile,
                   float* sums, int sums_stride) {
  const int left = tile % tiles.across * TILE, top = tile / tiles.across * TILE;
  const int stride = rec_stride(features);
  const uint32_t first = tiles.start[tile], total = tiles.start[tile + 1] - first;
  const int count = (int)tiles.processed[tile];
  for (size_t j = 0; j < (size_t)total * sums_stride; ++j) sums[j] = 0;
  if (count == 0) return;
  int lengths[BLOCKS];
  const size_t capacity = (size_t)count + L;
  prepare(tiles, scratch, features, left, top, first, count, capacity, lengths);
  for (int b = 0; b < BLOCKS; ++b) {
    const int x = left + (b % 4) * BLOCK, y = top + (b / 4) * BLOCK;
    if (lengths[b] == 0 || x >= tiles.width || y >= tiles.height) continue;
    const uint32_t* list = scratch.lists + (size_t)b * capacity;
    PixelGradients pixel;
    read_block(tiles, in, features, left, top, b, pixel);
    const Block block = block_pixels(b);
    float ones[L];
    for (int l = 0; l < L; ++l)
      ones[l] = x + l % BLOCK < tiles.width && y + l / BLOCK < tiles.height ? 1 : 0;
    Light light = {load(ones), load(ones), all(0)};
    const int k = repeat(scratch.recs, stride, list, lengths[b], block, light, scratch.weights, scratch.alphas);
    if (in.median) median_backward(list, k, scratch.weights, pixel, in.channels, sums, sums_stride);
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
             scratch.weights + (size_t)j * L, scratch.alphas + (size_t)j * L, sums, sums_stride);
  }
}

}  // namespace
