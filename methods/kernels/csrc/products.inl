// C = start + A B for small row-major matrices: rows of A by registers, columns of B and C in lanes.

namespace {

#if defined(__AVX512F__)
constexpr int TILE_ROWS = 8, TILE_VECTORS = 2;  // sums that fit into the registers, with what they are made from
#elif defined(__AVX2__)
constexpr int TILE_ROWS = 4, TILE_VECTORS = 1;
#else
constexpr int TILE_ROWS = 2, TILE_VECTORS = 1;
#endif

struct Left {  // element (r, k) is at data[r * by_row + k * by_depth]
  const float* data;
  ptrdiff_t by_row, by_depth;
};
struct Right {
  const float* data;
  ptrdiff_t stride;
};
struct Start {  // of the sums; null data is zero
  const float* data;
  ptrdiff_t stride;
  bool one_a_row = false;  // the number that a row of sums starts from, instead of one number a column
};
INLINE vf at_start(Start start, int row, int column) {
  if (!start.data) return all(0);
  const float* here = start.data + row * start.stride;
  return start.one_a_row ? all(*here) : load(here + column);
}

template <int R, int N>
INLINE void product_tile(Left a, Right b, int depth, Start start, float* c, ptrdiff_t stride) {
  vf sums[R][N];
#pragma GCC unroll 8
  for (int r = 0; r < R; ++r)
#pragma GCC unroll 2
    for (int n = 0; n < N; ++n) sums[r][n] = at_start(start, r, n * LANES);
  for (int k = 0; k < depth; ++k) {
    vf row[N];
#pragma GCC unroll 2
    for (int n = 0; n < N; ++n) row[n] = load(b.data + k * b.stride + n * LANES);
#pragma GCC unroll 8
    for (int r = 0; r < R; ++r) {
      const vf factor = all(a.data[r * a.by_row + k * a.by_depth]);
#pragma GCC unroll 2
      for (int n = 0; n < N; ++n) sums[r][n] = sums[r][n] + factor * row[n];
    }
  }
#pragma GCC unroll 8
  for (int r = 0; r < R; ++r)
#pragma GCC unroll 2
    for (int n = 0; n < N; ++n) store(c + r * stride + n * LANES, sums[r][n]);
}

template <int R>
INLINE void product_rows(Left a, Right b, int rows, int lanes, int depth, Start start, float* c, ptrdiff_t stride) {
  int r = 0;
  for (; r + R <= rows; r += R) {
    const Left here = {a.data + r * a.by_row, a.by_row, a.by_depth};
    int column = 0;
    const auto part = [&](int at) {
      const int right = start.one_a_row ? 0 : at;
      return Start{start.data ? start.data + r * start.stride + right : nullptr, start.stride, start.one_a_row};
    };
    for (; column + TILE_VECTORS * LANES <= lanes; column += TILE_VECTORS * LANES)
      product_tile<R, TILE_VECTORS>(here, {b.data + column, b.stride}, depth, part(column), c + r * stride + column, stride);
    for (; column < lanes; column += LANES)
      product_tile<R, 1>(here, {b.data + column, b.stride}, depth, part(column), c + r * stride + column, stride);
  }
  if constexpr (R > 1) {
    if (r < rows)
      product_rows<R / 2>({a.data + r * a.by_row, a.by_row, a.by_depth}, b, rows - r, lanes, depth,
                          {start.data ? start.data + r * start.stride : nullptr, start.stride, start.one_a_row},
                          c + r * stride, stride);
  }
}

// c[rows, lanes] = start + a[rows, depth] b[depth, lanes]; `lanes` is a multiple of LANES.
STAGE void product(Left a, Right b, int rows, int lanes, int depth, Start start, float* c, ptrdiff_t stride) {
  product_rows<TILE_ROWS>(a, b, rows, lanes, depth, start, c, stride);
}

// sums[column] += a[row, column] over all rows.
STAGE void add_rows(const float* a, ptrdiff_t stride, int rows, int lanes, float* sums) {
  for (int column = 0; column < lanes; column += LANES) {
    vf sum = load(sums + column);
    for (int r = 0; r < rows; ++r) sum = sum + load(a + r * stride + column);
    store(sums + column, sum);
  }
}

}  // namespace
