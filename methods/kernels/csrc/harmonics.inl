// Real spherical harmonics up to degree 3 over sixteen Gaussians: colours and their gradients.

namespace {

constexpr float C0 = 0.28209479177387814f, C1 = 0.4886025119029199f;
constexpr float C20 = 1.0925484305920792f, C22 = 0.31539156525252005f, C24 = 0.5462742152960396f;
constexpr float C30 = 0.5900435899266435f, C31 = 2.890611442640554f, C32 = 0.4570457994644658f,
                C33 = 0.3731763325901154f, C35 = 1.445305721320277f;

INLINE vf operator*(float a, vf b) { return all(a) * b; }
INLINE vf operator-(vf a) { return all(0) - a; }

INLINE void basis(int count, vf x, vf y, vf z, vf b[16]) {
  b[0] = all(C0);
  if (count <= 1) return;
  b[1] = -C1 * y;
  b[2] = C1 * z;
  b[3] = -C1 * x;
  if (count <= 4) return;
  const vf xx = x * x, yy = y * y, zz = z * z;
  b[4] = C20 * x * y;
  b[5] = -C20 * y * z;
  b[6] = C22 * (2 * zz - xx - yy);
  b[7] = -C20 * x * z;
  b[8] = C24 * (xx - yy);
  if (count <= 9) return;
  b[9] = -C30 * y * (3 * xx - yy);
  b[10] = C31 * x * y * z;
  b[11] = -C32 * y * (4 * zz - xx - yy);
  b[12] = C33 * z * (2 * zz - 3 * xx - 3 * yy);
  b[13] = -C32 * x * (4 * zz - xx - yy);
  b[14] = C35 * z * (xx - yy);
  b[15] = -C30 * x * (xx - 3 * yy);
}

// sum_k a_k d basis_k / d (x, y, z).
INLINE void basis_gradient(int count, vf x, vf y, vf z, const vf a[16], vf d[3]) {
  d[0] = d[1] = d[2] = all(0);
  if (count <= 1) return;
  d[0] = -C1 * a[3];
  d[1] = -C1 * a[1];
  d[2] = C1 * a[2];
  if (count <= 4) return;
  d[0] = d[0] + C20 * (y * a[4] - z * a[7]) - 2 * C22 * x * a[6] + 2 * C24 * x * a[8];
  d[1] = d[1] + C20 * (x * a[4] - z * a[5]) - 2 * C22 * y * a[6] - 2 * C24 * y * a[8];
  d[2] = d[2] - C20 * (y * a[5] + x * a[7]) + 4 * C22 * z * a[6];
  if (count <= 9) return;
  const vf xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
  d[0] = d[0] - 6 * C30 * xy * a[9] + C31 * yz * a[10] + 2 * C32 * xy * a[11] - 6 * C33 * xz * a[12] -
         C32 * (4 * zz - 3 * xx - yy) * a[13] + 2 * C35 * xz * a[14] - 3 * C30 * (xx - yy) * a[15];
  d[1] = d[1] - 3 * C30 * (xx - yy) * a[9] + C31 * xz * a[10] - C32 * (4 * zz - xx - 3 * yy) * a[11] -
         6 * C33 * yz * a[12] + 2 * C32 * xy * a[13] - 2 * C35 * yz * a[14] + 6 * C30 * xy * a[15];
  d[2] = d[2] + C31 * xy * a[10] - 8 * C32 * yz * a[11] + 3 * C33 * (2 * zz - xx - yy) * a[12] -
         8 * C32 * xz * a[13] + C35 * (xx - yy) * a[14];
}

// Coefficients of a Gaussian: the constant ones, and the others, which may lie in an array of their own.
template <class T>
struct Coefficients {
  T *constant, *rest;
  int64_t constant_stride, rest_stride;  // floats from one Gaussian to the next
};
template <class T>
INLINE Coefficients<T> coefficients(const Model& model, T* sh, T* sh_rest) {
  const int64_t stored = 3 * model.sh_stored;
  if (model.sh_rest) return {sh, sh_rest, 3, stored - 3};
  return {sh, sh ? sh + 3 : nullptr, stored, stored};
}

// How many of the Gaussians [first, first + count) have coefficients; the others have colours.
INLINE int with_sh(const Model& model, int64_t first, int count) {
  const int64_t left = model.sh_count - first;
  return left < 0 ? 0 : left < count ? (int)left : count;
}

// Fetch the coefficients of Gaussians [first, first + count), to be read.
template <class T>
STAGE void fetch_sh(Coefficients<T> c, int64_t first, int count) {
  constexpr int LINE = 64 / sizeof(float);
  if (!c.rest) return;
  const T* from = c.rest + first * c.rest_stride;
  for (int64_t j = 0; j < count * c.rest_stride; j += LINE) __builtin_prefetch(from + j);
}

// Numbers that follow one another, to or from a buffer in the first-level cache. Sixteen rows of coefficients that are
// read side by side take twice as long as the same rows one after the other.
INLINE void copy_row(const float* from, float* to, int count) {
  int i = 0;
  for (; i + LANES <= count; i += LANES) store(to + i, load(from + i));
  for (; i < count; ++i) to[i] = from[i];
}

// Coefficients of up to sixteen Gaussians as out[3 k + c][lane]; lanes past `count` repeat the last.
STAGE void gather_sh(const Model& model, int64_t first, int count, float out[48][LANES]) {
  const auto from = coefficients(model, model.sh, model.sh_rest);
  const int used = 3 * model.sh_used - 3, stored = 3 * model.sh_stored - 3;
  const auto lane = [&](int l) { return l < count ? l : count - 1; };
  if (from.constant_stride == 3 && count == LANES) split_columns<3>(from.constant + 3 * first, out);
  else
    for (int l = 0; l < LANES; ++l)
      for (int c = 0; c < 3; ++c) out[c][l] = from.constant[(first + lane(l)) * from.constant_stride + c];
  if (!used) return;
  const int stride = (int)from.rest_stride;
  alignas(64) float rows[48 * LANES];
  copy_row(from.rest + first * stride, rows, (count - 1) * stride + stored);
  if (stored < LANES) {
    for (int l = 0; l < LANES; ++l)
      for (int j = 0; j < used; ++j) out[3 + j][l] = rows[lane(l) * stride + j];
    return;
  }
  for (int j = 0; j < used; j += LANES) {
    const int column = j < stored - LANES ? j : stored - LANES;  // sixteen columns that lie within the rows
    transpose_rows([&](int l) { return rows + lane(l) * stride + column; }, out[3 + column], LANES);
  }
}

STAGE void sh_colour(const Model& model, int64_t first, int count, const float dir[3][LANES],
                      float colour[3][LANES]) {
  alignas(64) float sh[48][LANES];
  gather_sh(model, first, count, sh);
  vf b[16];
  basis(model.sh_used, load(dir[0]), load(dir[1]), load(dir[2]), b);
  for (int c = 0; c < 3; ++c) {
    vf sum = all(0.5f);
    for (int k = 0; k < model.sh_used; ++k) sum = sum + b[k] * load(sh[3 * k + c]);
    store(colour[c], maximum(sum, all(0)));
  }
}

// d loss / d coefficients (written in full, zero past the used degree) and d loss / d direction.
STAGE void sh_backward(const Model& model, int64_t first, int count, const float dir[3][LANES],
                        const float gradient[3][LANES], const ModelGradients& out, float dir_gradient[3][LANES]) {
  const int used = model.sh_used;
  alignas(64) float sh[48][LANES];
  gather_sh(model, first, count, sh);
  vf b[16], a[16], towards[3];
  basis(used, load(dir[0]), load(dir[1]), load(dir[2]), b);
  for (int k = 0; k < used; ++k) {
    vf sum = all(0);
    for (int c = 0; c < 3; ++c) {
      const vf g = load(gradient[c]);
      sum = sum + load(sh[3 * k + c]) * g;
      store(sh[3 * k + c], b[k] * g);  // from here on the gradient
    }
    a[k] = sum;
  }
  basis_gradient(used, load(dir[0]), load(dir[1]), load(dir[2]), a, towards);
  for (int c = 0; c < 3; ++c) store(dir_gradient[c], towards[c]);
  for (int j = 3 * used; j < 3 * model.sh_stored; ++j) store(sh[j], all(0));
  const auto to = coefficients(model, out.sh, out.sh_rest);
  const bool apart = model.sh_rest;  // else the constant ones lie before the others, in the same rows
  if (apart && to.constant && count == LANES) join_columns<3>(sh, to.constant + 3 * first);
  else
    for (int l = 0; apart && to.constant && l < count; ++l)
      for (int c = 0; c < 3; ++c) to.constant[(first + l) * 3 + c] = sh[c][l];
  if (!to.rest) return;
  const int skipped = apart ? 3 : 0, width = (int)to.rest_stride;
  alignas(64) float rows[48 * LANES];
  if (width < LANES) {
    for (int l = 0; l < count; ++l)
      for (int j = 0; j < width; ++j) rows[l * width + j] = sh[skipped + j][l];
  } else {
    for (int j = 0; j < width; j += LANES) {
      const int column = j < width - LANES ? j : width - LANES;
      transpose(sh[skipped + column], LANES, rows + column, width);
    }
  }
  float* target = (apart ? to.rest : to.constant) + first * width;
  if (count < LANES || (uintptr_t)target % 64) copy_row(rows, target, count * width);
  else
    for (int j = 0; j < LANES * width; j += LANES) store_past(target + j, load(rows + j));
}

// Zero gradient of Gaussians that were not drawn.
INLINE void sh_clear(const Model& model, int64_t first, int count, const ModelGradients& out) {
  const auto to = coefficients(model, out.sh, out.sh_rest);
  if (model.sh_rest && to.constant) __builtin_memset(to.constant + 3 * first, 0, sizeof(float) * 3 * count);
  if (!to.rest) return;
  float* rows = model.sh_rest ? to.rest : to.constant;
  __builtin_memset(rows + first * to.rest_stride, 0, sizeof(float) * to.rest_stride * count);
}

}  // namespace
