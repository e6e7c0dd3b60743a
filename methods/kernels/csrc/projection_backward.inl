// From the gradient sums of each Gaussian to the gradients of its parameters, sixteen lanes at a time.

namespace {

constexpr int MOST_SUMS = (S_FEATURES + MAX_CHANNELS + 2 + L - 1) / L * L;

// Add up the rows that tiles left for sixteen Gaussians, in the order of the tiles: out[sum][lane].
STAGE void collect(const float* sums, int stride, const uint32_t* row_start, int64_t first, int count,
                   float out[MOST_SUMS][L]) {
  alignas(64) float rows[L][L];
  for (int part = 0; part < stride; part += L) {
    for (int l = 0; l < L; ++l) {
      vf row = all(0);
      if (l < count)
        for (uint32_t k = row_start[first + l]; k < row_start[first + l + 1]; ++k)
          row = row + load(sums + (size_t)k * stride + part);
      store(rows[l], row);
    }
    transpose(rows[0], L, out[part], L);
  }
  for (int j = stride; j < MOST_SUMS; ++j) store(out[j], all(0));
}

INLINE void fetch_gradients(const ModelGradients& out, int64_t first) {
  fetch_rows<3, true>(out.means, first);
  fetch_rows<4, true>(out.quaternions, first);
  fetch_rows<3, true>(out.scales, first);
  fetch_rows<1, true>(out.opacities, first);
  fetch_rows<2, true>(out.screen, first);
}

// As float32, the largest one rather than infinity, as for a quaternion of norm 1e-40.
INLINE void put(float* p, vd x) { narrow(p, clamp(x, -3.4e38, 3.4e38)); }

void backward_project(const Camera& cam, const Model& model, const Projection& drawn, const float* sums,
                      int sums_stride, const uint32_t* row_start, const ModelGradients& out, int64_t first,
                      int64_t last) {
  for (int64_t i = first; i < last; i += L) {
    const int count = last - i < L ? (int)(last - i) : L;
    fetch_model(model, i + COMING);
    fetch_gradients(out, i + COMING);
    float mean[3][L] = {}, quaternion[4][L] = {}, scale[3][L] = {}, opacity[1][L] = {}, screen[4][L] = {};
    const int channels = model.channels, lit = with_sh(model, i, count);
    if (row_start[i] == row_start[i + count]) {  // none was drawn
      sh_clear(model, i, lit, out);
      for (int l = lit; out.colours && l < count; ++l)
        for (int c = 0; c < channels; ++c) out.colours[(i + l - model.sh_count) * channels + c] = 0;
      for (int l = 0; out.fragments && l < 3 * count; ++l) out.fragments[3 * i + l] = 0;
    } else {
      Lane16 in;
      gather(model, i, count, in);
      alignas(64) float g[MOST_SUMS][L];
      collect(sums, sums_stride, row_start, i, count, g);
      int visible[L];
      for (int l = 0; l < L; ++l)
        visible[l] = l < count && row_start[i + l] < row_start[i + l + 1];
      float towards[3][L] = {}, dir[3][L];
      if (lit) {
        float colour[3][L];
        for (int l = 0; l < L; l += HALF) {
          const Ray ray = ray_to(cam, in, l);
          narrow(dir[0] + l, ray.x);
          narrow(dir[1] + l, ray.y);
          narrow(dir[2] + l, ray.z);
        }
        for (int l = 0; l < L; ++l) {
          const int lit_by = l < lit && visible[l] ? drawn.drawn[i + l] : 0;
          for (int c = 0; c < 3; ++c) {
            colour[c][l] = lit_by & LIT << c ? g[S_FEATURES + c][l] : 0;  // none where the colour is clamped at 0
            dir[c][l] = visible[l] ? dir[c][l] : 0;
          }
        }
        sh_backward(model, i, lit, dir, colour, out, towards);
      }
      for (int l = lit; out.colours && l < count; ++l)
        for (int c = 0; c < channels; ++c) out.colours[(i + l - model.sh_count) * channels + c] = g[S_FEATURES + c][l];
      for (int l = 0; out.fragments && l < count; ++l) {
        float* fragment = out.fragments + 3 * (i + l);
        fragment[0] = g[S_G][l];
        fragment[1] = g[S_SQUARES][l];
        fragment[2] = g[S_COUNT][l];
      }
      if (!needs_shapes(out)) continue;
      fetch_sh(coefficients(model, model.sh, model.sh_rest), i + L, with_sh(model, i + L, L));  // here memory is idle
      for (int l = 0; l < L; l += HALF) {
        Ewa e;
        ewa(cam, model, in, l, e);
        const Whitening w = whiten(e);
        const double* R = cam.rotation;
        const double back = 1 / (WHITEN * WHITEN);
        const vd zero = alld(0), one = alld(1);
        const vd su = widen(g[S_GU] + l), sv = widen(g[S_GV] + l);
        const vd dpx = back * w.l11 * su, dpy = back * (w.l12 * su + w.l22 * sv);
        narrow(screen[0] + l, dpx);
        narrow(screen[1] + l, dpy);
        narrow(screen[2] + l, back * w.l11 * widen(g[S_ABS_X] + l));
        narrow(screen[3] + l, back * widen(g[S_ABS_Y] + l));

        // covariance: d ln(alpha) / d Sigma2 = (Sigma2^-1 d)(Sigma2^-1 d)^T / 2
        const vd suu = widen(g[S_GUU] + l), suv = widen(g[S_GUV] + l), svv = widen(g[S_GVV] + l);
        const double half = 0.5 * back * back;
        const vd gxx = half * w.l11 * w.l11 * suu;
        const vd gxy = half * w.l11 * (w.l12 * suu + w.l22 * suv);
        const vd gyy = half * (w.l12 * w.l12 * suu + 2 * w.l12 * w.l22 * suv + w.l22 * w.l22 * svv);
        vd dm[2][3], dn[3];
        const vd o = e.o * e.compensation;
        const vd d_drawn = widen(g[S_G] + l) / select(o > 0, o, one);
        const vd d_comp = model.antialiased ? d_drawn * e.o : zero;
        const maskd flat = e.sharp > 0;
        // 1 / sqrt(sharp det): the product of two squared areas is beyond a double from scales of 1e37 on
        const vd area = select(flat, e.sharp, one), both = area * e.det;
        const vd root = keep(flat, select(both < 1e300, 1 / square_root(both), e.compensation / area));
        const vd ratio = e.compensation / e.det;
        for (int k = 0; k < 3; ++k) {
          dm[0][k] = 2 * (gxx * e.m[0][k] + gxy * e.m[1][k]) - d_comp * ratio * BLUR * e.m[0][k];
          dm[1][k] = 2 * (gxy * e.m[0][k] + gyy * e.m[1][k]) - d_comp * ratio * BLUR * e.m[1][k];
          dn[k] = d_comp * (root - ratio) * e.n[k];
        }
        for (int k = 0; k < 3; ++k) {
          const int a = (k + 1) % 3, b = (k + 2) % 3;
          dm[0][k] = dm[0][k] + (e.m[1][a] * dn[b] - e.m[1][b] * dn[a]);
          dm[1][k] = dm[1][k] + (dn[a] * e.m[0][b] - dn[b] * e.m[0][a]);
        }

        vd dr[3][3], ds[3], djw[2][3] = {{zero, zero, zero}, {zero, zero, zero}};
        for (int k = 0; k < 3; ++k) {
          ds[k] = dm[0][k] * e.p[0][k] + dm[1][k] * e.p[1][k];
          const vd dp0 = dm[0][k] * e.s[k], dp1 = dm[1][k] * e.s[k];
          for (int j = 0; j < 3; ++j) {
            dr[j][k] = e.jw[0][j] * dp0 + e.jw[1][j] * dp1;
            djw[0][j] = djw[0][j] + (dp0 * e.r[j][k]);
            djw[1][j] = djw[1][j] + (dp1 * e.r[j][k]);
          }
        }
        const vd x = e.qx, y = e.qy, z = e.qz, q = e.qw;
        vd dq[4];
        dq[0] = 2 * ((zero - z) * dr[0][1] + y * dr[0][2] + z * dr[1][0] - x * dr[1][2] - y * dr[2][0] + x * dr[2][1]);
        dq[1] = 2 * (y * dr[0][1] + z * dr[0][2] + y * dr[1][0] - 2 * x * dr[1][1] - q * dr[1][2] +
                     z * dr[2][0] + q * dr[2][1] - 2 * x * dr[2][2]);
        dq[2] = 2 * (-2 * y * dr[0][0] + x * dr[0][1] + q * dr[0][2] + x * dr[1][0] + z * dr[1][2] -
                     q * dr[2][0] + z * dr[2][1] - 2 * y * dr[2][2]);
        dq[3] = 2 * (-2 * z * dr[0][0] - q * dr[0][1] + x * dr[0][2] + q * dr[1][0] - 2 * z * dr[1][1] +
                     y * dr[1][2] + x * dr[2][0] + y * dr[2][1]);
        const vd along = q * dq[0] + x * dq[1] + y * dq[2] + z * dq[3];
        const vd iq = select(e.identity, zero, e.iq);
        put(quaternion[0] + l, iq * (dq[0] - q * along));
        put(quaternion[1] + l, iq * (dq[1] - x * along));
        put(quaternion[2] + l, iq * (dq[2] - y * along));
        put(quaternion[3] + l, iq * (dq[3] - z * along));
        for (int k = 0; k < 3; ++k) put(scale[k] + l, model.raw ? ds[k] * e.s[k] : ds[k]);
        const vd by_opacity = d_drawn * e.compensation;
        put(opacity[0] + l, model.raw ? by_opacity * e.o * (1 - e.o) : by_opacity);

        // camera-space mean: through J, the pixel position and the depth
        vd by_w0 = zero, by_wx = zero, by_w1 = zero, by_wy = zero;
        for (int j = 0; j < 3; ++j) {
          by_w0 = by_w0 + djw[0][j] * R[j];
          by_wx = by_wx + djw[0][j] * R[6 + j];
          by_w1 = by_w1 + djw[1][j] * R[3 + j];
          by_wy = by_wy + djw[1][j] * R[6 + j];
        }
        const double fx = cam.k[0], fy = cam.k[4];
        vd diz = fx * (by_w0 - e.uc * by_wx) + fy * (by_w1 - e.vc * by_wy);
        vd du = cam.k[0] * dpx + cam.k[3] * dpy - keep(e.inside_x, fx * e.iz * by_wx);
        vd dv = cam.k[1] * dpx + cam.k[4] * dpy - keep(e.inside_y, fy * e.iz * by_wy);
        diz = diz + (du * e.x + dv * e.y);
        const vd dx = du * e.iz, dy = dv * e.iz, dz = widen(g[S_FEATURES + channels] + l) - diz * e.iz * e.iz;

        // world mean: also through the viewing direction and the distance
        const Ray ray = ray_to(cam, in, l);
        const vd tx = widen(towards[0] + l), ty = widen(towards[1] + l), tz = widen(towards[2] + l);
        const vd radial = widen(g[S_FEATURES + channels + 1] + l) - ray.inverse * (tx * ray.x + ty * ray.y + tz * ray.z);
        put(mean[0] + l, R[0] * dx + R[3] * dy + R[6] * dz + ray.inverse * tx + radial * ray.x);
        put(mean[1] + l, R[1] * dx + R[4] * dy + R[7] * dz + ray.inverse * ty + radial * ray.y);
        put(mean[2] + l, R[2] * dx + R[5] * dy + R[8] * dz + ray.inverse * tz + radial * ray.z);
      }
      for (int l = 0; l < L; ++l) {
        if (visible[l]) continue;
        for (int k = 0; k < 3; ++k) mean[k][l] = scale[k][l] = 0;
        for (int k = 0; k < 4; ++k) quaternion[k][l] = screen[k][l] = 0;
        opacity[0][l] = 0;
      }
    }
    scatter_rows<3>(mean, out.means, i, count);
    scatter_rows<4>(quaternion, out.quaternions, i, count);
    scatter_rows<3>(scale, out.scales, i, count);
    scatter_rows<1>(opacity, out.opacities, i, count);
    scatter_rows<2>(screen, out.screen, i, count);
    scatter_rows<2>(screen + 2, out.screen_absolute, i, count);
  }
  stored_past();
}

}  // namespace
