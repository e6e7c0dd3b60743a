// Projection of Gaussians, sixteen lanes at a time, in double precision: float32 would lose 1e-4 px of a
// mean at x = 1000, the direction of needles, and overflow for Gaussians much larger than the scene.

namespace {

constexpr int L = LANES;

// Columns of [count, columns] rows; lanes past `count` repeat the last row.
INLINE void gather_rows(const float* rows, int columns, int64_t first, int count, float out[][L]) {
  for (int l = 0; l < L; ++l) {
    const float* row = rows + (first + (l < count ? l : count - 1)) * columns;
    for (int c = 0; c < columns; ++c) out[c][l] = row[c];
  }
}

struct Lane16 {
  float mean[3][L], quaternion[4][L], scale[3][L], opacity[1][L];
};

INLINE void gather(const Model& model, int64_t first, int count, Lane16& in) {
  gather_rows(model.means, 3, first, count, in.mean);
  gather_rows(model.quaternions, 4, first, count, in.quaternion);
  gather_rows(model.scales, 3, first, count, in.scale);
  gather_rows(model.opacities, 1, first, count, in.opacity);
}

INLINE double pick(bool condition, double a, double b) { return condition ? a : b; }
INLINE double clamp(double x, double low, double high) {
  x = x < low ? low : x;
  return x > high ? high : x;
}

// e^x, relative error below 1e-13: 2^whole times a Taylor sum on [-ln 2 / 2, ln 2 / 2].
INLINE double exponential(double x) {
  x = clamp(x, -700, 700);
  const double shifted = x * 1.4426950408889634 + 6755399441055744.0;
  const double whole = shifted - 6755399441055744.0;
  const double f = (x - whole * 0.693147180369123816) - whole * 1.90821492927058770e-10;
  double p = 1.0 / 39916800;
  p = p * f + 1.0 / 3628800;
  p = p * f + 1.0 / 362880;
  p = p * f + 1.0 / 40320;
  p = p * f + 1.0 / 5040;
  p = p * f + 1.0 / 720;
  p = p * f + 1.0 / 120;
  p = p * f + 1.0 / 24;
  p = p * f + 1.0 / 6;
  p = p * f + 0.5;
  p = p * f + 1;
  p = p * f + 1;
  int64_t n, bits;
  __builtin_memcpy(&n, &shifted, 8);
  __builtin_memcpy(&bits, &p, 8);
  bits += n << 52;
  __builtin_memcpy(&p, &bits, 8);
  return p;
}

// log2 of x in [2^-1000, 2^1000], absolute error below 1e-9.
INLINE double logarithm2(double x) {
  int64_t bits;
  __builtin_memcpy(&bits, &x, 8);
  const int64_t shift = (bits - 0x3fe6a09e667f3bcdLL) & (0xfffLL << 52);  // mantissa in [sqrt(1/2), sqrt(2))
  bits -= shift;
  double m, exponent;
  __builtin_memcpy(&m, &bits, 8);
  // to a double without an integer conversion: the bits of 2^52 + exponent + 1024
  const uint64_t biased = ((uint64_t)shift + (1024ULL << 52)) >> 52 | 0x4330000000000000ULL;
  __builtin_memcpy(&exponent, &biased, 8);
  exponent -= 4503599627370496.0 + 1024;
  const double s = (m - 1) / (m + 1), q = s * s;
  double p = 2.0 / 11;
  p = p * q + 2.0 / 9;
  p = p * q + 2.0 / 7;
  p = p * q + 2.0 / 5;
  p = p * q + 2.0 / 3;
  p = p * q + 2;
  return exponent + 1.4426950408889634 * s * p;
}

// Everything that the forward and the backward pass need of one Gaussian.
struct Ewa {
  bool front, inside_x, inside_y, identity;
  double x, y, z, iz, u, v, uc, vc;  // camera space; uc, vc clamped
  double px, py;
  double qw, qx, qy, qz, iq;         // unit quaternion, 1 / norm
  double s[3], o;                    // standard deviations, opacity before compensation
  double r[3][3];
  double jw[2][3], p[2][3], m[2][3]; // J W, J W R, J W R S
  double n[3], sharp, det;           // minors of M, det(M M^T), det(M M^T + 0.3 I)
  double cxx, cxy, cyy, compensation;
};

INLINE void ewa(const Camera& cam, const Model& model, const Lane16& in, int l, Ewa& e) {
  const double mx = in.mean[0][l], my = in.mean[1][l], mz = in.mean[2][l];
  const double* R = cam.rotation;
  e.z = R[6] * mx + R[7] * my + R[8] * mz + cam.translation[2];
  e.front = e.z > cam.near;
  e.x = pick(e.front, R[0] * mx + R[1] * my + R[2] * mz + cam.translation[0], 0);
  e.y = pick(e.front, R[3] * mx + R[4] * my + R[5] * mz + cam.translation[1], 0);
  e.z = pick(e.front, e.z, 1);
  e.iz = 1 / e.z;
  e.u = e.x * e.iz;
  e.v = e.y * e.iz;
  e.px = cam.k[0] * e.u + cam.k[1] * e.v + cam.k[2];
  e.py = cam.k[3] * e.u + cam.k[4] * e.v + cam.k[5];
  e.uc = clamp(e.u, -cam.limit_x, cam.limit_x);
  e.vc = clamp(e.v, -cam.limit_y, cam.limit_y);
  e.inside_x = e.uc == e.u;
  e.inside_y = e.vc == e.v;

  const double w = in.quaternion[0][l], x = in.quaternion[1][l], y = in.quaternion[2][l],
               z = in.quaternion[3][l];
  const double norm2 = w * w + x * x + y * y + z * z;
  e.identity = norm2 == 0;
  e.iq = 1 / __builtin_sqrt(pick(e.identity, 1, norm2));
  e.qw = pick(e.identity, 1, w * e.iq);
  e.qx = x * e.iq;
  e.qy = y * e.iq;
  e.qz = z * e.iq;
  e.r[0][0] = 1 - 2 * (e.qy * e.qy + e.qz * e.qz);
  e.r[0][1] = 2 * (e.qx * e.qy - e.qw * e.qz);
  e.r[0][2] = 2 * (e.qx * e.qz + e.qw * e.qy);
  e.r[1][0] = 2 * (e.qx * e.qy + e.qw * e.qz);
  e.r[1][1] = 1 - 2 * (e.qx * e.qx + e.qz * e.qz);
  e.r[1][2] = 2 * (e.qy * e.qz - e.qw * e.qx);
  e.r[2][0] = 2 * (e.qx * e.qz - e.qw * e.qy);
  e.r[2][1] = 2 * (e.qy * e.qz + e.qw * e.qx);
  e.r[2][2] = 1 - 2 * (e.qx * e.qx + e.qy * e.qy);

  for (int k = 0; k < 3; ++k) {
    const double s = in.scale[k][l];
    e.s[k] = model.raw ? exponential(s) : s;
  }
  const double o = in.opacity[0][l];
  e.o = model.raw ? 1 / (1 + exponential(-o)) : o;

  const double fx = cam.k[0] * e.iz, fy = cam.k[4] * e.iz;
  for (int i = 0; i < 3; ++i) {
    e.jw[0][i] = fx * (R[i] - e.uc * R[6 + i]);
    e.jw[1][i] = fy * (R[3 + i] - e.vc * R[6 + i]);
  }
  for (int a = 0; a < 2; ++a)
    for (int k = 0; k < 3; ++k) {
      e.p[a][k] = e.jw[a][0] * e.r[0][k] + e.jw[a][1] * e.r[1][k] + e.jw[a][2] * e.r[2][k];
      e.m[a][k] = e.p[a][k] * e.s[k];
    }
  const double* a = e.m[0];
  const double* b = e.m[1];
  const double aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
  const double bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
  // det(M M^T) is the sum of the squared minors of M (Cauchy-Binet): exact for needles and discs,
  // where cxx cyy - cxy^2 would cancel.
  e.n[0] = a[1] * b[2] - a[2] * b[1];
  e.n[1] = a[2] * b[0] - a[0] * b[2];
  e.n[2] = a[0] * b[1] - a[1] * b[0];
  e.sharp = e.n[0] * e.n[0] + e.n[1] * e.n[1] + e.n[2] * e.n[2];
  e.det = e.sharp + BLUR * (aa + bb) + BLUR * BLUR;
  e.cxx = aa + BLUR;
  e.cyy = bb + BLUR;
  e.cxy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  e.compensation = model.antialiased ? __builtin_sqrt(e.sharp / e.det) : 1;
}

struct Whitening {
  double l11, l12, l22;
};

INLINE Whitening whiten(const Ewa& e) {
  const double l11 = WHITEN * __builtin_sqrt(e.cyy / e.det);
  return {l11, -l11 * e.cxy / e.cyy, WHITEN / __builtin_sqrt(e.cyy)};
}

// Distance to the camera centre and the unit direction; all zero where they meet.
struct Ray {
  double x, y, z, distance, inverse;
};

INLINE Ray ray_to(const Camera& cam, const Lane16& in, int l) {
  const double x = in.mean[0][l] - cam.centre[0], y = in.mean[1][l] - cam.centre[1],
               z = in.mean[2][l] - cam.centre[2];
  const double d2 = x * x + y * y + z * z;
  const double distance = __builtin_sqrt(d2);
  const double inverse = pick(d2 > 0, 1 / pick(d2 > 0, distance, 1), 0);
  return {x * inverse, y * inverse, z * inverse, distance, inverse};
}

void project(const Camera& cam, const Model& model, const Projection& out, int64_t first, int64_t last) {
  for (int64_t i = first; i < last; i += L) {
    const int count = last - i < L ? (int)(last - i) : L;
    Lane16 in;
    gather(model, i, count, in);
    float geo[GEO][L], radius[L], dir[3][L];
    int drawn[L];
    for (int l = 0; l < L; ++l) {
      Ewa e;
      ewa(cam, model, in, l, e);
      const Whitening w = whiten(e);
      const double o = e.o * e.compensation;
      const double limit = logarithm2(255 * (o > 1e-6 ? o : 1e-6));
      const double reach2 = (limit > 0 ? limit : 0) / (WHITEN * WHITEN);
      const double hx = __builtin_sqrt(reach2 * e.cxx), hy = __builtin_sqrt(reach2 * e.cyy);
      const bool meets = (e.px + hx > 0) & (e.px - hx < cam.width) & (e.py + hy > 0) & (e.py - hy < cam.height);
      const bool finite = (e.det < 1e200) & (e.det > 0) & (o <= 1e30);
      const bool seen = e.front & meets & finite;
      radius[l] = (float)pick(seen & (255 * o > 1), hx > hy ? hx : hy, 0);
      drawn[l] = seen & (255 * o >= 1);
      const float xw = (float)__builtin_floor(e.px), yw = (float)__builtin_floor(e.py);
      const Ray ray = ray_to(cam, in, l);
      dir[0][l] = (float)ray.x;
      dir[1][l] = (float)ray.y;
      dir[2][l] = (float)ray.z;
      geo[X_WHOLE][l] = xw;
      geo[X_PART][l] = (float)(e.px - xw);
      geo[Y_WHOLE][l] = yw;
      geo[Y_PART][l] = (float)(e.py - yw);
      geo[L11][l] = (float)w.l11;
      geo[L12][l] = (float)w.l12;
      geo[L22][l] = (float)w.l22;
      geo[OPACITY][l] = (float)o;
      geo[LIMIT][l] = (float)limit;
      geo[SLOPE][l] = (float)(-e.cxy / e.cyy);
      geo[TIP][l] = (float)(e.cxy * __builtin_sqrt(reach2 / e.cxx));
      geo[INV_L11][l] = (float)(1 / w.l11);
      geo[HALF_X][l] = (float)hx;
      geo[HALF_Y][l] = (float)hy;
      geo[DEPTH][l] = (float)e.z;
      geo[DISTANCE][l] = (float)ray.distance;
    }
    int some = 0;
    for (int l = 0; l < count; ++l) {
      out.radii[i + l] = radius[l];
      out.drawn[i + l] = (uint8_t)drawn[l];
      some |= drawn[l];
    }
    if (!some) continue;
    if (count == L) transpose(&geo[0][0], L, out.geo + i * GEO, GEO);
    else
      for (int l = 0; l < count; ++l)
        for (int k = 0; k < GEO; ++k) out.geo[(i + l) * GEO + k] = geo[k][l];
    float* features = out.features + i * out.stride;
    if (model.sh) {
      float colour[3][L];
      sh_colour(model, i, count, dir, colour);
      for (int l = 0; l < count; ++l)
        for (int c = 0; c < 3; ++c) features[l * out.stride + c] = colour[c][l];
    } else {
      for (int l = 0; l < count; ++l)
        for (int c = 0; c < model.channels; ++c)
          features[l * out.stride + c] = model.colours[(i + l) * model.channels + c];
    }
    for (int l = 0; l < count; ++l) {
      features[l * out.stride + model.channels] = geo[DEPTH][l];
      features[l * out.stride + model.channels + 1] = geo[DISTANCE][l];
    }
  }
}

}  // namespace
