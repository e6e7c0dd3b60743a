// Where the ellipses of sixteen Gaussians, as lanes, lie: exactly but for a rounding margin.

namespace {

// The interval of x, relative to `mx`, that a support covers between dy = d0 and dy = d1 relative to its mean;
// a little more, so that rounding never cuts a contribution off.
INLINE void span(const float (*g)[L], vf reach2, vf d0, vf d1, vf& from, vf& to) {
  const vf tip = load(g[TIP]), slope = load(g[L12]) * load(g[INV_L11]), l22 = load(g[L22]), zero = all(0);
  const vf right = minimum(maximum(tip, d0), d1), left = minimum(maximum(zero - tip, d0), d1);
  const vf vr = l22 * right, vl = l22 * left, inv = load(g[INV_L11]);
  const vf slack = all(1e-3f) + all(1e-6f) * absolute(slope) * (absolute(right) + absolute(left));
  to = square_root(maximum(reach2 - vr * vr, zero)) * inv - slope * right + slack;
  from = zero - square_root(maximum(reach2 - vl * vl, zero)) * inv - slope * left - slack;
}

INLINE vf wider_reach(const float (*g)[L], float reach) {
  return minimum(load(g[LOG_OPACITY]) - all(LEAST), all(reach)) * all(1.0001f) + all(1e-4f);
}
INLINE vf wider_half(const float (*g)[L]) { return load(g[HALF_Y]) * all(1.0001f) + all(1e-3f); }

// Which of a tile's blocks the supports of sixteen Gaussians may meet, in bits of met[l]: between a block's first row
// of pixel centres and its last, a support spans an interval of x. (mx, my): their means by the tile's corner.
INLINE void blocks_met(const float (*g)[L], float reach, vf mx, vf my, uint16_t* met) {
  const vf reach2 = wider_reach(g, reach), zero = all(0), l22 = load(g[L22]);
  vf sum = zero;  // of powers of two: a float holds sixteen of them
  for (int row = 0; row < 4; ++row) {
    const vf d0 = all(BLOCK * row + 0.5f) - my, d1 = all(BLOCK * row + 3.5f) - my;
    const vf v = l22 * minimum(maximum(zero, d0), d1);
    const mask some = reach2 >= v * v;
    vf from, to;
    span(g, reach2, d0, d1, from, to);
    from = from + mx;
    to = to + mx;
    for (int c = 0; c < 4; ++c)
      sum = sum + keep(some & (to >= all(BLOCK * c + 0.5f)) & (from <= all(BLOCK * c + 3.5f)),
                       all((float)(1 << (4 * row + c))));
  }
  float sums[L];
  store(sums, sum);
  for (int l = 0; l < L; ++l) met[l] = (uint16_t)(int32_t)sums[l];
}

}  // namespace
