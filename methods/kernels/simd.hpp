// Sixteen floats as one value, whatever the width of the machine's registers.
//
// A value is a tree of native vectors (GCC/Clang vector extensions). Only comparisons, square roots and
// 2^x have per-machine forms. Everything lives in an unnamed namespace: each SIMD level has its own copy.
#pragma once
#include "types.hpp"

#if defined(__AVX__) || defined(__SSE2__)
#include <immintrin.h>
#endif

#define INLINE static inline __attribute__((always_inline))

using namespace splat;

namespace {

#if defined(__AVX512F__)
constexpr int WIDTH = 16;
#elif defined(__AVX2__)
constexpr int WIDTH = 8;
#else
constexpr int WIDTH = 4;
#endif

template <int W>
struct Native {
  typedef float f __attribute__((vector_size(W * 4)));
  typedef int i __attribute__((vector_size(W * 4)));
};
typedef Native<WIDTH>::f NF;
typedef Native<WIDTH>::i NI;

template <int N>
struct V {
  V<N / 2> lo, hi;
};
template <>
struct V<WIDTH> {
  NF v;
};
typedef V<LANES> vf;

template <int N>
struct M {
  M<N / 2> lo, hi;
};
template <>
struct M<WIDTH> {
#if defined(__AVX512F__)
  __mmask16 m;
#else
  NI m;
#endif
};
typedef M<LANES> mask;

template <int N>
INLINE V<N> broadcast(float x) {
  if constexpr (N == WIDTH) return {NF{} + x};
  else return {broadcast<N / 2>(x), broadcast<N / 2>(x)};
}
INLINE vf all(float x) { return broadcast<LANES>(x); }

template <int N>
INLINE V<N> read(const float* p) {
  if constexpr (N == WIDTH) {
    V<N> r;
    __builtin_memcpy(&r.v, p, sizeof r.v);
    return r;
  } else return {read<N / 2>(p), read<N / 2>(p + N / 2)};
}
INLINE vf load(const float* p) { return read<LANES>(p); }

template <int N>
INLINE void store(float* p, V<N> a) {
  if constexpr (N == WIDTH) __builtin_memcpy(p, &a.v, sizeof a.v);
  else { store(p, a.lo); store(p + N / 2, a.hi); }
}

#define SPLAT_BINARY(op)                                                    \
  template <int N>                                                          \
  INLINE V<N> operator op(V<N> a, V<N> b) {                                 \
    if constexpr (N == WIDTH) return {a.v op b.v};                          \
    else return {a.lo op b.lo, a.hi op b.hi};                               \
  }
SPLAT_BINARY(+)
SPLAT_BINARY(-)
SPLAT_BINARY(*)
SPLAT_BINARY(/)
#undef SPLAT_BINARY

#if defined(__AVX512F__)
#define SPLAT_COMPARE(op, code) \
  INLINE mask operator op(vf a, vf b) { return {_mm512_cmp_ps_mask((__m512)a.v, (__m512)b.v, code)}; }
SPLAT_COMPARE(<=, _CMP_LE_OQ)
SPLAT_COMPARE(>=, _CMP_GE_OQ)
SPLAT_COMPARE(<, _CMP_LT_OQ)
INLINE vf keep(mask m, vf a) { return {(NF)_mm512_maskz_mov_ps(m.m, (__m512)a.v)}; }
INLINE vf select(mask m, vf a, vf b) { return {(NF)_mm512_mask_mov_ps((__m512)b.v, m.m, (__m512)a.v)}; }
INLINE bool any(mask m) { return m.m != 0; }
INLINE unsigned bits(mask m) { return m.m; }
#else
#define SPLAT_COMPARE(op, code)                                   \
  template <int N>                                                \
  INLINE M<N> operator op(V<N> a, V<N> b) {                       \
    if constexpr (N == WIDTH) return {a.v op b.v};                \
    else return {a.lo op b.lo, a.hi op b.hi};                     \
  }
SPLAT_COMPARE(<=, )
SPLAT_COMPARE(>=, )
SPLAT_COMPARE(<, )
template <int N>
INLINE V<N> select(M<N> m, V<N> a, V<N> b) {
  if constexpr (N == WIDTH) return {m.m ? a.v : b.v};
  else return {select(m.lo, a.lo, b.lo), select(m.hi, a.hi, b.hi)};
}
template <int N>
INLINE V<N> keep(M<N> m, V<N> a) {
  if constexpr (N == WIDTH) return {(NF)((NI)a.v & m.m)};
  else return {keep(m.lo, a.lo), keep(m.hi, a.hi)};
}
template <int N>
INLINE unsigned bits(M<N> m) {
  if constexpr (N == WIDTH) {
#if defined(__AVX2__)
    return (unsigned)_mm256_movemask_ps((__m256)m.m);
#elif defined(__SSE2__)
    return (unsigned)_mm_movemask_ps((__m128)m.m);
#else
    unsigned r = 0;
    for (int l = 0; l < N; ++l) r |= (unsigned)(m.m[l] & 1) << l;
    return r;
#endif
  } else return bits(m.lo) | bits(m.hi) << (N / 2);
}
INLINE bool any(mask m) { return bits(m) != 0; }
#endif
#undef SPLAT_COMPARE

INLINE vf minimum(vf a, vf b) {
#if defined(__AVX512F__)
  return {(NF)_mm512_min_ps((__m512)a.v, (__m512)b.v)};
#else
  return select(a < b, a, b);
#endif
}

INLINE vf maximum(vf a, vf b) {
#if defined(__AVX512F__)
  return {(NF)_mm512_max_ps((__m512)a.v, (__m512)b.v)};
#else
  return select(b < a, a, b);
#endif
}

template <int N>
INLINE V<N> absolute(V<N> a) {
  if constexpr (N == WIDTH) return {(NF)((NI)a.v & 0x7fffffff)};
  else return {absolute(a.lo), absolute(a.hi)};
}

template <int N>
INLINE V<N> square_root(V<N> a) {
  if constexpr (N == WIDTH) {
#if defined(__AVX512F__)
    return {(NF)_mm512_sqrt_ps((__m512)a.v)};
#elif defined(__AVX2__)
    return {(NF)_mm256_sqrt_ps((__m256)a.v)};
#elif defined(__SSE2__)
    return {(NF)_mm_sqrt_ps((__m128)a.v)};
#else
    V<N> r;
    for (int l = 0; l < N; ++l) r.v[l] = __builtin_sqrtf(a.v[l]);
    return r;
#endif
  } else return {square_root(a.lo), square_root(a.hi)};
}

// 2^-s for 0 <= s <= 100, relative error below 2.5e-7; any bits for other s (callers mask those lanes).
// 2^f on [-1/2, 1/2] is a minimax polynomial with value 1 at 0.
template <int N>
INLINE V<N> exp2_negative(V<N> s) {
  if constexpr (N == WIDTH) {
    const NF t = -s.v;
#if defined(__AVX512F__)
    const NF whole = (NF)_mm512_roundscale_ps((__m512)t, 0);
#else
    const NF shifted = t + 12582912.0f;  // 1.5 * 2^23: the low bits now hold the nearest integer
    const NF whole = shifted - 12582912.0f;
#endif
    const NF f = t - whole;
    NF p = NF{} + 0.00132647272f;
    p = p * f + 0.00967151264f;
    p = p * f + 0.05550733743f;
    p = p * f + 0.2402224209f;
    p = p * f + 0.6931469776f;
    p = p * f + 1.0f;
#if defined(__AVX512F__)
    return {(NF)_mm512_scalef_ps((__m512)p, (__m512)whole)};
#else
    typedef Native<WIDTH>::i I;
    return {(NF)((I)p + ((I)shifted << 23))};
#endif
  } else return {exp2_negative(s.lo), exp2_negative(s.hi)};
}

// Lane numbers 0, 1, ..., WIDTH - 1 as template arguments.
template <int... L>
struct Lanes {};
template <int N, int... L>
struct MakeLanes : MakeLanes<N - 1, N - 1, L...> {};
template <int... L>
struct MakeLanes<0, L...> {
  typedef Lanes<L...> type;
};

// One butterfly of a transposition: swap the S-blocks off the diagonal of rows a and b.
template <int S, int... L>
INLINE void exchange(NF& a, NF& b, Lanes<L...>) {
  const NF low = __builtin_shufflevector(a, b, ((L & S) == 0 ? L : WIDTH + L - S)...);
  b = __builtin_shufflevector(a, b, ((L & S) == 0 ? L + S : WIDTH + L)...);
  a = low;
}

template <int S>
INLINE void butterflies(NF* rows) {
  if constexpr (S > 0) {
#pragma GCC unroll 16
    for (int i = 0; i < WIDTH; ++i)
      if (!(i & S)) exchange<S>(rows[i], rows[i + S], typename MakeLanes<WIDTH>::type());
    butterflies<S / 2>(rows);
  }
}

// out[c][r] = in[r][c] for 16 rows that lie `stride` floats apart; both need no alignment.
INLINE void transpose(const float* in, ptrdiff_t stride, float* out, ptrdiff_t out_stride) {
  for (int i = 0; i < LANES; i += WIDTH)
    for (int j = 0; j < LANES; j += WIDTH) {
      NF rows[WIDTH];
#pragma GCC unroll 16
      for (int r = 0; r < WIDTH; ++r) __builtin_memcpy(&rows[r], in + (i + r) * stride + j, sizeof(NF));
      butterflies<WIDTH / 2>(rows);
#pragma GCC unroll 16
      for (int r = 0; r < WIDTH; ++r) __builtin_memcpy(out + (j + r) * out_stride + i, &rows[r], sizeof(NF));
    }
}

}  // namespace
