#include "codec.hpp"

#include <cmath>
#include <cstdlib>

#include "mixing.hpp"

namespace splat {
namespace {

constexpr int AXIS_BITS = 21;
constexpr int MOST_SLOTS = 1 << 18;
constexpr int CLASSES = 7, ENERGIES = 24;
constexpr uint32_t PRIME = 1031;  // of two numbers that are one context

uint64_t spread(uint64_t x) {
  x = (x | x << 32) & 0x1F00000000FFFF;
  x = (x | x << 16) & 0x1F0000FF0000FF;
  x = (x | x << 8) & 0x100F00F00F00F00F;
  x = (x | x << 4) & 0x10C30C30C30C30C3;
  return (x | x << 2) & 0x1249249249249249;
}

uint64_t gathered(uint64_t x) {
  x &= 0x1249249249249249;
  x = (x | x >> 2) & 0x10C30C30C30C30C3;
  x = (x | x >> 4) & 0x100F00F00F00F00F;
  x = (x | x >> 8) & 0x1F0000FF0000FF;
  x = (x | x >> 16) & 0x1F00000000FFFF;
  return (x | x >> 32) & ((1u << AXIS_BITS) - 1);
}

int bit_length(uint64_t x) { return x ? 64 - __builtin_clzll(x) : 0; }

template <class Coder>
void gaps(Coder& coder, const Logistic& tables, int64_t* codes, int64_t n) {
  Mixing<3> lengths(tables, 64 * 64 * 64, 64);
  Mixing<2> heads(tables, 256 * 4, 4);
  int64_t before = -1;
  uint32_t last = 0, second = 0;
  for (int64_t i = 0; i < n; ++i) {
    const uint64_t gap = (uint64_t)codes[i] - (uint64_t)before + (i ? 1 : 0);  // >= 1; when decoding it is not known
    const uint32_t said = (uint32_t)bit_length(gap) - 1;
    const uint32_t contexts[3] = {0, last << 6, (last << 6 | second) << 6};
    uint32_t node = 1;
    for (int b = 5; b >= 0; --b) node = node << 1 | (uint32_t)lengths.code(coder, contexts, (int)node, said >> b & 1);
    const uint32_t length = node & 63;
    uint64_t value = 1;
    for (int b = (int)length - 1, place = 0; b >= 0; --b, ++place) {
      bool y = gap >> b & 1;
      if (place < 2) {
        const uint32_t head[2] = {length << 2, (length << 2 | 256)};
        y = heads.code(coder, head, place == 0 ? 1 : 2 + (int)(value & 1), y);
      } else {
        y = coder.bit(1u << 15, y);
      }
      value = value << 1 | (uint64_t)y;
    }
    const uint64_t found = (uint64_t)before + value - (i ? 1 : 0);
    if (found >> 63 || value > (uint64_t)1 << 63) throw BadStream("leaves the grid of positions");
    codes[i] = before = (int64_t)found;
    second = last;
    last = length;
  }
}

template <class Coder>
void columns(Coder& coder, const Logistic& tables, const Columns& s, int32_t* codes) {
  for (int c = 0; c < s.columns; ++c) {
    const int bits = s.bits[c];
    Mixing<5> model(tables, std::min(MOST_SLOTS, 1 << (2 * bits)), 1 << bits);
    int32_t* own = codes + s.n * c;
    const int32_t* previous = c > 0 ? own - s.n : nullptr;
    const int32_t* second = c > 1 ? previous - s.n : nullptr;
    for (int64_t i = 0; i < s.n; ++i) {
      uint32_t v[NEAREST];
      for (int k = 0; k < NEAREST; ++k) {
        const int32_t near = s.nearest[NEAREST * i + k];
        v[k] = near < 0 ? (1u << bits) >> 1 : (uint32_t)own[near];
      }
      const uint32_t mean = (2 * v[0] + v[1] + v[2]) >> 2, half_mean = mean >> 1;
      const uint32_t a = previous ? (uint32_t)previous[i] : 0, b = second ? (uint32_t)second[i] : 0;
      const uint32_t contexts[5] = {0, v[0] << bits, (half_mean * PRIME + (a >> 1)) << bits,
                                    ((a >> 1) * PRIME + (b >> 1)) << bits,
                                    ((uint32_t)s.side[i] * PRIME + (mean >> 2)) << bits};
      uint32_t node = 1;
      for (int bit = bits - 1; bit >= 0; --bit)
        node = node << 1 | (uint32_t)model.code(coder, contexts, (int)node, own[i] >> bit & 1);
      own[i] = (int32_t)(node - (1u << bits));
    }
  }
}

// Codes of another class in steps of this one.
int32_t rescaled(int32_t code, int32_t from, int32_t to) {
  const int32_t size = std::abs(code);
  const int32_t scaled = from >= to ? std::min(size, 1 << 16) << (from - to) : size >> (to - from);
  return code < 0 ? -scaled : scaled;
}

uint32_t within(int32_t x, int32_t most) { return (uint32_t)(std::clamp(x, -most, most) + most); }

// floor(3 log2(1 + sum)), at most 23.
struct EnergyClasses {
  uint8_t of[256];
  EnergyClasses() {
    for (uint64_t s = 0; s < 256; ++s) of[s] = (uint8_t)std::min(ENERGIES - 1, bit_length((1 + s) * (1 + s) * (1 + s)) - 1);
  }
  uint32_t operator()(int32_t sum) const { return of[sum]; }
};
const EnergyClasses ENERGY;

constexpr int NODES = 16, UNARY = 15;  // zero, sign, thirteen of size; what is larger is written plain
constexpr int SLOTS = 1 << 12;  // 7 * 24 * 16 at most
constexpr int MOST_PLAIN = 20;

template <class Coder>
int32_t signed_code(Coder& coder, Mixing<6>& model, const uint32_t (&contexts)[6], int32_t code) {
  const int32_t size = std::abs(code);
  if (!model.code(coder, contexts, 0, size > 0)) return 0;
  const bool negative = model.code(coder, contexts, 1, code < 0);
  int32_t found = 1;
  while (found < UNARY && model.code(coder, contexts, std::min(found + 1, NODES - 1), size > found)) ++found;
  if (found == UNARY) {  // Elias gamma of the rest
    const uint32_t rest = (uint32_t)(size - UNARY + 1);
    int length = bit_length(rest) - 1, seen = 0;
    while (coder.bit(1u << 15, seen < length))
      if (++seen > MOST_PLAIN) throw BadStream("holds a code that is too large");
    uint32_t value = 1;
    for (int b = seen - 1; b >= 0; --b) value = value << 1 | (uint32_t)coder.bit(1u << 15, rest >> b & 1);
    found = (int32_t)value - 1 + UNARY;
  }
  return negative ? -found : found;
}

template <class Coder>
void harmonics(Coder& coder, const Logistic& tables, const Harmonics& s, int32_t* codes) {
  std::vector<int32_t> energy((size_t)s.n, 0);
  for (int c = 0; c < 3 * s.coefficients; ++c) {
    Mixing<6> model(tables, SLOTS, NODES);
    int32_t* own = codes + s.n * c;
    const int channel = c % 3;
    const int32_t* before = c >= 3 ? own - 3 * s.n : nullptr;  // the coefficient before
    const int32_t* left = channel > 0 ? own - s.n : c >= 6 ? own - 6 * s.n : nullptr;
    const int32_t* far = channel > 1 ? own - 2 * s.n : before;
    for (int64_t i = 0; i < s.n; ++i) {
      const int32_t* near = s.nearest + NEAREST * i;
      const int32_t z = s.classes[i];
      int32_t v[NEAREST];
      for (int k = 0; k < NEAREST; ++k) v[k] = near[k] < 0 ? 0 : rescaled(own[near[k]], s.classes[near[k]], z);
      const uint32_t e = ENERGY(energy[(size_t)i]);
      const int32_t at_before = before ? before[i] : 0, at_left = left ? left[i] : 0, at_far = far ? far[i] : 0;
      const uint32_t contexts[6] = {0,
                                    (e * CLASSES + (uint32_t)z) * NODES,
                                    within(2 * v[0] + v[1] + v[2], 12) * NODES,
                                    (within(at_left, 3) * ENERGIES + e) * NODES,
                                    (within(at_left, 3) * 7 + within(at_far, 3)) * NODES,
                                    (within(at_before, 3) * ENERGIES + e) * NODES};
      own[i] = signed_code(coder, model, contexts, own[i]);
      energy[(size_t)i] = std::min(255, energy[(size_t)i] + std::abs(own[i]));
    }
  }
}

}  // namespace

void morton_codes(const int32_t* cells, int64_t n, int64_t* codes) {
  for (int64_t i = 0; i < n; ++i, cells += 3)
    codes[i] = (int64_t)(spread((uint64_t)cells[0]) | spread((uint64_t)cells[1]) << 1 | spread((uint64_t)cells[2]) << 2);
}

void morton_cells(const int64_t* codes, int64_t n, int32_t* cells) {
  for (int64_t i = 0; i < n; ++i, cells += 3)
    for (int axis = 0; axis < 3; ++axis) cells[axis] = (int32_t)gathered((uint64_t)codes[i] >> axis);
}

void nearest_before(const int32_t* cells, int64_t n, int window, int32_t* nearest) {
  std::vector<int32_t> x((size_t)n), y((size_t)n), z((size_t)n);
  for (int64_t i = 0; i < n; ++i) {
    x[(size_t)i] = cells[3 * i];
    y[(size_t)i] = cells[3 * i + 1];
    z[(size_t)i] = cells[3 * i + 2];
  }
  for (int64_t i = 0; i < n; ++i) {
    int64_t distance[NEAREST] = {INT64_MAX, INT64_MAX, INT64_MAX};
    int32_t found[NEAREST] = {-1, -1, -1};
    for (int64_t j = i - 1; j >= std::max<int64_t>(0, i - window); --j) {
      const int64_t dx = x[(size_t)i] - x[(size_t)j], dy = y[(size_t)i] - y[(size_t)j], dz = z[(size_t)i] - z[(size_t)j];
      const int64_t d = dx * dx + dy * dy + dz * dz;
      if (d >= distance[2]) continue;
      int k = 2;
      for (; k > 0 && d < distance[k - 1]; --k) {
        distance[k] = distance[k - 1];
        found[k] = found[k - 1];
      }
      distance[k] = d;
      found[k] = (int32_t)j;
    }
    for (int k = 0; k < NEAREST; ++k) nearest[NEAREST * i + k] = found[k];
  }
}

std::vector<uint8_t> encode_gaps(const Logistic& tables, const int64_t* codes, int64_t n) {
  RangeEncoder coder;
  std::vector<int64_t> own(codes, codes + n);
  gaps(coder, tables, own.data(), n);
  return coder.finish();
}

void decode_gaps(const Logistic& tables, const uint8_t* data, int64_t size, int64_t* codes, int64_t n) {
  RangeDecoder coder(data, size);
  gaps(coder, tables, codes, n);
  coder.finish();
}

std::vector<uint8_t> encode_columns(const Logistic& tables, const Columns& shape, const int32_t* codes) {
  RangeEncoder coder;
  std::vector<int32_t> own(codes, codes + shape.n * shape.columns);
  columns(coder, tables, shape, own.data());
  return coder.finish();
}

void decode_columns(const Logistic& tables, const Columns& shape, const uint8_t* data, int64_t size, int32_t* codes) {
  RangeDecoder coder(data, size);
  columns(coder, tables, shape, codes);
  coder.finish();
}

std::vector<uint8_t> encode_harmonics(const Logistic& tables, const Harmonics& shape, const int32_t* codes) {
  RangeEncoder coder;
  std::vector<int32_t> own(codes, codes + shape.n * shape.coefficients * 3);
  harmonics(coder, tables, shape, own.data());
  return coder.finish();
}

void decode_harmonics(const Logistic& tables, const Harmonics& shape, const uint8_t* data, int64_t size,
                      int32_t* codes) {
  RangeDecoder coder(data, size);
  harmonics(coder, tables, shape, codes);
  coder.finish();
}

void restore_harmonics(const Harmonics& shape, const int32_t* codes, double base, const double* o, float* sh) {
  constexpr int WIDEST = CLASSES / 2;
  double steps[CLASSES];
  for (int z = 0; z < CLASSES; ++z) steps[z] = std::ldexp(base, z - WIDEST);
  constexpr int64_t PIECE = 64;  // Gaussians whose coefficients stay in the first cache
  const int64_t n = shape.n, row = 3 * shape.coefficients;
  for (int64_t first = 0; first < n; first += PIECE) {
    for (int k = 0; k < shape.coefficients; ++k) {
      const int32_t* code = codes + 3 * k * n;
      for (int64_t i = first; i < std::min(n, first + PIECE); ++i) {
        const double step = steps[shape.classes[i]];
        const double y = code[i] * step, u = code[n + i] * step, v = code[2 * n + i] * step;
        for (int c = 0; c < 3; ++c) sh[row * i + 3 * k + c] = (float)(o[c] * y + o[3 + c] * u + o[6 + c] * v);
      }
    }
  }
}

}  // namespace splat
