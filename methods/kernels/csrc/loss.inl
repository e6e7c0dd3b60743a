// L1 and SSIM of an image against a photo, and their gradient. Rows are interleaved channels, so a window that
// moves by one pixel moves by `channels` floats and no channel needs a plane of its own.

namespace {

constexpr int REACH = 5;  // the window has 2 * 5 + 1 taps
constexpr int MAPS = 5;   // a, b, a^2, b^2, a b
constexpr float SSIM_C1 = 1e-4f, SSIM_C2 = 9e-4f;

// A row of `width` floats with room for the window on both sides, zero there.
INLINE float* padded(float* memory, int channels) { return memory + (REACH * channels + L - 1) / L * L; }

// out = row convolved with the taps along x. Both have room up to a multiple of 16 floats.
INLINE void blur_row(const float* row, float* out, int floats, int channels, const float* taps) {
  for (int i = 0; i < floats; i += L) {
    vf sum = load(row + i) * all(taps[0]);
    for (int k = 1; k <= REACH; ++k)
      sum = sum + (load(row + i - k * channels) + load(row + i + k * channels)) * all(taps[k]);
    store(out + i, sum);
  }
}

INLINE vf blur_column(const float* const* rows, int i, const float* taps) {
  vf sum = load(rows[REACH] + i) * all(taps[0]);
  for (int k = 1; k <= REACH; ++k) sum = sum + (load(rows[REACH - k] + i) + load(rows[REACH + k] + i)) * all(taps[k]);
  return sum;
}

INLINE float row_sum(vf v) {
  float values[L], sum = 0;
  store(values, v);
  for (int l = 0; l < L; ++l) sum += values[l];
  return sum;
}

// Copy one row of the image, black where the mask is not set; lanes past the end are zero.
INLINE void read_row(const float* image, const uint8_t* mask, const Loss& loss, int y, float* out) {
  const int floats = loss.width * loss.channels;
  const float* row = image + (size_t)y * floats;
  if (!mask) {
    __builtin_memcpy(out, row, floats * sizeof(float));
    return;
  }
  for (int x = 0; x < loss.width; ++x)
    for (int c = 0; c < loss.channels; ++c)
      out[x * loss.channels + c] = mask[(size_t)y * loss.width + x] ? row[x * loss.channels + c] : 0;
}

// 1 where a pixel counts, for each float of a row; zero past the end.
INLINE void read_valid(const Loss& loss, int y, float* out) {
  for (int x = 0; x < loss.width; ++x)
    for (int c = 0; c < loss.channels; ++c)
      out[x * loss.channels + c] = !loss.mask || loss.mask[(size_t)y * loss.width + x] ? 1.0f : 0.0f;
}

// Rows [first, last): sums of |a - b| and of SSIM into loss.sums, and SSIM's derivatives by the local means of
// a, a^2 and a b into loss.maps.
void loss_maps(const Loss& loss, float* scratch, int first, int last) {
  const int floats = loss.width * loss.channels, room = loss.row_floats, channels = loss.channels;
  float* memory = scratch;
  float* rows[MAPS];
  for (int m = 0; m < MAPS; ++m, memory += room) rows[m] = padded(memory, channels);
  float* valid = padded(memory, channels);
  memory += room;
  float* ring[2 * REACH + 1][MAPS];
  for (int r = 0; r <= 2 * REACH; ++r)
    for (int m = 0; m < MAPS; ++m, memory += room) ring[r][m] = memory;

  for (int y = first - REACH; y < last + REACH; ++y) {
    float** blurred = ring[(y + 2 * REACH + 1) % (2 * REACH + 1)];
    if (y < 0 || y >= loss.height) {
      for (int m = 0; m < MAPS; ++m)
        for (int i = 0; i < floats; i += L) store(blurred[m] + i, all(0));
    } else {
      read_row(loss.image, loss.mask, loss, y, rows[0]);
      read_row(loss.truth, loss.mask, loss, y, rows[1]);
      for (int i = 0; i < floats; i += L) {
        const vf a = load(rows[0] + i), b = load(rows[1] + i);
        store(rows[2] + i, a * a);
        store(rows[3] + i, b * b);
        store(rows[4] + i, a * b);
      }
      for (int m = 0; m < MAPS; ++m) blur_row(rows[m], blurred[m], floats, channels, loss.taps);
    }
    const int centre = y - REACH;
    if (centre < first) continue;
    const float* column[MAPS][2 * REACH + 1];
    for (int m = 0; m < MAPS; ++m)
      for (int k = 0; k <= 2 * REACH; ++k)
        column[m][k] = ring[(centre - REACH + k + 2 * REACH + 1) % (2 * REACH + 1)][m];
    read_valid(loss, centre, valid);
    vf similar = all(0);
    for (int i = 0; i < floats; i += L) {
      const vf ma = blur_column(column[0], i, loss.taps), mb = blur_column(column[1], i, loss.taps);
      const vf sa = blur_column(column[2], i, loss.taps) - ma * ma;
      const vf sb = blur_column(column[3], i, loss.taps) - mb * mb;
      const vf sab = blur_column(column[4], i, loss.taps) - ma * mb;
      // past the row's end `valid` is 0, so the maps are 0 there, as the second pass needs them
      const vf two = all(2), a1 = two * ma * mb + all(SSIM_C1), a2 = two * sab + all(SSIM_C2);
      const vf b1 = ma * ma + mb * mb + all(SSIM_C1), b2 = sa + sb + all(SSIM_C2);
      const vf scale = load(valid + i) / (b1 * b2);
      const vf s = a1 * a2 * scale, by_ab = two * a1 * scale, by_aa = all(0) - s / b2;
      const vf by_a = two * mb * (a2 - a1) * scale - two * ma * (s / b1 + by_aa);
      similar = similar + s;
      float* out = loss.maps + (size_t)centre * 3 * room;
      store(padded(out, channels) + i, by_a);
      store(padded(out + room, channels) + i, by_aa);
      store(padded(out + 2 * room, channels) + i, by_ab);
    }
    loss.sums[2 * centre + 1] = row_sum(similar);
  }
  for (int y = first; y < last; ++y) {
    read_row(loss.image, loss.mask, loss, y, rows[0]);
    read_row(loss.truth, loss.mask, loss, y, rows[1]);
    vf sum = all(0);
    for (int i = 0; i < floats; i += L) sum = sum + absolute(load(rows[0] + i) - load(rows[1] + i));
    loss.sums[2 * y] = row_sum(sum);
  }
}

// Rows [first, last) of the gradient by the image.
void loss_gradient(const Loss& loss, float* scratch, int first, int last) {
  const int floats = loss.width * loss.channels, room = loss.row_floats, channels = loss.channels;
  float* memory = scratch;
  float *a = padded(memory, channels), *b = padded(memory + room, channels), *valid = padded(memory + 2 * room, channels),
        *out = padded(memory + 3 * room, channels);
  memory += 4 * room;
  float* ring[2 * REACH + 1][3];
  for (int r = 0; r <= 2 * REACH; ++r)
    for (int m = 0; m < 3; ++m, memory += room) ring[r][m] = memory;
  for (int y = first - REACH; y < last + REACH; ++y) {
    float** blurred = ring[(y + 2 * REACH + 1) % (2 * REACH + 1)];
    for (int m = 0; m < 3; ++m) {
      if (y < 0 || y >= loss.height)
        for (int i = 0; i < floats; i += L) store(blurred[m] + i, all(0));
      else blur_row(padded(loss.maps + ((size_t)y * 3 + m) * room, channels), blurred[m], floats, channels, loss.taps);
    }
    const int centre = y - REACH;
    if (centre < first) continue;
    const float* column[3][2 * REACH + 1];
    for (int m = 0; m < 3; ++m)
      for (int k = 0; k <= 2 * REACH; ++k)
        column[m][k] = ring[(centre - REACH + k + 2 * REACH + 1) % (2 * REACH + 1)][m];
    read_row(loss.image, loss.mask, loss, centre, a);
    read_row(loss.truth, loss.mask, loss, centre, b);
    read_valid(loss, centre, valid);
    for (int i = 0; i < floats; i += L) {
      const vf va = load(a + i), vb = load(b + i);
      const vf by_ssim = blur_column(column[0], i, loss.taps) + all(2) * va * blur_column(column[1], i, loss.taps) +
                         vb * blur_column(column[2], i, loss.taps);
      const vf sign = keep(vb < va, all(1)) - keep(va < vb, all(1));
      store(out + i, load(valid + i) * (all(loss.l1_weight) * sign - all(loss.ssim_weight) * by_ssim));
    }
    __builtin_memcpy(loss.gradient + (size_t)centre * floats, out, floats * sizeof(float));
  }
}

}  // namespace
