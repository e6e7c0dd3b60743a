// Sixteen floats, or eight doubles, as one value, whatever the width of the machine's registers.
//
// A value is a tree of native vectors (GCC/Clang vector extensions). Only comparisons, square roots and
// 2^x have per-machine forms. Everything lives in an unnamed namespace: each SIMD level has its own copy.
#pragma once
#include "types.hpp"

#if defined(__AVX__) || defined(__SSE2__)
#include <immintrin.h>
#elif defined(SPLAT_NEON)
#include <arm_neon.h>
#endif

#define INLINE static inline __attribute__((always_inline))
#define STAGE static __attribute__((noinline))  // large enough to be seen by its name in a profile

using namespace splat;

namespace {

#if defined(__AVX512F__)
constexpr int BYTES = 64;
#elif defined(__AVX2__)
constexpr int BYTES = 32;
#else
constexpr int BYTES = 16;
#endif
constexpr int WIDTH = BYTES / 4;  // floats in a register

template <class T> struct Integer;
template <> struct Integer<float> { typedef int32_t type; };
template <> struct Integer<double> { typedef int64_t type; };

template <class T, int N, bool LEAF = (N * sizeof(T) <= BYTES)>
struct V {
  V<T, N / 2> lo, hi;
};
template <class T, int N>
struct V<T, N, true> {
  typedef T Values __attribute__((vector_size(N * sizeof(T))));
  typedef typename Integer<T>::type Int;
  typedef Int Bits __attribute__((vector_size(N * sizeof(T))));
  Values v;
};
typedef V<float, WIDTH>::Values NF;
typedef V<float, WIDTH>::Bits NI;
typedef uint32_t NU __attribute__((vector_size(4 * WIDTH)));  // lanes that are masked may overflow: that is defined

// True or false in each lane.
template <class T, int N, bool LEAF = (N * sizeof(T) <= BYTES)>
struct M {
  M<T, N / 2> lo, hi;
};
template <class T, int N>
struct M<T, N, true> {
  typename V<T, N>::Bits m;
};
#if defined(__AVX512F__)
template <>
struct M<float, 16, true> {
  __mmask16 m;
};
#endif

typedef V<float, LANES> vf;
typedef M<float, LANES> mask;
constexpr int HALF = LANES / 2;
typedef V<double, HALF> vd;
typedef M<double, HALF> maskd;

template <class T, int N>
constexpr bool leaf = N * sizeof(T) <= BYTES;

template <class T, int N>
INLINE V<T, N> broadcast(T x) {
  if constexpr (leaf<T, N>) return {x - typename V<T, N>::Values{}};  // 0 + x would be an addition: it is 0 for -0
  else return {broadcast<T, N / 2>(x), broadcast<T, N / 2>(x)};
}
INLINE vf all(float x) { return broadcast<float, LANES>(x); }
INLINE vd alld(double x) { return broadcast<double, HALF>(x); }

template <class T, int N>
INLINE V<T, N> read(const T* p) {
  if constexpr (leaf<T, N>) {
    V<T, N> r;
    __builtin_memcpy(&r.v, p, sizeof r.v);
    return r;
  } else return {read<T, N / 2>(p), read<T, N / 2>(p + N / 2)};
}
INLINE vf load(const float* p) { return read<float, LANES>(p); }

template <class T, int N>
INLINE void store(T* p, V<T, N> a) {
  if constexpr (leaf<T, N>) __builtin_memcpy(p, &a.v, sizeof a.v);
  else { store(p, a.lo); store(p + N / 2, a.hi); }
}

// Past the caches, for what is not read soon; `p` lies at the start of a line. Others see it after `stored_past`.
template <int N>
INLINE void store_past(float* p, V<float, N> a) {
  if constexpr (leaf<float, N>) {
#if defined(__AVX512F__)
    _mm512_stream_ps(p, (__m512)a.v);
#elif defined(__AVX2__)
    _mm256_stream_ps(p, (__m256)a.v);
#else
    store(p, a);
#endif
  } else { store_past(p, a.lo); store_past(p + N / 2, a.hi); }
}
INLINE void stored_past() {
#if defined(__AVX2__)
  _mm_sfence();
#endif
}

// Doubles from and to floats in memory.
template <int N = HALF>
INLINE V<double, N> widen(const float* p) {
  if constexpr (leaf<double, N>) {
    typedef float Floats __attribute__((vector_size(N * 4)));
    Floats f;
    __builtin_memcpy(&f, p, sizeof f);
    return {__builtin_convertvector(f, typename V<double, N>::Values)};
  } else return {widen<N / 2>(p), widen<N / 2>(p + N / 2)};
}
template <int N>
INLINE void narrow(float* p, V<double, N> a) {
  if constexpr (leaf<double, N>) {
    typedef float Floats __attribute__((vector_size(N * 4)));
    const Floats f = __builtin_convertvector(a.v, Floats);
    __builtin_memcpy(p, &f, sizeof f);
  } else { narrow(p, a.lo); narrow(p + N / 2, a.hi); }
}

#define SPLAT_BINARY(op)                                                                           \
  template <class T, int N>                                                                        \
  INLINE V<T, N> operator op(V<T, N> a, V<T, N> b) {                                               \
    if constexpr (leaf<T, N>) return {a.v op b.v};                                                 \
    else return {a.lo op b.lo, a.hi op b.hi};                                                      \
  }                                                                                                \
  INLINE vd operator op(vd a, double b) { return a op alld(b); }                                   \
  INLINE vd operator op(double a, vd b) { return alld(a) op b; }
SPLAT_BINARY(+)
SPLAT_BINARY(-)
SPLAT_BINARY(*)
SPLAT_BINARY(/)
#undef SPLAT_BINARY

#define SPLAT_COMPARE(op)                                                                          \
  template <class T, int N>                                                                        \
  INLINE M<T, N> operator op(V<T, N> a, V<T, N> b) {                                               \
    if constexpr (leaf<T, N>) return {a.v op b.v};                                                 \
    else return {a.lo op b.lo, a.hi op b.hi};                                                      \
  }                                                                                                \
  INLINE maskd operator op(vd a, double b) { return a op alld(b); }
SPLAT_COMPARE(<=)
SPLAT_COMPARE(>=)
SPLAT_COMPARE(<)
SPLAT_COMPARE(>)
SPLAT_COMPARE(==)
#undef SPLAT_COMPARE

template <class T, int N>
INLINE M<T, N> operator&(M<T, N> a, M<T, N> b) {
  if constexpr (leaf<T, N>) return {(decltype(a.m))(a.m & b.m)};
  else return {a.lo & b.lo, a.hi & b.hi};
}

template <class T, int N>
INLINE V<T, N> select(M<T, N> m, V<T, N> a, V<T, N> b) {
  if constexpr (leaf<T, N>) return {m.m ? a.v : b.v};
  else return {select(m.lo, a.lo, b.lo), select(m.hi, a.hi, b.hi)};
}

// a where m, else 0.
template <class T, int N>
INLINE V<T, N> keep(M<T, N> m, V<T, N> a) {
  typedef V<T, N> Value;
  if constexpr (leaf<T, N>) return {(typename Value::Values)((typename Value::Bits)a.v & m.m)};
  else return {keep(m.lo, a.lo), keep(m.hi, a.hi)};
}

// Lane l in bit l.
template <class T, int N>
INLINE unsigned bits(M<T, N> m) {
  if constexpr (leaf<T, N>) {
    unsigned r = 0;
#if defined(__AVX2__)
    if constexpr (sizeof m.m == 32 && sizeof(T) == 4) return (unsigned)_mm256_movemask_ps((__m256)m.m);
#elif defined(__SSE2__)
    if constexpr (sizeof(T) == 4) return (unsigned)_mm_movemask_ps((__m128)m.m);
#elif defined(SPLAT_NEON)
    if constexpr (sizeof(T) == 4) return vaddvq_u32(vandq_u32((uint32x4_t)m.m, uint32x4_t{1, 2, 4, 8}));
#endif
    for (int l = 0; l < N; ++l) r |= (unsigned)(m.m[l] & 1) << l;
    return r;
  } else return bits(m.lo) | bits(m.hi) << (N / 2);
}

#if defined(__AVX512F__)
// Comparisons straight into mask registers: these overloads win over the templates.
#define SPLAT_COMPARE(op, code) \
  INLINE mask operator op(vf a, vf b) { return {_mm512_cmp_ps_mask((__m512)a.v, (__m512)b.v, code)}; }
SPLAT_COMPARE(<=, _CMP_LE_OQ)
SPLAT_COMPARE(>=, _CMP_GE_OQ)
SPLAT_COMPARE(<, _CMP_LT_OQ)
SPLAT_COMPARE(>, _CMP_GT_OQ)
#undef SPLAT_COMPARE
INLINE vf keep(mask m, vf a) { return {(NF)_mm512_maskz_mov_ps(m.m, (__m512)a.v)}; }
INLINE vf select(mask m, vf a, vf b) { return {(NF)_mm512_mask_mov_ps((__m512)b.v, m.m, (__m512)a.v)}; }
INLINE unsigned bits(mask m) { return m.m; }
#endif
template <int N>
INLINE bool any(M<float, N> m) { return bits(m) != 0; }

template <int N>
INLINE V<float, N> minimum(V<float, N> a, V<float, N> b) {  // b where either is NaN
  if constexpr (leaf<float, N>) {
#if defined(__AVX512F__)
    return {(NF)_mm512_min_ps((__m512)a.v, (__m512)b.v)};
#elif defined(__AVX2__)
    return {(NF)_mm256_min_ps((__m256)a.v, (__m256)b.v)};
#elif defined(__SSE2__)
    return {(NF)_mm_min_ps((__m128)a.v, (__m128)b.v)};
#elif defined(SPLAT_NEON)
    return {(NF)vminnmq_f32((float32x4_t)a.v, (float32x4_t)b.v)};  // NaN: the other one
#else
    return select(a < b, a, b);
#endif
  } else return {minimum(a.lo, b.lo), minimum(a.hi, b.hi)};
}

template <int N>
INLINE V<float, N> maximum(V<float, N> a, V<float, N> b) {  // b where either is NaN
  if constexpr (leaf<float, N>) {
#if defined(__AVX512F__)
    return {(NF)_mm512_max_ps((__m512)a.v, (__m512)b.v)};
#elif defined(__AVX2__)
    return {(NF)_mm256_max_ps((__m256)a.v, (__m256)b.v)};
#elif defined(__SSE2__)
    return {(NF)_mm_max_ps((__m128)a.v, (__m128)b.v)};
#elif defined(SPLAT_NEON)
    return {(NF)vmaxnmq_f32((float32x4_t)a.v, (float32x4_t)b.v)};  // NaN: the other one
#else
    return select(a > b, a, b);
#endif
  } else return {maximum(a.lo, b.lo), maximum(a.hi, b.hi)};
}

template <int N>
INLINE V<float, N> absolute(V<float, N> a) {
  if constexpr (leaf<float, N>) return {(NF)((NI)a.v & 0x7fffffff)};
  else return {absolute(a.lo), absolute(a.hi)};
}

template <class T, int N>
INLINE V<T, N> square_root(V<T, N> a) {
  if constexpr (leaf<T, N>) {
    [[maybe_unused]] typedef typename V<T, N>::Values Values;
    if constexpr (sizeof(T) == 4) {
#if defined(__AVX512F__)
      return {(Values)_mm512_sqrt_ps((__m512)a.v)};
#elif defined(__AVX2__)
      return {(Values)_mm256_sqrt_ps((__m256)a.v)};
#elif defined(__SSE2__)
      return {(Values)_mm_sqrt_ps((__m128)a.v)};
#elif defined(SPLAT_NEON)
      return {(Values)vsqrtq_f32((float32x4_t)a.v)};
#endif
    } else {
#if defined(__AVX512F__)
      return {(Values)_mm512_sqrt_pd((__m512d)a.v)};
#elif defined(__AVX2__)
      return {(Values)_mm256_sqrt_pd((__m256d)a.v)};
#elif defined(__SSE2__)
      return {(Values)_mm_sqrt_pd((__m128d)a.v)};
#elif defined(SPLAT_NEON)
      return {(Values)vsqrtq_f64((float64x2_t)a.v)};
#endif
    }
#if !defined(__SSE2__) && !defined(SPLAT_NEON)
    V<T, N> r;
    for (int l = 0; l < N; ++l) r.v[l] = sizeof(T) == 4 ? (T)__builtin_sqrtf((float)a.v[l]) : (T)__builtin_sqrt(a.v[l]);
    return r;
#endif
  } else return {square_root(a.lo), square_root(a.hi)};
}

// t = whole + rest for |t| <= 100: `rest` in [0, 1) with AVX-512 and in [-1/2, 1/2] without, `scale` what
// times_power needs of t. Any bits for other t (callers mask those lanes).
template <int N>
INLINE V<float, N> fraction(V<float, N> t, V<float, N>& scale) {
  if constexpr (leaf<float, N>) {
#if defined(__AVX512F__)
    scale = t;  // vscalef rounds down itself
    return {(NF)_mm512_reduce_ps((__m512)t.v, 1)};
#else
    scale.v = t.v + 12582912.0f;  // 1.5 * 2^23: the low bits now hold the nearest integer
    return {t.v - (scale.v - 12582912.0f)};
#endif
  } else return {fraction(t.lo, scale.lo), fraction(t.hi, scale.hi)};
}
template <int N>
INLINE V<float, N> times_power(V<float, N> p, V<float, N> scale) {  // p 2^whole
  if constexpr (leaf<float, N>) {
#if defined(__AVX512F__)
    return {(NF)_mm512_scalef_ps((__m512)p.v, (__m512)scale.v)};
#else
    return {(NF)((NU)p.v + ((NU)scale.v << 23))};
#endif
  } else return {times_power(p.lo, scale.lo), times_power(p.hi, scale.hi)};
}

// t[k] = 2^t[k] for |t[k]| <= 100, relative error below 2.5e-7; any bits for others. 2^rest is a minimax polynomial
// with value 1 at 0. The K are worked on in step: one alone waits for each of its own operations.
template <int K, int N>
INLINE void exp2_of(V<float, N> (&t)[K]) {
#if defined(__AVX512F__)
  constexpr float factors[] = {0.009017030708f, 0.05579991266f, 0.2401644439f, 0.6931512952f, 1.0f};
  constexpr float highest = 0.00186713005f;
#else
  constexpr float factors[] = {0.00967151264f, 0.05550733743f, 0.2402224209f, 0.6931469776f, 1.0f};
  constexpr float highest = 0.00132647272f;
#endif
  V<float, N> scale[K], p[K];
#pragma GCC unroll 8
  for (int k = 0; k < K; ++k) t[k] = fraction(t[k], scale[k]);
#pragma GCC unroll 8
  for (int k = 0; k < K; ++k) p[k] = broadcast<float, N>(highest);
#pragma GCC unroll 8
  for (float factor : factors)
#pragma GCC unroll 8
    for (int k = 0; k < K; ++k) p[k] = p[k] * t[k] + broadcast<float, N>(factor);
#pragma GCC unroll 8
  for (int k = 0; k < K; ++k) t[k] = times_power(p[k], scale[k]);
}

// 1 / x for x in [1e-30, 1e30], relative error below 2.5e-7.
template <int N>
INLINE V<float, N> reciprocal(V<float, N> x) {
#if defined(__AVX512F__)
  if constexpr (N == 16) {  // a guess of 14 bits and one step of Newton's method
    const NF r = (NF)_mm512_rcp14_ps((__m512)x.v);
    return {r + r * (1.0f - x.v * r)};
  }
#endif
  return broadcast<float, N>(1) / x;
}

// The exponent field of doubles: p 2^n for n in the low bits of `shifted` = n + 2^52 + 2^51.
template <int N>
INLINE V<double, N> scale_by(V<double, N> p, V<double, N> shifted) {
  typedef V<double, N> Value;
  if constexpr (leaf<double, N>)
    return {(typename Value::Values)((typename Value::Bits)p.v + ((typename Value::Bits)shifted.v << 52))};
  else return {scale_by(p.lo, shifted.lo), scale_by(p.hi, shifted.hi)};
}

// x = m 2^e with m in [sqrt(1/2), sqrt(2)), for x in [2^-1000, 2^1000].
template <int N>
INLINE void split_exponent(V<double, N> x, V<double, N>& m, V<double, N>& e) {
  if constexpr (leaf<double, N>) {
    typedef typename V<double, N>::Bits Bits;
    typedef typename V<double, N>::Values Values;
    const Bits raw = (Bits)x.v, shift = (raw - 0x3fe6a09e667f3bcdLL) & (Bits{} + (int64_t)(0xfffULL << 52));
    m.v = (Values)(raw - shift);
    // to a double without an integer conversion: the bits of 2^52 + e + 1024
    typedef uint64_t Unsigned __attribute__((vector_size(N * 8)));
    const Unsigned biased = ((Unsigned)shift + (1024ULL << 52)) >> 52;
    e.v = (Values)((Bits)biased | 0x4330000000000000LL) - (4503599627370496.0 + 1024);
  } else { split_exponent(x.lo, m.lo, e.lo); split_exponent(x.hi, m.hi, e.hi); }
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

// out[c][r] = row(r)[c] for 16 rows.
template <class Row>
INLINE void transpose_rows(Row row, float* out, ptrdiff_t out_stride) {
  for (int i = 0; i < LANES; i += WIDTH)
    for (int j = 0; j < LANES; j += WIDTH) {
      NF rows[WIDTH];
#pragma GCC unroll 16
      for (int r = 0; r < WIDTH; ++r) __builtin_memcpy(&rows[r], row(i + r) + j, sizeof(NF));
      butterflies<WIDTH / 2>(rows);
#pragma GCC unroll 16
      for (int r = 0; r < WIDTH; ++r) __builtin_memcpy(out + (j + r) * out_stride + i, &rows[r], sizeof(NF));
    }
}

// out[c][r] = in[r][c] for 16 rows that lie `stride` floats apart; both need no alignment.
INLINE void transpose(const float* in, ptrdiff_t stride, float* out, ptrdiff_t out_stride) {
  transpose_rows([=](int r) { return in + r * stride; }, out, out_stride);
}

// Element p of the three values a, b and c one after another is element p / 3 of column p % 3.
template <int C, int... I>
INLINE NF column_of_3(NF a, NF b, NF c, Lanes<I...>) {
  const NF ab = __builtin_shufflevector(a, b, (3 * I + C < 2 * WIDTH ? 3 * I + C : 0)...);
  return __builtin_shufflevector(ab, c, (3 * I + C < 2 * WIDTH ? I : 3 * I + C - WIDTH)...);
}
template <int PART, int... I>
INLINE NF part_of_3(NF x, NF y, NF z, Lanes<I...>) {
  constexpr int FIRST = PART * WIDTH;
  const NF xy = __builtin_shufflevector(x, y, ((FIRST + I) % 3 ? WIDTH + (FIRST + I) / 3 : (FIRST + I) / 3)...);
  return __builtin_shufflevector(xy, z, ((FIRST + I) % 3 < 2 ? I : WIDTH + (FIRST + I) / 3)...);
}
// Elements 2 i + ODD of a and b one after another; and back, the half PART of a0 b0 a1 b1 ...
template <int ODD, int... I>
INLINE NF every_second(NF a, NF b, Lanes<I...>) { return __builtin_shufflevector(a, b, (2 * I + ODD)...); }
template <int PART, int... I>
INLINE NF zip(NF a, NF b, Lanes<I...>) {
  return __builtin_shufflevector(a, b, (PART * WIDTH / 2 + I / 2 + I % 2 * WIDTH)...);
}

// out[c][l] = rows[C l + c] for LANES rows of C numbers that follow one another.
template <int C>
INLINE void split_columns(const float* rows, float (*out)[LANES]) {
  const typename MakeLanes<WIDTH>::type every;
  for (int i = 0; i < LANES; i += WIDTH) {
    NF in[C], columns[C];
    for (int c = 0; c < C; ++c) __builtin_memcpy(&in[c], rows + C * i + c * WIDTH, sizeof(NF));
    if constexpr (C == 1) columns[0] = in[0];
    else if constexpr (C == 3) {
      columns[0] = column_of_3<0>(in[0], in[1], in[2], every);
      columns[1] = column_of_3<1>(in[0], in[1], in[2], every);
      columns[2] = column_of_3<2>(in[0], in[1], in[2], every);
    } else {
      static_assert(C == 4, "rows of 1, 3 or 4 numbers");
      const NF even[] = {every_second<0>(in[0], in[1], every), every_second<0>(in[2], in[3], every)};
      const NF odd[] = {every_second<1>(in[0], in[1], every), every_second<1>(in[2], in[3], every)};
      columns[0] = every_second<0>(even[0], even[1], every);
      columns[1] = every_second<0>(odd[0], odd[1], every);
      columns[2] = every_second<1>(even[0], even[1], every);
      columns[3] = every_second<1>(odd[0], odd[1], every);
    }
    for (int c = 0; c < C; ++c) __builtin_memcpy(out[c] + i, &columns[c], sizeof(NF));
  }
}

// rows[C l + c] = in[c][l] for LANES rows.
template <int C>
INLINE void join_columns(const float (*in)[LANES], float* rows) {
  const typename MakeLanes<WIDTH>::type every;
  for (int i = 0; i < LANES; i += WIDTH) {
    NF x[C], out[C];
    for (int c = 0; c < C; ++c) __builtin_memcpy(&x[c], in[c] + i, sizeof(NF));
    if constexpr (C == 1) out[0] = x[0];
    else if constexpr (C == 2) {
      out[0] = zip<0>(x[0], x[1], every);
      out[1] = zip<1>(x[0], x[1], every);
    } else if constexpr (C == 3) {
      out[0] = part_of_3<0>(x[0], x[1], x[2], every);
      out[1] = part_of_3<1>(x[0], x[1], x[2], every);
      out[2] = part_of_3<2>(x[0], x[1], x[2], every);
    } else {
      static_assert(C == 4, "rows of 1 to 4 numbers");
      const NF low[] = {zip<0>(x[0], x[2], every), zip<0>(x[1], x[3], every)};
      const NF high[] = {zip<1>(x[0], x[2], every), zip<1>(x[1], x[3], every)};
      out[0] = zip<0>(low[0], low[1], every);
      out[1] = zip<1>(low[0], low[1], every);
      out[2] = zip<0>(high[0], high[1], every);
      out[3] = zip<1>(high[0], high[1], every);
    }
    for (int c = 0; c < C; ++c) __builtin_memcpy(rows + C * i + c * WIDTH, &out[c], sizeof(NF));
  }
}

#if defined(__AVX512F__)
// Append first + l for each set bit l of `chosen`. May write 16 numbers, so leave room for them.
INLINE int append(uint32_t* list, int length, uint32_t first, unsigned chosen) {
  const __m512i lanes = _mm512_add_epi32(_mm512_set1_epi32((int)first), _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0));
  _mm512_storeu_si512(list + length, _mm512_maskz_compress_epi32((__mmask16)chosen, lanes));
  return length + __builtin_popcount(chosen);
}
#endif

}  // namespace
