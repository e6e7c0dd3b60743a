#include "binning.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "pool.hpp"

namespace splat {
namespace {

struct Keyed {
  uint32_t key, id;
};

// Order-preserving bits of a float.
uint32_t sortable(float x) {
  uint32_t bits;
  std::memcpy(&bits, &x, 4);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

// Stable radix sort by key, 11 bits at a time.
void sort(Buffer<Keyed>& items, Buffer<Keyed>& spare) {
  const size_t n = items.size();
  spare.resize(n);
  std::vector<uint32_t> counts(3 * 2048, 0);
  for (size_t i = 0; i < n; ++i)
    for (int pass = 0; pass < 3; ++pass) ++counts[pass * 2048 + (items[i].key >> (11 * pass) & 2047)];
  Keyed *from = items.data(), *to = spare.data();
  for (int pass = 0; pass < 3; ++pass) {
    uint32_t* count = counts.data() + pass * 2048;
    uint32_t sum = 0;
    bool one_digit = false;
    for (int d = 0; d < 2048; ++d) {
      one_digit |= count[d] == n;
      const uint32_t c = count[d];
      count[d] = sum;
      sum += c;
    }
    if (one_digit) continue;
    for (size_t i = 0; i < n; ++i) to[count[from[i].key >> (11 * pass) & 2047]++] = from[i];
    std::swap(from, to);
  }
  if (from != items.data()) std::memcpy(items.data(), from, n * sizeof(Keyed));
}

// Calls visit(tile) for each tile whose pixel centres may meet the support, in the order of tile numbers.
// Within a row of tiles the support covers an interval of x, so this is exact but for a rounding margin.
template <class Visit>
void visit_tiles(const float* g, int across, int down, Visit visit) {
  const float half_y = g[HALF_Y] * 1.0001f + 1e-3f, reach2 = g[LIMIT] * 1.0001f + 1e-4f;
  const double mx = (double)g[X_WHOLE] + g[X_PART], my = (double)g[Y_WHOLE] + g[Y_PART];
  const double limit = 1e9;  // keeps the conversions to int defined
  const int first = std::max(0, (int)std::floor((std::max(my - half_y, -limit) - 0.5) / TILE));
  const int last = std::min(down - 1, (int)std::floor((std::min(my + half_y, limit) - 0.5) / TILE));
  for (int row = first; row <= last; ++row) {
    const float d0 = (float)(row * TILE + 0.5 - my), d1 = d0 + (TILE - 1);
    if (d1 < -half_y || d0 > half_y) continue;
    const float right = std::min(std::max(g[TIP], d0), d1), left = std::min(std::max(-g[TIP], d0), d1);
    const float vr = g[L22] * right, vl = g[L22] * left;
    const float slack = 1e-3f + 1e-6f * (std::fabs(g[SLOPE]) * (std::fabs(right) + std::fabs(left)));
    const float to = std::sqrt(std::max(reach2 - vr * vr, 0.0f)) * g[INV_L11] - g[SLOPE] * right + slack;
    const float from = -std::sqrt(std::max(reach2 - vl * vl, 0.0f)) * g[INV_L11] - g[SLOPE] * left - slack;
    const double x0 = std::max(mx + from, -limit), x1 = std::min(mx + to, limit);
    // tile c holds the centres 16 c + 0.5 to 16 c + 15.5
    const int c0 = std::max(0, (int)std::ceil((x0 - 0.5 - (TILE - 1)) / TILE));
    const int c1 = std::min(across - 1, (int)std::floor((x1 - 0.5) / TILE));
    for (int c = c0; c <= c1; ++c) visit(row * across + c);
  }
}

}  // namespace

void bin(const Camera& camera, const float* geo, const uint8_t* drawn, int64_t count, int threads, Bins& out) {
  const int across = (camera.width + TILE - 1) / TILE, down = (camera.height + TILE - 1) / TILE;
  const int tiles = across * down;
  const size_t n = (size_t)count;
  static thread_local Buffer<Keyed> order, spare;
  order.resize(n);
  size_t visible = 0;
  for (size_t i = 0; i < n; ++i)
    if (drawn[i]) order[visible++] = {sortable(geo[i * GEO + DEPTH]), (uint32_t)i};
  order.resize(visible);
  sort(order, spare);
  const Keyed* sorted = order.data();

  // Pieces of the depth order are counted and filled independently; their tile counts, summed in order,
  // say where each piece writes. Any number of pieces gives the same lists.
  const int pieces = std::max(1, std::min(threads * 2, (int)(visible / 512)));
  std::vector<uint32_t> counts((size_t)pieces * tiles, 0);
  out.slot_start.resize(n + 1);
  uint32_t* slot_start = out.slot_start.data();
  std::memset(slot_start, 0, (n + 1) * sizeof(uint32_t));
  const auto piece_start = [&](int p) { return visible * (size_t)p / (size_t)pieces; };
  parallel(threads, pieces, [&](int p, int) {
    uint32_t* mine = counts.data() + (size_t)p * tiles;
    for (size_t i = piece_start(p); i < piece_start(p + 1); ++i) {
      const uint32_t id = sorted[i].id;
      uint32_t touched = 0;
      visit_tiles(geo + (size_t)id * GEO, across, down, [&](int tile) {
        ++mine[tile];
        ++touched;
      });
      slot_start[id + 1] = touched;
    }
  });
  uint64_t sum = 0;
  out.start.resize((size_t)tiles + 1);
  for (int t = 0; t < tiles; ++t) {
    out.start[t] = (uint32_t)sum;
    for (int p = 0; p < pieces; ++p) {
      const uint32_t c = counts[(size_t)p * tiles + t];
      counts[(size_t)p * tiles + t] = (uint32_t)sum;
      sum += c;
    }
  }
  if (sum >> 32) throw std::length_error("more than 2^32 pairs of Gaussian and tile; render a smaller image or fewer Gaussians");
  out.start[tiles] = (uint32_t)sum;
  for (size_t i = 0; i < n; ++i) slot_start[i + 1] += slot_start[i];
  out.entries.resize(sum);
  out.slots.resize(sum);
  parallel(threads, pieces, [&](int p, int) {
    uint32_t* next = counts.data() + (size_t)p * tiles;
    for (size_t i = piece_start(p); i < piece_start(p + 1); ++i) {
      const uint32_t id = sorted[i].id;
      uint32_t slot = slot_start[id];
      visit_tiles(geo + (size_t)id * GEO, across, down, [&](int tile) {
        out.entries[next[tile]] = id;
        out.slots[slot++] = next[tile]++;
      });
    }
  });
}

}  // namespace splat
