// The tiles that supports touch, exactly but for a rounding margin, sixteen Gaussians at a time. Within a row of
// tiles a support covers an interval of x, because it is convex.

namespace {

INLINE vf floor_quotient(vf x, float divisor) {  // floor(x / divisor) for a power of two
  const vf q = x * all(1 / divisor);
  float in[L], out[L];
  store(in, q);
  for (int l = 0; l < L; ++l) out[l] = __builtin_floorf(in[l]);
  return load(out);
}

INLINE void gather_geo(const float* geo, int64_t first, int count, float g[GEO][L]) {
  transpose_rows([=](int r) { return geo + (size_t)(first + (r < count ? r : count - 1)) * GEO; }, g[0], L);
}

// The rows of tiles of each Gaussian, none of those that are not drawn, whose ellipses may hold anything.
void footprints(const float* geo, const uint8_t* drawn, int down, Footprint* out, int64_t first, int64_t last) {
  for (int64_t i = first; i < last; i += L) {
    const int count = last - i < L ? (int)(last - i) : L;
    alignas(64) float g[GEO][L], from[L], to[L];
    gather_geo(geo, i, count, g);
    const vf y = load(g[Y_WHOLE]) + load(g[Y_PART]), half = wider_half(g), end = all((float)(down - 1));
    store(from, maximum(floor_quotient(y - half - all(0.5f), TILE), all(0)));
    store(to, minimum(floor_quotient(y + half - all(0.5f), TILE), end));
    for (int l = 0; l < count; ++l) {
      const bool seen = drawn[i + l] && to[l] >= from[l];
      out[i + l] = {(uint16_t)(seen ? from[l] : 0), (uint16_t)(seen ? to[l] - from[l] + 1 : 0)};
    }
  }
}

void spans(const float* geo, const Footprint* footprint, const uint32_t* span_start, int across, float reach,
           Span* out, uint32_t* touched, int64_t first, int64_t last) {
  for (int64_t i = first; i < last; i += L) {
    const int count = last - i < L ? (int)(last - i) : L;
    int most = 0;
    float top[L];
    for (int l = 0; l < L; ++l) {
      const Footprint f = footprint[i + (l < count ? l : count - 1)];
      most = f.rows > most ? f.rows : most;
      top[l] = (float)(f.first_row * TILE);
    }
    uint32_t tiles[L] = {};
    alignas(64) float g[GEO][L], from[L], to[L];
    gather_geo(geo, i, count, g);
    const vf mx = load(g[X_WHOLE]) + load(g[X_PART]), reach2 = wider_reach(g, reach), corner = load(top);
    for (int row = 0; row < most; ++row) {
      const vf d0 = ((corner + all(row * TILE + 0.5f)) - load(g[Y_WHOLE])) - load(g[Y_PART]);
      vf x0, x1;
      span(g, reach2, d0, d0 + all(TILE - 1), x0, x1);
      // tile c holds the centres 16c + 0.5 to 16c + 15.5
      store(from, minimum(maximum(floor_quotient(x0 + mx + all(0.499f), TILE), all(0)), all((float)across)));
      store(to, maximum(minimum(floor_quotient(x1 + mx - all(0.5f), TILE), all((float)(across - 1))), all(-1)));
      for (int l = 0; l < count; ++l) {
        if (row >= footprint[i + l].rows) continue;
        out[span_start[i + l] + row] = {(int16_t)from[l], (int16_t)to[l]};
        tiles[l] += to[l] >= from[l] ? (uint32_t)(to[l] - from[l]) + 1 : 0;
      }
    }
    for (int l = 0; l < count; ++l) touched[i + l] = tiles[l];
  }
}

}  // namespace
