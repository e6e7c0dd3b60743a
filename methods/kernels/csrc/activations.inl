// exp, sigmoid and tanh of sixteen floats, for any argument; NaN stays NaN. Polynomials are minimax fits of ours.

namespace {

// e^x with a relative error below 2e-7; overflows to infinity, and to 0 through denormal numbers.
template <int N>
INLINE V<float, N> exponential(V<float, N> x) {
  if constexpr (leaf<float, N>) {
    // comparisons are false for NaN, which so passes through
    const NF low = x.v < -104.0f ? NF{} - 104.0f : x.v, t = low > 89.0f ? NF{} + 89.0f : low;
    const NF shifted = t * 1.44269504f + 12582912.0f;  // 1.5 * 2^23: the low bits now hold the nearest integer
    const NF whole = shifted - 12582912.0f;
    const NF r = (t - whole * 0.693145752f) - whole * 1.42860677e-6f;  // ln 2 in two parts
    NF p = NF{} + 0.00138144672f;
    p = p * r + 0.00836878084f;
    p = p * r + 0.0416683927f;
    p = p * r + 0.166665196f;
    p = p * r + 0.49999994f;
    p = p * r * r + r + 1.0f;
    // 2^whole in two factors: one alone has no room for the ends of the range
    const NI n = (NI)shifted - 0x4b400000, half = n >> 1;
    return {p * (NF)((half + 127) << 23) * (NF)((n - half + 127) << 23)};
  } else return {exponential(x.lo), exponential(x.hi)};
}

INLINE vf sigmoid(vf x) {
  const vf t = exponential(all(0) - absolute(x)), whole = all(1) / (all(1) + t);
  return select(x < all(0), t * whole, whole);
}

INLINE vf hyperbolic_tangent(vf x) {
  const vf size = absolute(x), square = x * x;
  vf p = all(0.0172414910f);
  p = p * square + all(-0.0530454926f);
  p = p * square + all(0.133258790f);
  p = p * square + all(-0.333331436f);
  const vf small = x + x * square * p;  // below 1/2, where 1 - t would cancel
  const vf t = exponential(all(-2) * size), large = (all(1) - t) / (all(1) + t);
  return select(size < all(0.5f), small, select(x < all(0), all(0) - large, large));
}

}  // namespace
