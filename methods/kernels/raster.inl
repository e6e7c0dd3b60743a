// Blending of one tile: its Gaussians are prepared in chunks, its sixteen 4x4 blocks drawn one by one.

namespace {

INLINE void prefetch_geo(const Tiles& tiles, uint32_t id) {
  __builtin_prefetch(tiles.geo + (size_t)id * GEO);
  __builtin_prefetch(tiles.features + (size_t)id * tiles.stride);
}

// Fill recs and masks for entries [first, first + count) of a tile whose corner is (left, top).
// Bit 4 * row + column of a mask is set where the support may meet the pixel centres of that block.
INLINE void prepare(const Tiles& tiles, const Scratch& scratch, int features, int left, int top, uint32_t first,
                    int count) {
  const int stride = rec_stride(features);
  const uint32_t* ids = tiles.entries + first;
  for (int k = 0; k < count; k += L) {
    alignas(64) float rows[L][GEO], g[GEO][L], rec[8][L];
    alignas(64) int masks[L] = {};
    for (int l = 0; l < L; ++l) {
      const uint32_t id = ids[k + l < count ? k + l : count - 1];
      if (k + l + 8 < count) prefetch_geo(tiles, ids[k + l + 8]);
      __builtin_memcpy(rows[l], tiles.geo + (size_t)id * GEO, sizeof rows[l]);
    }
    transpose(rows[0], GEO, g[0], L);
    for (int l = 0; l < L; ++l) {
      // mean relative to the tile's corner
      const float mx = (g[X_WHOLE][l] - left) + g[X_PART][l], my = (g[Y_WHOLE][l] - top) + g[Y_PART][l];
      rec[R_U0][l] = -(g[L11][l] * mx + g[L12][l] * my);
      rec[R_V0][l] = -(g[L22][l] * my);
      rec[R_L11][l] = g[L11][l];
      rec[R_L12][l] = g[L12][l];
      rec[R_L22][l] = g[L22][l];
      rec[R_OPACITY][l] = g[OPACITY][l];
      rec[R_LIMIT][l] = g[LIMIT][l];
      rec[R_UNUSED][l] = 0;
      // a little more than the support, so that rounding never cuts a contribution off
      const float reach2 = g[LIMIT][l] * 1.0001f + 1e-4f, top_half = g[HALF_Y][l] * 1.0001f + 1e-3f;
      for (int row = 0; row < 4; ++row) {
        const float d0 = BLOCK * row + 0.5f - my, d1 = d0 + (BLOCK - 1);
        const float tip = g[TIP][l], slope = g[SLOPE][l];
        float right = tip < d0 ? d0 : tip, lefty = -tip < d0 ? d0 : -tip;
        right = right > d1 ? d1 : right;
        lefty = lefty > d1 ? d1 : lefty;
        const float vr = g[L22][l] * right, vl = g[L22][l] * lefty;
        const float rr = reach2 - vr * vr, rl = reach2 - vl * vl;
        const float slack = 1e-3f + 1e-6f * (__builtin_fabsf(slope) * (__builtin_fabsf(right) + __builtin_fabsf(lefty)));
        const float x1 = mx - slope * right + __builtin_sqrtf(rr > 0 ? rr : 0) * g[INV_L11][l] + slack;
        const float x0 = mx - slope * lefty - __builtin_sqrtf(rl > 0 ? rl : 0) * g[INV_L11][l] - slack;
        // block column c covers pixel centres [4c + 0.5, 4c + 3.5]
        const bool hit = (d1 >= -top_half) & (d0 <= top_half);
        for (int c = 0; c < 4; ++c) {
          const bool in = hit & (x1 >= BLOCK * c + 0.5f) & (x0 <= BLOCK * c + 3.5f);
          masks[l] |= (int)in << (4 * row + c);
        }
      }
    }
    const int n = count - k < L ? count - k : L;
    alignas(64) float out[L][8];
    for (int l = 0; l < L; ++l)
      for (int j = 0; j < 8; ++j) out[l][j] = rec[j][l];
    for (int l = 0; l < n; ++l) {
      float* r = scratch.recs + (size_t)(k + l) * stride;
      __builtin_memcpy(r, out[l], sizeof out[l]);
      const float* f = tiles.features + (size_t)ids[k + l] * tiles.stride;
      for (int j = 0; j < features; ++j) r[R_FEATURES + j] = f[j];
      scratch.masks[k + l] = (uint16_t)masks[l];
    }
  }
}

// lists[b] = indices of the entries whose mask has bit b.
INLINE void make_lists(const uint16_t* masks, int count, uint32_t* lists, size_t capacity, int lengths[BLOCKS]) {
  for (int b = 0; b < BLOCKS; ++b) lengths[b] = 0;
  for (int k = 0; k < count; ++k)
    for (unsigned m = masks[k]; m; m &= m - 1) {
      const int b = __builtin_ctz(m);
      lists[b * capacity + lengths[b]++] = (uint32_t)k;
    }
}

struct Block {
  vf x, y;  // pixel centres relative to the tile's corner
};

INLINE Block block_pixels(int b) {
  float x[L], y[L];
  for (int l = 0; l < L; ++l) {
    x[l] = (b % 4) * BLOCK + l % BLOCK + 0.5f;
    y[l] = (b / 4) * BLOCK + l / BLOCK + 0.5f;
  }
  return {load(x), load(y)};
}

struct Light {
  vf all;   // product of all (1 - alpha): below T_MIN for good once a pixel is full
  vf left;  // the same of what was drawn: the transmittance
  vf sum;   // of the weights
};

struct Contribution {
  vf alpha, weight;  // zero where dropped
};

// One Gaussian over the pixels of a block. Returns false once every pixel is full.
INLINE bool contribute(const float* rec, const Block& block, Light& light, Contribution& c) {
  const vf u = all(rec[R_U0]) + block.x * all(rec[R_L11]) + block.y * all(rec[R_L12]);
  const vf v = all(rec[R_V0]) + block.y * all(rec[R_L22]);
  const vf s = u * u + v * v;
  vf alpha = minimum(all(rec[R_OPACITY]) * exp2_negative(s), all(ALPHA_MAX));
  alpha = keep(s <= all(rec[R_LIMIT]), alpha);  // alpha >= 1/255
  const vf before = light.all;
  light.all = before - alpha * before;
  const mask live = light.all >= all(T_MIN);
  c.alpha = keep(live, alpha);
  c.weight = c.alpha * before;
  light.left = select(live, light.all, light.left);
  return any(live);
}

// Weighted sums of N features of each listed Gaussian. Stops at the end of the list or when the block is full;
// returns how many entries were looked at.
template <int N, bool STORE>
INLINE int blend(const float* recs, int stride, const uint32_t* list, int length, const Block& block, Light& light,
                 vf* sums, float* weights) {
  Light now = light;
  vf acc[N ? N : 1];
  for (int f = 0; f < N; ++f) acc[f] = sums[f];
  int k = 0;
  for (; k < length; ++k) {
    const float* rec = recs + (size_t)list[k] * stride;
    Contribution c;
    const bool live = contribute(rec, block, now, c);
    now.sum = now.sum + c.weight;
    for (int f = 0; f < N; ++f) acc[f] = acc[f] + c.weight * all(rec[R_FEATURES + f]);
    if (STORE) store(weights + (size_t)k * L, c.weight);
    if (!live) { ++k; break; }
  }
  light = now;
  for (int f = 0; f < N; ++f) sums[f] = acc[f];
  return k;
}

// sums[f] += sum_k weights[k] feature f of list[k], for features [first, last) by fours.
INLINE void blend_stored(const float* recs, int stride, const uint32_t* list, int length, const float* weights,
                         int features, float* sums) {
  for (int f = 0; f < features; f += 4) {
    vf acc[4];
    for (int j = 0; j < 4; ++j) acc[j] = load(sums + (f + j) * L);
    for (int k = 0; k < length; ++k) {
      const vf w = load(weights + (size_t)k * L);
      const float* values = recs + (size_t)list[k] * stride + R_FEATURES + f;
      for (int j = 0; j < 4; ++j) acc[j] = acc[j] + w * all(values[j]);
    }
    for (int j = 0; j < 4; ++j) store(sums + (f + j) * L, acc[j]);
  }
}

// Indices into a block's state: light, then feature sums, then the median depth.
enum State { ST_ALL, ST_LEFT, ST_SUM, ST_MEDIAN, ST_FEATURES };

// z of the first contribution by which the weights sum to a half or more.
INLINE void find_median(const float* recs, int stride, const uint32_t* list, int length, const float* weights,
                        vf sum, int depth, float* median) {
  float total[L];
  store(total, sum);
  for (int k = 0; k < length; ++k)
    for (int l = 0; l < L; ++l) {
      const float after = total[l] + weights[k * L + l];
      if (total[l] < 0.5f && after >= 0.5f) median[l] = recs[(size_t)list[k] * stride + R_FEATURES + depth];
      total[l] = after;
    }
}

// Keep the strongest contributions of each pixel, strongest first, ties nearest first.
INLINE void rank(const Pictures& out, size_t pixel, float weight, uint32_t id) {
  const int n = out.contributors;
  float* w = out.weights + pixel * n;
  int64_t* ids = out.ids + pixel * n;
  if (!(weight > w[n - 1])) return;
  int j = n - 1;
  for (; j > 0 && weight > w[j - 1]; --j) {
    w[j] = w[j - 1];
    ids[j] = ids[j - 1];
  }
  w[j] = weight;
  ids[j] = id;
}

struct Window {
  int left, top;
};

INLINE void write_block(const Tiles& tiles, const Pictures& out, Window tile, int b, const float* state) {
  for (int l = 0; l < L; ++l) {
    const int x = tile.left + (b % 4) * BLOCK + l % BLOCK, y = tile.top + (b / 4) * BLOCK + l / BLOCK;
    if (x >= tiles.width || y >= tiles.height) continue;
    const size_t pixel = (size_t)y * tiles.width + x;
    const float left = state[ST_LEFT * L + l], sum = state[ST_SUM * L + l];
    const float* f = state + ST_FEATURES * L + l;
    const float scale = sum > 0 ? 1 / sum : 0;
    for (int c = 0; c < out.channels; ++c)
      out.colour[pixel * out.channels + c] = f[c * L] + (out.background ? left * out.background[c] : 0);
    out.alpha[pixel] = sum;
    if (out.left) out.left[pixel] = left;
    out.depth[pixel] = f[out.channels * L] * scale;
    if (out.distance) out.distance[pixel] = f[(out.channels + 1) * L] * scale;
    if (out.median) out.median[pixel] = state[ST_MEDIAN * L + l];
  }
}

void render_tile(const Tiles& tiles, const Pictures& out, const Scratch& scratch, int tile) {
  const Window window = {tile % tiles.across * TILE, tile / tiles.across * TILE};
  const int features = out.channels + (out.distance ? 2 : 1), stride = rec_stride(features);
  const bool stored = features != 4 || out.median || out.contributors;
  const int rows = ST_FEATURES + (features + 3) / 4 * 4;
  const uint32_t first = tiles.start[tile], total = tiles.start[tile + 1] - first;
  bool full[BLOCKS];
  for (int b = 0; b < BLOCKS; ++b) {
    float* state = scratch.state + (size_t)b * rows * L;
    for (int j = 0; j < rows * L; ++j) state[j] = 0;
    full[b] = true;
    for (int l = 0; l < L; ++l) {
      const int x = window.left + (b % 4) * BLOCK + l % BLOCK, y = window.top + (b / 4) * BLOCK + l / BLOCK;
      const bool inside = x < tiles.width && y < tiles.height;
      state[ST_ALL * L + l] = inside ? 1 : 0;  // pixels outside count as full
      state[ST_LEFT * L + l] = inside ? 1 : 0;
      full[b] &= !inside;
    }
  }
  uint32_t processed = 0;
  bool busy = true;
  for (uint32_t done = 0; busy && done < total; done += CHUNK) {
    const int count = total - done < (uint32_t)CHUNK ? (int)(total - done) : CHUNK;
    prepare(tiles, scratch, features, window.left, window.top, first + done, count);
    int lengths[BLOCKS];
    make_lists(scratch.masks, count, scratch.lists, CHUNK, lengths);
    busy = false;
    for (int b = 0; b < BLOCKS; ++b) {
      if (full[b]) continue;
      const uint32_t* list = scratch.lists + (size_t)b * CHUNK;
      float* state = scratch.state + (size_t)b * rows * L;
      const Block block = block_pixels(b);
      Light light = {load(state + ST_ALL * L), load(state + ST_LEFT * L), load(state + ST_SUM * L)};
      const vf sum_before = light.sum;
      int looked;
      if (!stored) {
        vf sums[4];
        for (int f = 0; f < 4; ++f) sums[f] = load(state + (ST_FEATURES + f) * L);
        looked = blend<4, false>(scratch.recs, stride, list, lengths[b], block, light, sums, nullptr);
        for (int f = 0; f < 4; ++f) store(state + (ST_FEATURES + f) * L, sums[f]);
      } else {
        looked = blend<0, true>(scratch.recs, stride, list, lengths[b], block, light, nullptr, scratch.weights);
        blend_stored(scratch.recs, stride, list, looked, scratch.weights, features, state + ST_FEATURES * L);
        if (out.median)
          find_median(scratch.recs, stride, list, looked, scratch.weights, sum_before, out.channels,
                      state + ST_MEDIAN * L);
        for (int k = 0; out.contributors && k < looked; ++k)
          for (int l = 0; l < L; ++l) {
            const float w = scratch.weights[k * L + l];
            if (w > 0)
              rank(out, (size_t)(window.top + (b / 4) * BLOCK + l / BLOCK) * tiles.width + window.left +
                            (b % 4) * BLOCK + l % BLOCK,
                   w, tiles.entries[first + done + list[k]]);
          }
      }
      store(state + ST_ALL * L, light.all);
      store(state + ST_LEFT * L, light.left);
      store(state + ST_SUM * L, light.sum);
      full[b] = !any(light.all >= all(T_MIN));
      busy |= !full[b];
      const uint32_t end = done + (full[b] && looked ? list[looked - 1] + 1 : count);
      processed = processed > end ? processed : end;
    }
  }
  tiles.processed[tile] = processed < total ? processed : total;
  for (int b = 0; b < BLOCKS; ++b)
    write_block(tiles, out, window, b, scratch.state + (size_t)b * rows * L);
}

}  // namespace
