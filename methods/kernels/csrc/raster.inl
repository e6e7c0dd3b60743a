// Blending of one tile: its Gaussians are prepared in chunks, its sixteen 4x4 blocks drawn one by one.

namespace {

INLINE bool in_line(const Tiles& tiles, int features) { return in_geo(tiles.coloured ? 3 : 0, features); }

INLINE void prefetch(const Tiles& tiles, uint32_t id, int features) {
  __builtin_prefetch(tiles.geo + (size_t)id * GEO);
  if (!in_line(tiles, features)) __builtin_prefetch(tiles.features + (size_t)id * tiles.stride);
}

INLINE void set_rank(float* rec, uint32_t rank) {
  const uint32_t mark = FIRST_RANK + rank;
  __builtin_memcpy(rec + R_RANK, &mark, sizeof mark);
}

// Fill the record of one Gaussian, the `rank`-th of the tile whose corner is (left, top).
INLINE void fill_record(const Tiles& tiles, uint32_t id, uint32_t rank, int features, float left, float top, float* rec) {
  const float* g = tiles.geo + (size_t)id * GEO;
  const float mx = (g[X_WHOLE] - left) + g[X_PART], my = (g[Y_WHOLE] - top) + g[Y_PART];
  if (in_line(tiles, features)) __builtin_memcpy(rec, g, GEO * sizeof(float));
  else {
    const float* f = tiles.features + (size_t)id * tiles.stride;
    __builtin_memcpy(rec, g, R_FEATURES * sizeof(float));
    for (int j = 0; j < features; j += 4) __builtin_memcpy(rec + R_FEATURES + j, f + j, 4 * sizeof(float));
  }
  rec[R_U0] = -(g[L11] * mx + g[L12] * my);
  rec[R_V0] = -g[L22] * my;
  set_rank(rec, rank);
}

constexpr int AHEAD = 48;  // Gaussians that are fetched before they are needed: about what a far cache takes

// Fill recs for the entries [begin, begin + count) of a tile's list, and, with MEET, note which blocks they meet;
// `met` has room for whole groups of LANES.
template <bool MEET>
STAGE void prepare(const Tiles& tiles, const Scratch& scratch, int features, int left, int top, uint32_t first,
                   uint32_t begin, int count, uint16_t* met) {
  const int stride = rec_stride(features);
  const Entry* entries = tiles.entries + first + begin;
  for (int k = 0; k < count && k < AHEAD; ++k) prefetch(tiles, entries[k].gaussian, features);
  for (int k = 0; k < count; k += L) {
    const int here = count - k < L ? count - k : L;
    for (int l = 0; l < here; ++l) {
      if (k + l + AHEAD < count) prefetch(tiles, entries[k + l + AHEAD].gaussian, features);
      fill_record(tiles, entries[k + l].gaussian, begin + (uint32_t)(k + l), features, (float)left, (float)top,
                  scratch.recs + (size_t)(k + l) * stride);
    }
    if (!MEET) continue;
    alignas(64) float g[GEO][L];
    transpose_rows([=](int r) { return tiles.geo + (size_t)entries[k + (r < here ? r : here - 1)].gaussian * GEO; }, g[0], L);
    blocks_met(g, tiles.reach, (load(g[X_WHOLE]) - all((float)left)) + load(g[X_PART]),
               (load(g[Y_WHOLE]) - all((float)top)) + load(g[Y_PART]), met + k);
  }
}

constexpr int STEPS = 4;  // Gaussians of a block that are worked on in step

// A record that contributes nothing anywhere, with the rank of the last one before it.
INLINE void nothing_at(float* rec, int stride, uint32_t rank) {
  for (int j = 0; j < stride; ++j) rec[j] = 0;
  rec[R_LOG_OPACITY] = -1e3f;
  set_rank(rec, rank);
}

// For each block, the entries that meet it in order, and room for STEPS more.
STAGE void list_blocks(const uint16_t* met, int count, unsigned wanted, const Scratch& scratch, size_t capacity,
                       int lengths[BLOCKS]) {
  for (int b = 0; b < BLOCKS; ++b) lengths[b] = 0;
#if defined(__AVX512F__)
  for (int k = 0; k < count; k += L) {
    uint16_t some[L] = {};
    for (int l = 0; l < L && k + l < count; ++l) some[l] = met[k + l];
    const __m512i masks = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i*)some));
    for (int b = 0; b < BLOCKS; ++b)
      if (wanted >> b & 1)
        lengths[b] = append(scratch.lists + b * capacity, lengths[b], (uint32_t)k,
                            _mm512_test_epi32_mask(masks, _mm512_set1_epi32(1 << b)));
  }
#else
  for (int k = 0; k < count; ++k)
    for (unsigned in = met[k] & wanted; in; in &= in - 1) {
      const int b = __builtin_ctz(in);
      scratch.lists[b * capacity + lengths[b]++] = (uint32_t)k;
    }
#endif
}

// Pixel centres of a tile's first column of blocks and of its first row, relative to the tile's corner.
struct Centres {
  alignas(64) float x[L], y[L];
  Centres() {
    for (int l = 0; l < L; ++l) {
      x[l] = l % BLOCK + 0.5f;
      y[l] = l / BLOCK + 0.5f;
    }
  }
};

template <int W>
struct Pixels {
  V<float, W> x, y;  // centres relative to the tile's corner
};
template <int W>
INLINE Pixels<W> pixels_of(const Centres& centres, int b, int part) {
  return {read<float, W>(centres.x + part) + broadcast<float, W>((float)(b % 4 * BLOCK)),
          read<float, W>(centres.y + part) + broadcast<float, W>((float)(b / 4 * BLOCK))};
}

// The state of W pixels while Gaussians are drawn over them.
template <int W>
struct Light {
  V<float, W> all;   // product of all (1 - alpha): below T_MIN for good once a pixel is full
  V<float, W> left;  // the same of what was drawn: the transmittance
  V<float, W> sum;   // of the weights
  V<float, W> last;  // rank of the last Gaussian that was drawn, or would have been had it been there
};

enum State { ST_ALL, ST_LEFT, ST_SUM, ST_LAST, ST_MEDIAN, ST_FEATURES };

template <int W>
INLINE Light<W> read_light(const float* state) {
  return {read<float, W>(state + ST_ALL * L), read<float, W>(state + ST_LEFT * L), read<float, W>(state + ST_SUM * L),
          read<float, W>(state + ST_LAST * L)};
}
template <int W>
INLINE void store_light(float* state, const Light<W>& light) {
  store(state + ST_ALL * L, light.all);
  store(state + ST_LEFT * L, light.left);
  store(state + ST_SUM * L, light.sum);
  store(state + ST_LAST * L, light.last);
}

template <int W>
INLINE V<float, W> at(const float* rec, int j) { return broadcast<float, W>(rec[j]); }

// log2(alpha) before cap and cut, and the u and v that it is made of.
template <int W>
struct Exponent {
  V<float, W> u, v, t;
};
template <int W>
INLINE Exponent<W> exponent(const float* rec, const Pixels<W>& p) {
  const V<float, W> u = at<W>(rec, R_U0) + p.x * at<W>(rec, R_L11) + p.y * at<W>(rec, R_L12);
  const V<float, W> v = at<W>(rec, R_V0) + p.y * at<W>(rec, R_L22);
  return {u, v, at<W>(rec, R_LOG_OPACITY) - u * u - v * v};
}

// Draw the listed Gaussians over W pixels, STEPS at a time: weighted sums of N features of each; with KEEP, alpha
// and weight of each, zero where it is dropped, go into rows of LANES. A record without any alpha must follow the
// list's last one, at `nothing`. It ends where less light than `stop` is left of every pixel. Returns how many
// entries were looked at: all, or enough for that.
template <int W, int N, bool SUM, bool KEEP>
STAGE int blend(const float* recs, int stride, uint32_t* list, int length, uint32_t nothing, float stop,
                const Pixels<W>& pixels, Light<W>& light, float* sums, float* weights, float* alphas) {
  typedef V<float, W> Value;
  Light<W> now = light;
  Value acc[N ? N : 1];
  for (int f = 0; f < N; ++f) acc[f] = read<float, W>(sums + f * L);
  for (int j = 0; j < STEPS; ++j) list[length + j] = nothing;
  int k = 0;
  while (k < length) {
    const float* rec[STEPS];
    Value alpha[STEPS], t[STEPS];
#pragma GCC unroll 4
    for (int j = 0; j < STEPS; ++j) {
      rec[j] = recs + (size_t)list[k + j] * stride;
      alpha[j] = t[j] = exponent<W>(rec[j], pixels).t;
    }
    exp2_of(alpha);
#pragma GCC unroll 4
    for (int j = 0; j < STEPS; ++j) {
      alpha[j] = keep(t[j] >= broadcast<float, W>(LEAST), minimum(alpha[j], broadcast<float, W>(ALPHA_MAX)));
      const Value before = now.all;
      now.all = before - alpha[j] * before;
      const M<float, W> live = now.all >= broadcast<float, W>(T_MIN);
      const Value weight = keep(live, alpha[j] * before);
      now.left = select(live, now.all, now.left);
      now.last = select(live, at<W>(rec[j], R_RANK), now.last);
      if (SUM) now.sum = now.sum + weight;
      for (int f = 0; f < N; ++f) acc[f] = acc[f] + weight * at<W>(rec[j], R_FEATURES + f);
      if (KEEP) {
        store(weights + (size_t)(k + j) * L, weight);
        store(alphas + (size_t)(k + j) * L, keep(live, alpha[j]));
      }
    }
    k += STEPS;
    if (!any(now.all >= broadcast<float, W>(stop))) {
      now.all = broadcast<float, W>(0);  // full, also for the other registers of the block that may go on
      break;
    }
  }
  light = now;
  for (int f = 0; f < N; ++f) store(sums + f * L, acc[f]);
  return k < length ? k : length;
}

// The same for a block, whose pixels are drawn register by register: their state stays in registers so.
template <int N, bool SUM>
INLINE int blend_block(const float* recs, int stride, uint32_t* list, int length, uint32_t nothing, float stop,
                       const Centres& centres, int b, float* state) {
  int looked = 0;
  for (int part = 0; part < L; part += WIDTH) {
    Light<WIDTH> light = read_light<WIDTH>(state + part);
    const int here = blend<WIDTH, N, SUM, false>(recs, stride, list, length, nothing, stop,
                                                 pixels_of<WIDTH>(centres, b, part), light,
                                                 state + ST_FEATURES * L + part, nullptr, nullptr);
    store_light(state + part, light);
    looked = here > looked ? here : looked;
  }
  return looked;
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

// A block's values into a picture of one number a pixel, where there is one.
INLINE void write_plane(float* plane, int width, int x, int y, vf values) {
  if (!plane) return;
  alignas(64) float v[L];
  store(v, values);
  for (int j = 0; j < BLOCK; ++j) __builtin_memcpy(plane + (size_t)(y + j) * width + x, v + BLOCK * j, BLOCK * sizeof *v);
}

// A block within a picture of three channels: the usual case, without branches by pixel.
INLINE void write_within(const Tiles& tiles, const Pictures& out, int x, int y, const float* state) {
  const vf left = load(state + ST_LEFT * L), sum = load(state + ST_SUM * L);
  alignas(64) float colours[3][L], rows[3 * L];
  for (int c = 0; c < 3; ++c)
    store(colours[c], load(state + (ST_FEATURES + c) * L) + left * all(out.background ? out.background[c] : 0));
  join_columns<3>(colours, rows);
  for (int j = 0; j < BLOCK; ++j)
    __builtin_memcpy(out.colour + ((size_t)(y + j) * tiles.width + x) * 3, rows + 3 * BLOCK * j, 3 * BLOCK * sizeof *rows);
  write_plane(out.alpha, tiles.width, x, y, sum);
  write_plane(out.left, tiles.width, x, y, left);
  if (out.median) write_plane(out.median, tiles.width, x, y, load(state + ST_MEDIAN * L));
  if (!out.depth && !out.distance) return;
  const vf scale = keep(sum > all(0), all(1) / sum);
  write_plane(out.depth, tiles.width, x, y, load(state + (ST_FEATURES + 3) * L) * scale);
  if (out.distance) write_plane(out.distance, tiles.width, x, y, load(state + (ST_FEATURES + 4) * L) * scale);
}

STAGE void write_block(const Tiles& tiles, const Pictures& out, Window tile, int b, const float* state) {
  const int x0 = tile.left + (b % 4) * BLOCK, y0 = tile.top + (b / 4) * BLOCK;
  if (out.channels == 3 && x0 + BLOCK <= tiles.width && y0 + BLOCK <= tiles.height)
    return write_within(tiles, out, x0, y0, state);
  for (int l = 0; l < L; ++l) {
    const int x = x0 + l % BLOCK, y = y0 + l / BLOCK;
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

// Ask for the lines of the picture that a tile will be written to, before it is drawn.
INLINE void expect_colours(const Tiles& tiles, const Pictures& out, Window tile) {
  const int down = tiles.height - tile.top < TILE ? tiles.height - tile.top : TILE;
  const int across = (tiles.width - tile.left < TILE ? tiles.width - tile.left : TILE) * out.channels;
  for (int j = 0; j < down; ++j) {
    const float* row = out.colour + ((size_t)(tile.top + j) * tiles.width + tile.left) * out.channels;
    for (int i = 0; i < across; i += L) __builtin_prefetch(row + i, 1);
  }
}

// With AGAIN the picture's Gaussians have been drawn before: which blocks they meet stands in `tiles`, and stays.
template <bool AGAIN>
void render_tile(const Tiles& tiles, const Pictures& out, const Scratch& scratch, int tile) {
  const Window window = {tile % tiles.across * TILE, tile / tiles.across * TILE};
  const int features = features_of(out), stride = rec_stride(features);
  const bool stored = (features != 3 && features != 4) || (features == 3 && out.alpha) || out.median || out.contributors;
  const int rows = ST_FEATURES + (features + 3) / 4 * 4;
  const uint32_t first = tiles.start[tile], total = AGAIN ? tiles.processed[tile] : tiles.start[tile + 1] - first;
  const Centres centres;
  expect_colours(tiles, out, window);
  unsigned open = 0;  // blocks that have a pixel which is not full
  for (int b = 0; b < BLOCKS; ++b) {
    float* state = scratch.state + (size_t)b * rows * L;
    for (int j = 0; j < rows * L; ++j) state[j] = 0;
    for (int l = 0; l < L; ++l) {
      const int x = window.left + (b % 4) * BLOCK + l % BLOCK, y = window.top + (b / 4) * BLOCK + l / BLOCK;
      const bool inside = x < tiles.width && y < tiles.height;
      state[ST_ALL * L + l] = state[ST_LEFT * L + l] = inside ? 1 : 0;  // pixels outside count as full
      open |= (unsigned)inside << b;
    }
  }
  uint32_t processed = 0;
  constexpr size_t CAPACITY = CHUNK + L;
  for (uint32_t done = 0; open && done < total; done += CHUNK) {
    const int count = total - done < (uint32_t)CHUNK ? (int)(total - done) : CHUNK;
    int lengths[BLOCKS];
    uint16_t met[CHUNK];  // whole groups of LANES
    prepare<!AGAIN>(tiles, scratch, features, window.left, window.top, first, done, count, met);
    if (AGAIN) __builtin_memcpy(met, tiles.blocks + first + done, count * sizeof *met);
    nothing_at(scratch.recs + (size_t)count * stride, stride, done + (uint32_t)count - 1);
    const unsigned before = open;
    list_blocks(met, count, before, scratch, CAPACITY, lengths);
    for (int k = 0; k < count; ++k) met[k] &= (uint16_t)before;
    for (int b = 0; b < BLOCKS; ++b) {
      if (!(before >> b & 1)) continue;
      uint32_t* list = scratch.lists + (size_t)b * CAPACITY;
      float* state = scratch.state + (size_t)b * rows * L;
      int looked;
      if (!stored) {
        const auto draw = features == 3 ? blend_block<3, false> : blend_block<4, true>;
        looked = draw(scratch.recs, stride, list, lengths[b], (uint32_t)count, tiles.stop, centres, b, state);
      } else {
        Light<L> light = read_light<L>(state);
        const vf sum_before = light.sum;
        looked = blend<L, 0, true, true>(scratch.recs, stride, list, lengths[b], (uint32_t)count,
                                         tiles.stop, pixels_of<L>(centres, b, 0), light, nullptr, scratch.weights,
                                         scratch.alphas);
        store_light(state, light);
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
                   w, tiles.entries[first + done + list[k]].gaussian);
          }
      }
      uint32_t end = done + count;
      if (!any(load(state + ST_ALL * L) >= all(tiles.stop))) {
        open &= ~(1u << b);
        end = done + (looked ? list[looked - 1] + 1 : 0);
        for (int k = looked; k < lengths[b]; ++k) met[list[k]] &= (uint16_t)~(1u << b);
      }
      processed = processed > end ? processed : end;
    }
    if (!AGAIN && tiles.blocks) __builtin_memcpy(tiles.blocks + first + done, met, count * sizeof *met);
  }
  if (!AGAIN) tiles.processed[tile] = processed < total ? processed : total;
  for (int b = 0; b < BLOCKS; ++b) {
    const float* state = scratch.state + (size_t)b * rows * L;
    write_block(tiles, out, window, b, state);
    if (AGAIN || !tiles.trace) continue;
    float* trace = tiles.trace + ((size_t)tile * BLOCKS + b) * TRACE * L;
    store(trace + TR_LEFT * L, load(state + ST_LEFT * L));
    store(trace + TR_LAST * L, load(state + ST_LAST * L));
  }
}

}  // namespace
