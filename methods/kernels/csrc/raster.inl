// Blending of one tile: its Gaussians are prepared in chunks, its sixteen 4x4 blocks drawn one by one.

namespace {

INLINE void prefetch(const Tiles& tiles, uint32_t id) {
  __builtin_prefetch(tiles.geo + (size_t)id * GEO);
  __builtin_prefetch(tiles.features + (size_t)id * tiles.stride);
}

// The interval of x, relative to `mx`, that a support covers between dy = d0 and dy = d1 relative to its mean;
// a little more, so that rounding never cuts a contribution off.
INLINE void span(const float (*g)[L], vf reach2, vf d0, vf d1, vf& from, vf& to) {
  const vf tip = load(g[TIP]), slope = load(g[SLOPE]), l22 = load(g[L22]), zero = all(0);
  const vf right = minimum(maximum(tip, d0), d1), left = minimum(maximum(zero - tip, d0), d1);
  const vf vr = l22 * right, vl = l22 * left, inv = load(g[INV_L11]);
  const vf slack = all(1e-3f) + all(1e-6f) * absolute(slope) * (absolute(right) + absolute(left));
  to = square_root(maximum(reach2 - vr * vr, zero)) * inv - slope * right + slack;
  from = zero - square_root(maximum(reach2 - vl * vl, zero)) * inv - slope * left - slack;
}

INLINE vf wider_reach(const float (*g)[L]) { return load(g[LIMIT]) * all(1.0001f) + all(1e-4f); }
INLINE vf wider_half(const float (*g)[L]) { return load(g[HALF_Y]) * all(1.0001f) + all(1e-3f); }

// Fill recs for entries [first, first + count) of a tile whose corner is (left, top), and list, for each
// block, the entries whose support may meet its pixel centres.
STAGE void prepare(const Tiles& tiles, const Scratch& scratch, int features, int left, int top, uint32_t first,
                   int count, size_t capacity, int lengths[BLOCKS]) {
  const int stride = rec_stride(features);
  const uint32_t* ids = tiles.entries + first;
  for (int b = 0; b < BLOCKS; ++b) lengths[b] = 0;
  for (int k = 0; k < count && k < L; ++k) prefetch(tiles, ids[k]);
  for (int k = 0; k < count; k += L) {
    alignas(64) float g[GEO][L], rec[L][L];
    const int n = count - k < L ? count - k : L;
    for (int l = k + L; l < k + 2 * L && l < count; ++l) prefetch(tiles, ids[l]);
    transpose_rows([=](int r) { return tiles.geo + (size_t)ids[k + (r < n ? r : 0)] * GEO; }, g[0], L);
    // mean relative to the tile's corner
    const vf mx = (load(g[X_WHOLE]) - all((float)left)) + load(g[X_PART]);
    const vf my = (load(g[Y_WHOLE]) - all((float)top)) + load(g[Y_PART]);
    store(rec[R_U0], all(0) - (load(g[L11]) * mx + load(g[L12]) * my));
    store(rec[R_V0], all(0) - load(g[L22]) * my);
    store(rec[R_L11], load(g[L11]));
    store(rec[R_L12], load(g[L12]));
    store(rec[R_L22], load(g[L22]));
    store(rec[R_OPACITY], load(g[OPACITY]));
    store(rec[R_LIMIT], load(g[LIMIT]));
    for (int j = R_UNUSED; j < L; ++j) store(rec[j], all(0));
    const vf reach2 = wider_reach(g), half = wider_half(g);
    const unsigned present = (1u << n) - 1;
    for (int row = 0; row < 4; ++row) {
      const vf d0 = all(BLOCK * row + 0.5f) - my, d1 = d0 + all(BLOCK - 1);
      vf from, to;
      span(g, reach2, d0, d1, from, to);
      const unsigned hit = bits((d1 >= all(0) - half) & (d0 <= half)) & present;
      from = from + mx;
      to = to + mx;
      for (int c = 0; c < 4; ++c) {  // the centres of this block are at 4c + 0.5 to 4c + 3.5
        const unsigned in = hit & bits((to >= all(BLOCK * c + 0.5f)) & (from <= all(BLOCK * c + 3.5f)));
        const int b = 4 * row + c;
        lengths[b] = append(scratch.lists + b * capacity, lengths[b], (uint32_t)k, in);
      }
    }
    float* recs = scratch.recs + (size_t)k * stride;  // room for 16 rows
    transpose(rec[0], L, recs, stride);
    for (int l = 0; l < n; ++l) {
      const float* f = tiles.features + (size_t)ids[k + l] * tiles.stride;
      for (int j = 0; j < features; ++j) recs[l * stride + R_FEATURES + j] = f[j];
    }
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
STAGE int blend(const float* recs, int stride, const uint32_t* list, int length, const Block& block, Light& light,
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
STAGE void blend_stored(const float* recs, int stride, const uint32_t* list, int length, const float* weights,
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

STAGE void write_block(const Tiles& tiles, const Pictures& out, Window tile, int b, const float* state) {
  for (int l = 0; l < L; ++l) {
    const int x = tile.left + (b % 4) * BLOCK + l % BLOCK, y = tile.top + (b / 4) * BLOCK + l / BLOCK;
    if (x >= tiles.width || y >= tiles.height) continue;
    const size_t pixel = (size_t)y * tiles.width + x;
    const float left = state[ST_LEFT * L + l], sum = state[ST_SUM * L + l];
    const float* f = state + ST_FEATURES * L + l;
    const float scale = sum > 0 ? 1 / sum : 0;
    for (int c = 0; c < out.channels; ++c)
      out.colour[pixel * out.channels + c] = f[c * L] + (out.background ? left * out.background[c] : 0);
    if (out.alpha) out.alpha[pixel] = sum;
    if (out.left) out.left[pixel] = left;
    if (out.depth) out.depth[pixel] = f[out.channels * L] * scale;
    if (out.distance) out.distance[pixel] = f[(out.channels + 1) * L] * scale;
    if (out.median) out.median[pixel] = state[ST_MEDIAN * L + l];
  }
}

void render_tile(const Tiles& tiles, const Pictures& out, const Scratch& scratch, int tile) {
  const Window window = {tile % tiles.across * TILE, tile / tiles.across * TILE};
  const int features = features_of(out), stride = rec_stride(features);
  const bool stored = (features != 3 && features != 4) || out.median || out.contributors;
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
    int lengths[BLOCKS];
    prepare(tiles, scratch, features, window.left, window.top, first + done, count, CHUNK + L, lengths);
    busy = false;
    for (int b = 0; b < BLOCKS; ++b) {
      if (full[b]) continue;
      const uint32_t* list = scratch.lists + (size_t)b * (CHUNK + L);
      float* state = scratch.state + (size_t)b * rows * L;
      const Block block = block_pixels(b);
      Light light = {load(state + ST_ALL * L), load(state + ST_LEFT * L), load(state + ST_SUM * L)};
      const vf sum_before = light.sum;
      int looked;
      if (!stored) {
        vf sums[4];
        for (int f = 0; f < 4; ++f) sums[f] = load(state + (ST_FEATURES + f) * L);
        const auto draw = features == 3 ? blend<3, false> : blend<4, false>;
        looked = draw(scratch.recs, stride, list, lengths[b], block, light, sums, nullptr);
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
