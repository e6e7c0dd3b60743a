// sin and cos of sixteen floats.

namespace {

// Takes x to within a quarter of pi of a multiple of pi / 2: rest and the multiple, modulo 4, as -2 to 2.
INLINE void quarter(const float* x, float* rest, float* turns) {
  for (int half = 0; half < LANES; half += HALF) {
    const vd value = widen<HALF>(x + half);
    const double shift = 6755399441055744.0;  // 1.5 * 2^52: what is added to it is rounded to an integer
    const vd whole = (value * 0.63661977236758134) + shift - shift;
    narrow<HALF>(rest + half, value - whole * 1.5707963267948966 - whole * 6.123233995736766e-17);
    narrow<HALF>(turns + half, whole - ((whole * 0.25) + shift - shift) * 4.0);
  }
}

// Errors below 2e-7 for |x| < 1e9; polynomials are those of Cephes (Moshier), for |rest| <= pi / 4.
INLINE void sine_cosine(vf x, vf& sine, vf& cosine) {
  alignas(64) float in[LANES], rest[LANES], turns[LANES];
  store(in, x);
  quarter(in, rest, turns);
  const vf r = load(rest), n = load(turns), square = r * r;
  const vf s = r + r * square * (all(-1.6666654611e-1f) + square * (all(8.3321608736e-3f) + square * all(-1.9515295891e-4f)));
  const vf c = all(1) - all(0.5f) * square +
               square * square * (all(4.166664568298827e-2f) + square * (all(-1.388731625493765e-3f) + square * all(2.443315711809948e-5f)));
  const mask before = n < all(-0.5f), after = n > all(0.5f), far_before = n < all(-1.5f), far_after = n > all(1.5f);
  const vf one = select(far_before, s, select(far_after, s, select(before, c, select(after, c, s))));
  const vf other = select(far_before, c, select(far_after, c, select(before, s, select(after, s, c))));
  sine = select(before, all(0) - one, select(far_after, all(0) - one, one));
  cosine = select(after, all(0) - other, select(far_before, all(0) - other, other));
}

}  // namespace
