// From the gradient sums of each Gaussian to the gradients of its parameters, sixteen lanes at a time.

namespace {

struct Sums16 {
  float geometry[S_FEATURES][L];
  float colour[MAX_CHANNELS][L];
  float depth[L], distance[L];
};

// Add up the rows that tiles left for sixteen Gaussians, in the order of the tiles.
INLINE void collect(const float* sums, int stride, int channels, int features, const uint32_t* slot_start,
                    const uint32_t* slots, int64_t first, int count, Sums16& out) {
  for (int l = 0; l < L; ++l) {
    float row[S_FEATURES + MAX_CHANNELS + 2 + L];
    const int width = S_FEATURES + features;
    for (int j = 0; j < S_FEATURES + channels + 2; ++j) row[j] = 0;
    if (l < count)
      for (uint32_t k = slot_start[first + l]; k < slot_start[first + l + 1]; ++k) {
        if (k + 4 < slot_start[first + count]) __builtin_prefetch(sums + (size_t)slots[k + 4] * stride);
        const float* part = sums + (size_t)slots[k] * stride;
        for (int j = 0; j < width; ++j) row[j] += part[j];
      }
    for (int j = 0; j < S_FEATURES; ++j) out.geometry[j][l] = row[j];
    for (int c = 0; c < channels; ++c) out.colour[c][l] = row[S_FEATURES + c];
    out.depth[l] = row[S_FEATURES + channels];
    out.distance[l] = row[S_FEATURES + channels + 1];
  }
}

// Largest float32 rather than infinity, as for a quaternion of norm 1e-40.
INLINE float finite(double x) { return (float)clamp(x, -3.4e38, 3.4e38); }

void backward_project(const Camera& cam, const Model& model, const Projection& drawn, const float* sums,
                      int sums_stride, int features, const uint32_t* slot_start, const uint32_t* slots,
                      const ModelGradients& out, int64_t first, int64_t last) {
  for (int64_t i = first; i < last; i += L) {
    const int count = last - i < L ? (int)(last - i) : L;
    float mean[3][L] = {}, quaternion[4][L] = {}, scale[3][L] = {}, opacity[L] = {}, screen[4][L] = {};
    const int channels = model.channels;
    if (slot_start[i] == slot_start[i + count]) {  // none was drawn
      if (out.sh)
        for (int64_t j = i * 3 * model.sh_stored; j < (i + count) * 3 * model.sh_stored; ++j) out.sh[j] = 0;
      if (out.colours)
        for (int64_t j = i * channels; j < (i + count) * channels; ++j) out.colours[j] = 0;
    } else {
      Lane16 in;
      gather(model, i, count, in);
      Sums16 g;
      collect(sums, sums_stride, channels, features, slot_start, slots, i, count, g);
      int visible[L];
      for (int l = 0; l < L; ++l)
        visible[l] = l < count && slot_start[i + l] < slot_start[i + l + 1];
      float towards[3][L] = {}, dir[3][L];
      if (model.sh) {
        float colour[3][L];
        for (int l = 0; l < L; ++l) {
          const Ray ray = ray_to(cam, in, l);
          dir[0][l] = visible[l] ? (float)ray.x : 0;
          dir[1][l] = visible[l] ? (float)ray.y : 0;
          dir[2][l] = visible[l] ? (float)ray.z : 0;
          const float* value = drawn.features + (i + (l < count ? l : 0)) * drawn.stride;
          for (int c = 0; c < 3; ++c)  // no gradient where the colour is clamped at 0
            colour[c][l] = visible[l] && value[c] > 0 ? g.colour[c][l] : 0;
        }
        sh_backward(model, i, count, dir, colour, out.sh, towards);
      } else if (out.colours) {
        for (int l = 0; l < count; ++l)
          for (int c = 0; c < channels; ++c) out.colours[(i + l) * channels + c] = g.colour[c][l];
      }
      for (int l = 0; l < L; ++l) {
        Ewa e;
        ewa(cam, model, in, l, e);
        const Whitening w = whiten(e);
        const double* R = cam.rotation;
        const double back = 1 / (WHITEN * WHITEN);
        const double su = g.geometry[S_GU][l], sv = g.geometry[S_GV][l];
        const double dpx = back * w.l11 * su, dpy = back * (w.l12 * su + w.l22 * sv);
        screen[0][l] = (float)dpx;
        screen[1][l] = (float)dpy;
        screen[2][l] = (float)(back * w.l11 * g.geometry[S_ABS_X][l]);
        screen[3][l] = (float)(back * g.geometry[S_ABS_Y][l]);

        // covariance: d ln(alpha) / d Sigma2 = (Sigma2^-1 d)(Sigma2^-1 d)^T / 2
        const double suu = g.geometry[S_GUU][l], suv = g.geometry[S_GUV][l], svv = g.geometry[S_GVV][l];
        const double half = 0.5 * back * back;
        const double gxx = half * w.l11 * w.l11 * suu;
        const double gxy = half * w.l11 * (w.l12 * suu + w.l22 * suv);
        const double gyy = half * (w.l12 * w.l12 * suu + 2 * w.l12 * w.l22 * suv + w.l22 * w.l22 * svv);
        double dm[2][3], dn[3];
        const double o = e.o * e.compensation;
        const double d_drawn = g.geometry[S_G][l] / pick(o > 0, o, 1);
        const double d_comp = model.antialiased ? d_drawn * e.o : 0;
        const double root = pick(e.sharp > 0, 1 / __builtin_sqrt(pick(e.sharp > 0, e.sharp, 1) * e.det), 0);
        const double ratio = e.compensation / e.det;
        for (int k = 0; k < 3; ++k) {
          dm[0][k] = 2 * (gxx * e.m[0][k] + gxy * e.m[1][k]) - d_comp * ratio * BLUR * e.m[0][k];
          dm[1][k] = 2 * (gxy * e.m[0][k] + gyy * e.m[1][k]) - d_comp * ratio * BLUR * e.m[1][k];
          dn[k] = d_comp * (root - ratio) * e.n[k];
        }
        for (int k = 0; k < 3; ++k) {
          const int a = (k + 1) % 3, b = (k + 2) % 3;
          dm[0][k] += e.m[1][a] * dn[b] - e.m[1][b] * dn[a];
          dm[1][k] += dn[a] * e.m[0][b] - dn[b] * e.m[0][a];
        }

        double dr[3][3], ds[3], djw[2][3] = {};
        for (int k = 0; k < 3; ++k) {
          ds[k] = dm[0][k] * e.p[0][k] + dm[1][k] * e.p[1][k];
          const double dp0 = dm[0][k] * e.s[k], dp1 = dm[1][k] * e.s[k];
          for (int j = 0; j < 3; ++j) {
            dr[j][k] = e.jw[0][j] * dp0 + e.jw[1][j] * dp1;
            djw[0][j] += dp0 * e.r[j][k];
            djw[1][j] += dp1 * e.r[j][k];
          }
        }
        const double x = e.qx, y = e.qy, z = e.qz, q = e.qw;
        double dq[4];
        dq[0] = 2 * (-z * dr[0][1] + y * dr[0][2] + z * dr[1][0] - x * dr[1][2] - y * dr[2][0] + x * dr[2][1]);
        dq[1] = 2 * (y * dr[0][1] + z * dr[0][2] + y * dr[1][0] - 2 * x * dr[1][1] - q * dr[1][2] +
                     z * dr[2][0] + q * dr[2][1] - 2 * x * dr[2][2]);
        dq[2] = 2 * (-2 * y * dr[0][0] + x * dr[0][1] + q * dr[0][2] + x * dr[1][0] + z * dr[1][2] -
                     q * dr[2][0] + z * dr[2][1] - 2 * y * dr[2][2]);
        dq[3] = 2 * (-2 * z * dr[0][0] - q * dr[0][1] + x * dr[0][2] + q * dr[1][0] - 2 * z * dr[1][1] +
                     y * dr[1][2] + x * dr[2][0] + y * dr[2][1]);
        const double along = q * dq[0] + x * dq[1] + y * dq[2] + z * dq[3];
        const double iq = pick(e.identity, 0, e.iq);
        quaternion[0][l] = finite(iq * (dq[0] - q * along));
        quaternion[1][l] = finite(iq * (dq[1] - x * along));
        quaternion[2][l] = finite(iq * (dq[2] - y * along));
        quaternion[3][l] = finite(iq * (dq[3] - z * along));
        for (int k = 0; k < 3; ++k) scale[k][l] = finite(ds[k] * (model.raw ? e.s[k] : 1));
        opacity[l] = finite(d_drawn * e.compensation * (model.raw ? e.o * (1 - e.o) : 1));

        // camera-space mean: through J, the pixel position and the depth
        double by_w0 = 0, by_wx = 0, by_w1 = 0, by_wy = 0;
        for (int j = 0; j < 3; ++j) {
          by_w0 += djw[0][j] * R[j];
          by_wx += djw[0][j] * R[6 + j];
          by_w1 += djw[1][j] * R[3 + j];
          by_wy += djw[1][j] * R[6 + j];
        }
        const double fx = cam.k[0], fy = cam.k[4];
        double diz = fx * (by_w0 - e.uc * by_wx) + fy * (by_w1 - e.vc * by_wy);
        double du = cam.k[0] * dpx + cam.k[3] * dpy - pick(e.inside_x, fx * e.iz * by_wx, 0);
        double dv = cam.k[1] * dpx + cam.k[4] * dpy - pick(e.inside_y, fy * e.iz * by_wy, 0);
        diz += du * e.x + dv * e.y;
        const double dx = du * e.iz, dy = dv * e.iz, dz = g.depth[l] - diz * e.iz * e.iz;

        // world mean: also through the viewing direction and the distance
        const Ray ray = ray_to(cam, in, l);
        const double tx = towards[0][l], ty = towards[1][l], tz = towards[2][l];
        const double radial = g.distance[l] - ray.inverse * (tx * ray.x + ty * ray.y + tz * ray.z);
        mean[0][l] = finite(R[0] * dx + R[3] * dy + R[6] * dz + ray.inverse * tx + radial * ray.x);
        mean[1][l] = finite(R[1] * dx + R[4] * dy + R[7] * dz + ray.inverse * ty + radial * ray.y);
        mean[2][l] = finite(R[2] * dx + R[5] * dy + R[8] * dz + ray.inverse * tz + radial * ray.z);
      }
      for (int l = 0; l < L; ++l) {
        if (visible[l]) continue;
        for (int k = 0; k < 3; ++k) mean[k][l] = scale[k][l] = 0;
        for (int k = 0; k < 4; ++k) quaternion[k][l] = screen[k][l] = 0;
        opacity[l] = 0;
      }
    }
    for (int l = 0; l < count; ++l) {
      const int64_t n = i + l;
      for (int k = 0; out.means && k < 3; ++k) out.means[3 * n + k] = mean[k][l];
      for (int k = 0; out.quaternions && k < 4; ++k) out.quaternions[4 * n + k] = quaternion[k][l];
      for (int k = 0; out.scales && k < 3; ++k) out.scales[3 * n + k] = scale[k][l];
      if (out.opacities) out.opacities[n] = opacity[l];
      for (int k = 0; out.screen && k < 2; ++k) out.screen[2 * n + k] = screen[k][l];
      for (int k = 0; out.screen_absolute && k < 2; ++k) out.screen_absolute[2 * n + k] = screen[2 + k][l];
    }
  }
}

}  // namespace
