#include "binning.hpp"

#include <algorithm>
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

// Calls visit(tile) for each tile that a Gaussian touches, in the order of tile numbers.
template <class Visit>
void visit_tiles(const Footprint& footprint, const Span* spans, int across, Visit visit) {
  for (int r = 0; r < footprint.rows; ++r) {
    const int row = (footprint.first_row + r) * across;
    for (int c = spans[r].from; c <= spans[r].to; ++c) visit(row + c);
  }
}

}  // namespace

void bin(const Kernels& kernels, const Camera& camera, const float* geo, const uint8_t* drawn, int64_t count, int threads, Bins& out) {
  const int across = (camera.width + TILE - 1) / TILE, down = (camera.height + TILE - 1) / TILE;
  const int tiles = across * down;
  const size_t n = (size_t)count;
  Buffer<Footprint> footprints(n);
  Buffer<uint32_t> span_start(n + 1);
  over_gaussians(threads, count, [&](int64_t first, int64_t last) {
    kernels.footprints(geo, drawn, down, footprints.data(), first, last);
  });
  uint64_t rows = 0;
  for (size_t i = 0; i < n; ++i) {
    span_start[i] = (uint32_t)rows;
    rows += footprints[i].rows;
  }
  if (rows >> 32) throw std::length_error("more than 2^32 rows of tiles; render a smaller image or fewer Gaussians");
  Buffer<Span> spans(rows);
  over_gaussians(threads, count, [&](int64_t first, int64_t last) {
    kernels.spans(geo, footprints.data(), span_start.data(), across, spans.data(), first, last);
  });

  Buffer<Keyed> order(n), spare;
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
      visit_tiles(footprints[id], spans.data() + span_start[id], across, [&](int tile) {
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
      visit_tiles(footprints[id], spans.data() + span_start[id], across, [&](int tile) {
        out.entries[next[tile]] = id;
        out.slots[slot++] = next[tile]++;
      });
    }
  });
}

}  // namespace splat
