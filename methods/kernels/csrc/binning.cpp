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

// [0, count) in pieces that threads work on independently; what they do must not depend on their number.
struct Pieces {
  size_t count;
  int number;
  Pieces(size_t count, int threads, size_t least)
      : count(count), number(threads == 1 ? 1 : std::max(1, (int)std::min<size_t>(2 * threads, count / least))) {}
  size_t start(int piece) const { return count * (size_t)piece / (size_t)number; }
};

// From how often each piece has each of `kinds` (counts[piece * kinds + kind]) to where it writes its first one:
// kind after kind, and within a kind piece after piece. Writes where kinds start, and returns the sum.
template <class Start>
uint64_t places(std::vector<uint32_t>& counts, int pieces, int kinds, Start start) {
  uint64_t sum = 0;
  for (int kind = 0; kind < kinds; ++kind) {
    start(kind, sum);
    for (int p = 0; p < pieces; ++p) {
      uint32_t& count = counts[(size_t)p * kinds + kind];
      const uint32_t c = count;
      count = (uint32_t)sum;
      sum += c;
    }
  }
  return sum;
}

// Stable radix sort by key, 11 bits at a time: the ids in that order. Of the items nothing is left.
void sort(Buffer<Keyed>& items, int threads, Buffer<uint32_t>& ids) {
  constexpr int DIGITS = 2048;
  const size_t n = items.size();
  Buffer<Keyed> spare(n);
  const Pieces pieces(n, threads, 1 << 14);
  Keyed *from = items.data(), *to = spare.data();
  ids.resize(n);
  for (int shift = 0; shift < 32; shift += 11) {
    const bool last = shift + 11 >= 32;
    std::vector<uint32_t> counts((size_t)pieces.number * DIGITS, 0);
    const auto digit = [=](const Keyed& item) { return item.key >> shift & (DIGITS - 1); };
    parallel(threads, pieces.number, [&](int p, int) {
      uint32_t* mine = counts.data() + (size_t)p * DIGITS;
      for (size_t i = pieces.start(p); i < pieces.start(p + 1); ++i) ++mine[digit(from[i])];
    });
    places(counts, pieces.number, DIGITS, [](int, uint64_t) {});
    parallel(threads, pieces.number, [&](int p, int) {
      uint32_t* next = counts.data() + (size_t)p * DIGITS;
      for (size_t i = pieces.start(p); i < pieces.start(p + 1); ++i) {
        const uint32_t place = next[digit(from[i])]++;
        if (last) ids[place] = from[i].id;
        else to[place] = from[i];
      }
    });
    std::swap(from, to);
  }
}

// The Gaussians that are drawn, nearest first, ties by index.
void sort_by_depth(const float* geo, const uint8_t* drawn, int64_t count, int threads, Buffer<uint32_t>& ids) {
  const Pieces pieces((size_t)count, threads, 1 << 14);
  std::vector<size_t> first((size_t)pieces.number + 1, 0);
  parallel(threads, pieces.number, [&](int p, int) {
    first[p + 1] = (size_t)std::count_if(drawn + pieces.start(p), drawn + pieces.start(p + 1), [](uint8_t d) { return d != 0; });
  });
  for (int p = 0; p < pieces.number; ++p) first[p + 1] += first[p];
  Buffer<Keyed> order(first.back());
  parallel(threads, pieces.number, [&](int p, int) {
    size_t next = first[p];
    for (size_t i = pieces.start(p); i < pieces.start(p + 1); ++i)
      if (drawn[i]) order[next++] = {sortable(geo[i * GEO + DEPTH]), (uint32_t)i};
  });
  sort(order, threads, ids);
}

}  // namespace

void bin(const Kernels& kernels, const Camera& camera, const float* geo, const uint8_t* drawn, float reach, int64_t count, int threads,
         Bins& out) {
  const int across = (camera.width + TILE - 1) / TILE, down = (camera.height + TILE - 1) / TILE;
  const int tiles = across * down;
  const size_t n = (size_t)count;
  Buffer<uint32_t> ids;
  sort_by_depth(geo, drawn, count, threads, ids);

  // In the order of the Gaussians, so that their ellipses are read once and in a row.
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
  span_start[n] = (uint32_t)rows;
  Buffer<Span> spans(rows);
  out.row_start.resize(n + 1);
  uint32_t* row_start = out.row_start.data();
  over_gaussians(threads, count, [&](int64_t first, int64_t last) {
    kernels.spans(geo, footprints.data(), span_start.data(), across, reach, spans.data(), row_start, first, last);
  });
  uint64_t pairs = 0;
  for (size_t i = 0; i < n; ++i) {
    const uint32_t here = row_start[i];
    row_start[i] = (uint32_t)pairs;
    pairs += here;
  }
  if (pairs >> 32) throw std::length_error("more than 2^32 pairs of Gaussian and tile; render a smaller image or fewer Gaussians");
  row_start[n] = (uint32_t)pairs;
  Buffer<uint32_t> touched(pairs);  // the tile of each row
  over_gaussians(threads, count, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      uint32_t* tile = touched.data() + row_start[i];
      const Span* span = spans.data() + span_start[i];
      for (int r = 0; r < footprints[i].rows; ++r) {
        const uint32_t row = (uint32_t)((footprints[i].first_row + r) * across);
        for (int c = span[r].from; c <= span[r].to; ++c) *tile++ = row + (uint32_t)c;
      }
    }
  });

  // In the order of depth: pieces write their pairs where the pieces before them end, tile by tile.
  const Pieces pieces(ids.size(), threads, 512);
  std::vector<uint32_t> counts((size_t)pieces.number * tiles, 0);
  const auto over_pairs = [&](int p, auto&& pair) {
    constexpr size_t AHEAD = 8;  // Gaussians whose tiles are fetched before they are needed, and where these are before
    const uint32_t* tiles_of = touched.data();
    for (size_t i = pieces.start(p), end = pieces.start(p + 1); i < end; ++i) {
      if (i + 2 * AHEAD < end) __builtin_prefetch(row_start + ids[i + 2 * AHEAD]);
      if (i + AHEAD < end) __builtin_prefetch(tiles_of + row_start[ids[i + AHEAD]]);
      for (uint32_t row = row_start[ids[i]], last = row_start[ids[i] + 1]; row < last; ++row) pair(ids[i], row, tiles_of[row]);
    }
  };
  parallel(threads, pieces.number, [&](int p, int) {
    uint32_t* mine = counts.data() + (size_t)p * tiles;
    over_pairs(p, [=](uint32_t, uint32_t, uint32_t tile) { ++mine[tile]; });
  });
  out.start.resize((size_t)tiles + 1);
  out.start[tiles] = (uint32_t)places(counts, pieces.number, tiles,
                                      [&](int tile, uint64_t sum) { out.start[tile] = (uint32_t)sum; });
  out.entries.resize(pairs);
  parallel(threads, pieces.number, [&](int p, int) {
    uint32_t* next = counts.data() + (size_t)p * tiles;
    Entry* entries = out.entries.data();
    over_pairs(p, [=](uint32_t id, uint32_t row, uint32_t tile) { entries[next[tile]++] = {id, row}; });
  });
}

}  // namespace splat
