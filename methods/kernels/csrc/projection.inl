// Projection of Gaussians, sixteen lanes at a time, in double precision: float32 would lose 1e-4 px of a
// mean at x = 1000, the direction of needles, and overflow for Gaussians much larger than the scene.

namespace {

constexpr int L = LANES;

// Columns of [count, C] rows; lanes past `count` repeat the last row.
template <int C>
INLINE void gather_rows(const float* rows, int64_t first, int count, float (*out)[L]) {
  const float* from = rows + first * C;
  if (count == L) {
    split_columns<C>(from, out);
    return;
  }
  float some[C * L];
  for (int l = 0; l < L; ++l)
    for (int c = 0; c < C; ++c) some[C * l + c] = from[C * (l < count ? l : count - 1) + c];
  split_columns<C>(some, out);
}

// The other way, into rows [first, first + count); null is nowhere.
template <int C>
INLINE void scatter_rows(const float (*in)[L], float* rows, int64_t first, int count) {
  if (!rows) return;
  float* to = rows + first * C;
  if (count == L) {
    join_columns<C>(in, to);
    return;
  }
  float some[C * L];
  join_columns<C>(in, some);
  for (int i = 0; i < C * count; ++i) to[i] = some[i];
}

constexpr int64_t COMING = 2 * L;  // Gaussians after these that memory is asked for while these are worked on

// Fetch rows [first, first + LANES) of C numbers, to be read or written; null is nothing, as is
// what lies past an array's end.
template <int C, bool WRITE>
INLINE void fetch_rows(const float* rows, int64_t first) {
  if (!rows) return;
  for (int c = 0; c < C; ++c) __builtin_prefetch(rows + first * C + c * L, WRITE);
}

struct Lane16 {
  float mean[3][L], quaternion[4][L], scale[3][L], opacity[1][L];
};

INLINE void gather(const Model& model, int64_t first, int count, Lane16& in) {
  gather_rows<3>(model.means, first, count, in.mean);
  gather_rows<4>(model.quaternions, first, count, in.quaternion);
  gather_rows<3>(model.scales, first, count, in.scale);
  gather_rows<1>(model.opacities, first, count, in.opacity);
}

INLINE void fetch_model(const Model& model, int64_t first) {
  fetch_rows<3, false>(model.means, first);
  fetch_rows<4, false>(model.quaternions, first);
  fetch_rows<3, false>(model.scales, first);
  fetch_rows<1, false>(model.opacities, first);
}

INLINE vd clamp(vd x, double low, double high) {
  x = select(x < low, alld(low), x);
  return select(x > high, alld(high), x);
}
INLINE vd larger(vd a, vd b) { return select(a > b, a, b); }

// e^x, relative error below 1e-12: 2^whole times a Taylor sum on [-ln 2 / 2, ln 2 / 2].
INLINE vd exponential(vd x) {
  x = clamp(x, -700, 700);
  const vd shifted = x * 1.4426950408889634 + 6755399441055744.0;
  const vd whole = shifted - 6755399441055744.0;
  const vd f = (x - whole * 0.693147180369123816) - whole * 1.90821492927058770e-10;
  vd p = alld(1.0 / 3628800);
  constexpr double factors[] = {1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720, 1.0 / 120, 1.0 / 24, 1.0 / 6, 0.5, 1, 1};
  for (double factor : factors) p = p * f + factor;
  return scale_by(p, shifted);
}

// log2 of x in [2^-1000, 2^1000], absolute error below 1e-9.
INLINE vd logarithm2(vd x) {
  vd m, exponent;
  split_exponent(x, m, exponent);
  const vd s = (m - 1) / (m + 1), q = s * s;
  vd p = alld(2.0 / 11);
  constexpr double factors[] = {2.0 / 9, 2.0 / 7, 2.0 / 5, 2.0 / 3, 2};
  for (double factor : factors) p = p * q + factor;
  return exponent + 1.4426950408889634 * s * p;
}

// Everything that the forward and the backward pass need of eight Gaussians.
struct Ewa {
  maskd front, inside_x, inside_y, identity;
  vd x, y, z, iz, u, v, uc, vc;  // camera space; uc, vc clamped
  vd px, py;
  vd qw, qx, qy, qz, iq;         // unit quaternion, 1 / norm
  vd s[3], o;                    // standard deviations, opacity before compensation
  vd r[3][3];
  vd jw[2][3], p[2][3], m[2][3]; // J W, J W R, J W R S
  vd n[3], sharp, det;           // minors of M, det(M M^T), det(M M^T + 0.3 I)
  vd cxx, cxy, cyy, compensation;
};

INLINE void ewa(const Camera& cam, const Model& model, const Lane16& in, int l, Ewa& e) {
  const vd mx = widen(in.mean[0] + l), my = widen(in.mean[1] + l), mz = widen(in.mean[2] + l);
  const double* R = cam.rotation;
  const vd zero = alld(0), one = alld(1);
  e.z = R[6] * mx + R[7] * my + R[8] * mz + cam.translation[2];
  e.front = e.z > cam.near;
  e.x = select(e.front, R[0] * mx + R[1] * my + R[2] * mz + cam.translation[0], zero);
  e.y = select(e.front, R[3] * mx + R[4] * my + R[5] * mz + cam.translation[1], zero);
  e.z = select(e.front, e.z, one);
  e.iz = one / e.z;
  e.u = e.x * e.iz;
  e.v = e.y * e.iz;
  e.px = cam.k[0] * e.u + cam.k[1] * e.v + cam.k[2];
  e.py = cam.k[3] * e.u + cam.k[4] * e.v + cam.k[5];
  e.uc = clamp(e.u, cam.low_x, cam.high_x);
  e.vc = clamp(e.v, cam.low_y, cam.high_y);
  e.inside_x = e.uc == e.u;
  e.inside_y = e.vc == e.v;

  const vd w = widen(in.quaternion[0] + l), x = widen(in.quaternion[1] + l), y = widen(in.quaternion[2] + l),
           z = widen(in.quaternion[3] + l);
  const vd norm2 = w * w + x * x + y * y + z * z;
  e.identity = norm2 == zero;
  e.iq = one / square_root(select(e.identity, one, norm2));
  e.qw = select(e.identity, one, w * e.iq);
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

  for (int k = 0; k < 3; ++k) e.s[k] = widen(in.scale[k] + l);
  e.o = widen(in.opacity[0] + l);
  if (model.raw) {
    for (int k = 0; k < 3; ++k) e.s[k] = exponential(e.s[k]);
    e.o = one / (1 + exponential(zero - e.o));
  }

  const vd fx = cam.k[0] * e.iz, fy = cam.k[4] * e.iz;
  for (int i = 0; i < 3; ++i) {
    e.jw[0][i] = fx * (R[i] - e.uc * R[6 + i]);
    e.jw[1][i] = fy * (R[3 + i] - e.vc * R[6 + i]);
  }
  for (int a = 0; a < 2; ++a)
    for (int k = 0; k < 3; ++k) {
      e.p[a][k] = e.jw[a][0] * e.r[0][k] + e.jw[a][1] * e.r[1][k] + e.jw[a][2] * e.r[2][k];
      e.m[a][k] = e.p[a][k] * e.s[k];
    }
  const vd* a = e.m[0];
  const vd* b = e.m[1];
  const vd aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
  const vd bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
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
  e.compensation = model.antialiased ? square_root(e.sharp / e.det) : one;
}

struct Whitening {
  vd l11, l12, l22;
};

INLINE Whitening whiten(const Ewa& e) {
  const vd l11 = WHITEN * square_root(e.cyy / e.det);
  return {l11, alld(0) - l11 * e.cxy / e.cyy, WHITEN / square_root(e.cyy)};
}

// Distance to the camera centre and the unit direction; all zero where they meet.
struct Ray {
  vd x, y, z, distance, inverse;
};

INLINE Ray ray_to(const Camera& cam, const Lane16& in, int l) {
  const vd x = widen(in.mean[0] + l) - cam.centre[0], y = widen(in.mean[1] + l) - cam.centre[1],
           z = widen(in.mean[2] + l) - cam.centre[2];
  const vd d2 = x * x + y * y + z * z, distance = square_root(d2);
  const maskd apart = d2 > 0;
  const vd inverse = keep(apart, 1 / select(apart, distance, alld(1)));
  return {x * inverse, y * inverse, z * inverse, distance, inverse};
}

template <int N>
INLINE V<double, N> round_down(V<double, N> x) {
  if constexpr (leaf<double, N>) {
    V<double, N> r;
    for (int l = 0; l < N; ++l) r.v[l] = __builtin_floor(x.v[l]);
    return r;
  } else return {round_down(x.lo), round_down(x.hi)};
}

void project(const Camera& cam, const Model& model, const Projection& out, int64_t first, int64_t last) {
  for (int64_t i = first; i < last; i += L) {
    const int count = last - i < L ? (int)(last - i) : L;
    fetch_model(model, i + COMING);
    fetch_sh(coefficients(model, model.sh, model.sh_rest), i + COMING, with_sh(model, i + COMING, L));
    Lane16 in;
    gather(model, i, count, in);
    alignas(64) float geo[GEO][L], radius[L], dir[3][L], distance[L];
    unsigned drawn = 0;
    for (int l = 0; l < L; l += HALF) {
      Ewa e;
      ewa(cam, model, in, l, e);
      const Whitening w = whiten(e);
      const vd o = e.o * e.compensation;
      const vd limit = logarithm2(255 * select((o > 1e-6) & (o < 1e30), o, alld(1e-6)));
      const vd reach2 = clamp(limit, 0, model.reach) * (1 / (WHITEN * WHITEN));
      const vd hx = square_root(reach2 * e.cxx), hy = square_root(reach2 * e.cyy);
      const maskd meets = (e.px + hx > 0) & (e.px - hx < cam.width) & (e.py + hy > 0) & (e.py - hy < cam.height);
      const maskd finite = (e.det < 1e200) & (e.det > 0) & (o < 1e30);
      const maskd seen = e.front & meets & finite;
      narrow(radius + l, keep(seen & (255 * o > 1), larger(hx, hy)));
      drawn |= bits(seen & (255 * o >= 1)) << l;
      const Ray ray = ray_to(cam, in, l);
      narrow(dir[0] + l, ray.x);
      narrow(dir[1] + l, ray.y);
      narrow(dir[2] + l, ray.z);
      for (int axis = 0; axis < 2; ++axis) {
        const vd position = axis ? e.py : e.px;
        float* whole = geo[axis ? Y_WHOLE : X_WHOLE] + l;
        narrow(whole, round_down(position));
        narrow(geo[axis ? Y_PART : X_PART] + l, position - widen(whole));
      }
      narrow(geo[L11] + l, w.l11);
      narrow(geo[L12] + l, w.l12);
      narrow(geo[L22] + l, w.l22);
      narrow(geo[OPACITY] + l, o);
      narrow(geo[TIP] + l, e.cxy * square_root(reach2 / e.cxx));
      narrow(geo[INV_L11] + l, clamp(1 / w.l11, 0, 1e30));  // times l12 it must not be 0 times infinity
      narrow(geo[LOG_OPACITY] + l, limit - 7.99435343685885793);
      narrow(geo[HALF_Y] + l, hy);
      narrow(geo[DEPTH] + l, e.z);
      narrow(distance + l, ray.distance);
    }
    if (count < L) drawn &= (1u << count) - 1;
    for (int l = 0; l < count; ++l) {
      out.radii[i + l] = radius[l];
      out.drawn[i + l] = (uint8_t)(drawn >> l & 1);
    }
    if (!drawn) continue;
    const int lit = with_sh(model, i, count);
    const auto colour_of = [&](int l) { return model.colours + (i + l - model.sh_count) * model.channels; };
    if (lit) {
      sh_colour(model, i, lit, dir, geo + COLOUR);
      for (int c = 0; c < 3; ++c) {
        const unsigned above = bits(load(geo[COLOUR + c]) > all(0)) & drawn;
        for (int l = 0; l < lit; ++l) out.drawn[i + l] |= (uint8_t)((above >> l & 1) * (LIT << c));
      }
    }
    for (int l = lit; l < L; ++l)
      for (int c = 0; c < 3; ++c) geo[COLOUR + c][l] = model.channels == 3 && l < count ? colour_of(l)[c] : 0;
    if (count == L) transpose(&geo[0][0], L, out.geo + i * GEO, GEO);
    else
      for (int l = 0; l < count; ++l)
        for (int k = 0; k < GEO; ++k) out.geo[(i + l) * GEO + k] = geo[k][l];
    if (!out.features) continue;
    for (int l = 0; l < count; ++l) {
      float* row = out.features + (i + l) * out.stride;
      for (int c = 0; c < model.channels; ++c) row[c] = l < lit ? geo[COLOUR + c][l] : colour_of(l)[c];
      row[model.channels] = geo[DEPTH][l];
      row[model.channels + 1] = distance[l];
    }
  }
}

}  // namespace
