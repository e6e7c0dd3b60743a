// Idealised inner loops, compiled once for each SIMD level: everything in the first-level cache, every lane used,
// several blocks of sixteen pixels in flight. They keep the arithmetic and the tests of the image's definition
// (alpha >= 1/255, cap, stop) and leave out lists, culling and borders: a bound on throughput, not a renderer.
// State is kept in structs, not in arrays, so that it stays in registers.
#include "roofline_loops.hpp"
#include "simd.hpp"

namespace {

constexpr int GAUSSIANS = 64;  // of one list: 64 of opacity 1/50 leave a quarter of the light

struct Record {
  float u0, v0, l11, l12, l22, opacity, limit, depth, red, green, blue;
};

struct Records {
  Record each[GAUSSIANS];
  Records() {
    for (int k = 0; k < GAUSSIANS; ++k) {
      const float t = (float)k / GAUSSIANS;
      each[k] = {-0.3f - 0.2f * t, -0.4f + 0.3f * t, 0.08f + 0.02f * t, 0.01f, 0.09f - 0.02f * t, 0.02f,
                 2.3f, 2 + t, t, 1 - t, 0.5f * t};
    }
  }
};

struct Pixels {
  alignas(64) float x[LANES], y[MOST_BLOCKS][LANES];
  Pixels() {
    for (int l = 0; l < LANES; ++l) {
      x[l] = (float)(l % 4) + 0.5f;
      for (int b = 0; b < MOST_BLOCKS; ++b) y[b][l] = (float)(l / 4 + 4 * b) + 0.5f;
    }
  }
};

struct Footing {
  vf u, v, alpha;
};

INLINE Footing footing(const Record& r, vf shear, const float* row) {
  const vf y = load(row), u = shear + y * all(r.l12), v = all(r.v0) + y * all(r.l22);
  const vf s = u * u + v * v;
  vf power[] = {all(0) - s};
  exp2_of(power);
  const vf alpha = minimum(all(r.opacity) * power[0], all(ALPHA_MAX));
  return {u, v, keep(s <= all(r.limit), alpha)};
}

// Chains that wait for their own last sum alone: enough of them to fill two units whose sums take four to five steps.
int64_t fma(int64_t rounds, float* sink) {
  constexpr int CHAINS = 12;
  const NF factor = NF{} + 0.999f, term = NF{} + 1e-3f;
  // each starts elsewhere, or they would be one to the compiler
  NF a = term, b = a + term, c = b + term, d = c + term, e = d + term, f = e + term;
  NF g = f + term, h = g + term, i = h + term, j = i + term, k = j + term, l = k + term;
  for (int64_t round = 0; round < rounds; ++round) {
    asm volatile("" : "+m"(*sink));  // rounds are not merged
    a = a * factor + term; b = b * factor + term; c = c * factor + term; d = d * factor + term;
    e = e * factor + term; f = f * factor + term; g = g * factor + term; h = h * factor + term;
    i = i * factor + term; j = j * factor + term; k = k * factor + term; l = l * factor + term;
  }
  *sink += (a + b + c + d + e + f + g + h + i + j + k + l)[0];
  return rounds * CHAINS * WIDTH * 2;
}

// N blocks of pixels that are drawn together.
template <int N>
struct Drawn {
  vf light = all(1), left = all(1), sum = all(0), depth = all(0), red = all(0), green = all(0), blue = all(0);
  Drawn<N - 1> rest;
};
template <>
struct Drawn<0> {};

template <int N>
INLINE void draw(Drawn<N>& d, const Record& r, vf shear, const Pixels& pixels) {
  if constexpr (N > 0) {
    const vf alpha = footing(r, shear, pixels.y[N - 1]).alpha, before = d.light;
    d.light = before - alpha * before;
    const mask live = d.light >= all(T_MIN);
    const vf weight = keep(live, alpha) * before;
    d.left = select(live, d.light, d.left);
    d.sum = d.sum + weight;
    d.depth = d.depth + weight * all(r.depth);
    d.red = d.red + weight * all(r.red);
    d.green = d.green + weight * all(r.green);
    d.blue = d.blue + weight * all(r.blue);
    draw(d.rest, r, shear, pixels);
  }
}

template <int N>
INLINE vf everything(const Drawn<N>& d) {
  if constexpr (N == 0) return all(0);
  else return d.left + d.sum + d.depth + d.red + d.green + d.blue + everything(d.rest);
}

// Every lane, or the compiler would leave out registers that nobody reads.
INLINE void add_lanes(vf total, float* sink) {
  float out[LANES];
  store(out, total);
  for (float lane : out) *sink += lane;
}

template <int N>
STAGE int64_t blend_blocks(int64_t rounds, float* sink) {
  const Records records;
  const Pixels pixels;
  vf total = all(0);
  for (int64_t i = 0; i < rounds; ++i) {
    Drawn<N> drawn;
    for (int k = 0; k < GAUSSIANS; ++k) {
      const Record& r = records.each[k];
      draw(drawn, r, all(r.u0) + load(pixels.x) * all(r.l11), pixels);
    }
    total = total + everything(drawn);
  }
  add_lanes(total, sink);
  return rounds * GAUSSIANS * N * LANES;
}

template <int N>
struct Behind {
  vf light = all(0.26f), colour = all(0.1f);
  Behind<N - 1> rest;
};
template <>
struct Behind<0> {};

struct Sums {
  vf g = all(0), gu = g, gv = g, guu = g, guv = g, gvv = g, red = g, green = g, blue = g;
};

template <int N>
INLINE void undraw(Behind<N>& b, Sums& sums, const Record& r, vf shear, const Pixels& pixels, const float* by) {
  if constexpr (N > 0) {
    const Footing f = footing(r, shear, pixels.y[N - 1]);
    b.light = b.light / (all(1) - f.alpha);
    const vf weight = f.alpha * b.light, red = load(by), green = load(by + LANES), blue = load(by + 2 * LANES);
    const vf difference = red * all(r.red) + green * all(r.green) + blue * all(r.blue) - b.colour;
    const vf g = weight * difference, gu = g * f.u, gv = g * f.v;
    b.colour = b.colour + f.alpha * difference;
    sums.g = sums.g + g;
    sums.gu = sums.gu + gu;
    sums.gv = sums.gv + gv;
    sums.guu = sums.guu + gu * f.u;
    sums.guv = sums.guv + gu * f.v;
    sums.gvv = sums.gvv + gv * f.v;
    sums.red = sums.red + weight * red;
    sums.green = sums.green + weight * green;
    sums.blue = sums.blue + weight * blue;
    undraw(b.rest, sums, r, shear, pixels, by);
  }
}

// Back to front: the light before each Gaussian by division; nine sums over the pixels, sixteen Gaussians at a
// time turned so that one addition a lane finishes them.
template <int N>
STAGE int64_t backward_blocks(int64_t rounds, float* sink) {
  constexpr int SUMS = 9;
  static_assert(sizeof(Sums) == SUMS * sizeof(vf));
  const Records records;
  const Pixels pixels;
  alignas(64) float rows[SUMS][LANES][LANES], turned[LANES][LANES], by[3][LANES];
  for (int c = 0; c < 3; ++c)
    for (int l = 0; l < LANES; ++l) by[c][l] = 0.1f * (float)c + 0.01f * (float)l;
  vf total = all(0);
  for (int64_t i = 0; i < rounds; ++i) {
    Behind<N> behind;
    for (int first = GAUSSIANS - LANES; first >= 0; first -= LANES) {
      for (int k = LANES - 1; k >= 0; --k) {
        const Record& r = records.each[first + k];
        Sums sums;
        undraw(behind, sums, r, all(r.u0) + load(pixels.x) * all(r.l11), pixels, by[0]);
        store(rows[0][k], sums.g);
        store(rows[1][k], sums.gu);
        store(rows[2][k], sums.gv);
        store(rows[3][k], sums.guu);
        store(rows[4][k], sums.guv);
        store(rows[5][k], sums.gvv);
        store(rows[6][k], sums.red);
        store(rows[7][k], sums.green);
        store(rows[8][k], sums.blue);
      }
      for (int j = 0; j < SUMS; ++j) {
        transpose(rows[j][0], LANES, turned[0], LANES);
        vf sum = load(turned[0]);
        for (int l = 1; l < LANES; ++l) sum = sum + load(turned[l]);
        total = total + sum;
      }
    }
  }
  add_lanes(total, sink);
  return rounds * GAUSSIANS * N * LANES;
}

int64_t blend(int blocks, int64_t rounds, float* sink) {
  return blocks == 1   ? blend_blocks<1>(rounds, sink)
         : blocks == 2 ? blend_blocks<2>(rounds, sink)
         : blocks == 3 ? blend_blocks<3>(rounds, sink)
                       : blend_blocks<4>(rounds, sink);
}

int64_t blend_backward(int blocks, int64_t rounds, float* sink) {
  return blocks == 1   ? backward_blocks<1>(rounds, sink)
         : blocks == 2 ? backward_blocks<2>(rounds, sink)
         : blocks == 3 ? backward_blocks<3>(rounds, sink)
                       : backward_blocks<4>(rounds, sink);
}

void stream(float* x, const float* y, int64_t n) {
  for (int64_t i = 0; i < n; i += 4 * LANES)
    for (int j = 0; j < 4 * LANES; j += LANES) store(x + i + j, load(x + i + j) * all(0.5f) + load(y + i + j));
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::RooflineLoops JOIN(splat_roofline_, SPLAT_LEVEL);
const splat::RooflineLoops JOIN(splat_roofline_, SPLAT_LEVEL) = {fma, blend, blend_backward, stream};
