// The coder of bits and the model that predicts them. Twin of reference.compression.range_coder and mixing.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "codec.hpp"

namespace splat {

// Bits to bytes.
class RangeEncoder {
 public:
  bool bit(uint32_t p, bool y) {  // p: probability of a 1 in 2^-16, within (0, 65536)
    const uint32_t middle = low_ + (uint32_t)(((uint64_t)(high_ - low_) * p) >> 16);
    (y ? high_ : low_) = y ? middle : middle + 1;
    while (((low_ ^ high_) >> 24) == 0) {
      bytes_.push_back((uint8_t)(high_ >> 24));
      low_ <<= 8;
      high_ = (high_ << 8) | 255;
    }
    return y;
  }
  std::vector<uint8_t> finish() {
    for (int shift = 24; shift >= 0; shift -= 8) bytes_.push_back((uint8_t)(low_ >> shift));
    return std::move(bytes_);
  }

 private:
  uint32_t low_ = 0, high_ = 0xffffffffu;
  std::vector<uint8_t> bytes_;
};

// Bytes to bits; throws where more are asked for than there are.
class RangeDecoder {
 public:
  RangeDecoder(const uint8_t* data, int64_t size) : at_(data), end_(data + size) {
    for (int i = 0; i < 4; ++i) next();
  }
  bool bit(uint32_t p, bool) {
    const uint32_t middle = low_ + (uint32_t)(((uint64_t)(high_ - low_) * p) >> 16);
    const bool y = value_ <= middle;
    (y ? high_ : low_) = y ? middle : middle + 1;
    while (((low_ ^ high_) >> 24) == 0) {
      low_ <<= 8;
      high_ = (high_ << 8) | 255;
      next();
    }
    return y;
  }
  void finish() const {
    if (at_ != end_ || value_ != low_) throw BadStream("does not end where its codes do");
  }

 private:
  void next() {
    if (at_ == end_) throw BadStream("ends before its codes do");
    value_ = (value_ << 8) | *at_++;
  }
  const uint8_t *at_, *end_;
  uint32_t low_ = 0, high_ = 0xffffffffu, value_ = 0;
};

// How fast a slot follows what it sees, and how much it counts for, by how often it was seen.
struct Adaption {
  int32_t rate[256], trust[256];
  Adaption() {
    for (int n = 0; n < 256; ++n) {
      rate[n] = 32768 / (2 * n + 3);       // 2^14 / (n + 1.5)
      trust[n] = 2560 * n / (10 * n + 6);  // 2^8 n / (n + 0.6)
    }
  }
};
inline const Adaption ADAPTION;

// Predicts bits by mixing what INPUTS contexts say in the logistic domain.
template <int INPUTS>
class Mixing {
 public:
  // slots: of each context's table, a power of two; nodes: of sets of weights
  Mixing(const Logistic& tables, int slots, int nodes)
      : tables_(tables), mask_((uint32_t)slots - 1), slots_((size_t)slots * INPUTS, FRESH),
        weights_((size_t)nodes * INPUTS, START) {}

  template <class Coder>
  bool code(Coder& coder, const uint32_t (&contexts)[INPUTS], int node, bool y) {
    uint32_t* found[INPUTS];
    int32_t said[INPUTS];
    int32_t* weight = &weights_[(size_t)node * INPUTS];
    int32_t sum = 0;
    for (int i = 0; i < INPUTS; ++i) {
      found[i] = &slots_[(size_t)i * (mask_ + 1) + ((contexts[i] + (uint32_t)node) & mask_)];
      const uint32_t slot = *found[i];
      said[i] = (tables_.stretch[slot >> 20] * ADAPTION.trust[slot & 255]) >> 8;
      sum += weight[i] * said[i];
    }
    const int32_t p = tables_.squash[std::clamp(sum >> 14, -2047, 2047) + 2048];
    y = coder.bit((uint32_t)p, y);
    const int32_t error = (y ? 65536 : 0) - p;
    const int32_t target = y ? 0xffffff : 0;
    for (int i = 0; i < INPUTS; ++i) {
      weight[i] = std::clamp(weight[i] + ((error * said[i] + (1 << (LEARNING - 1))) >> LEARNING), -LIMIT, LIMIT);
      const uint32_t slot = *found[i], seen = slot & 255;
      const int32_t at = (int32_t)(slot >> 8);
      *found[i] = (uint32_t)(at + ((((target - at) >> 7) * ADAPTION.rate[seen]) >> 7)) << 8 | std::min(seen + 1, 254u);
    }
    return y;
  }

 private:
  static constexpr uint32_t FRESH = 0x80000000u;  // 24 bits of probability, 8 of how often it was seen
  static constexpr int32_t START = 4096;          // 1/4 in 2^-14
  static constexpr int32_t LIMIT = 1 << 17;       // 8: 8 inputs of 2047 stay within 32 bits
  static constexpr int LEARNING = 16;           // an error of 1 at 8 moves a weight by 2
  const Logistic tables_;
  const uint32_t mask_;
  std::vector<uint32_t> slots_;
  std::vector<int32_t> weights_;
};

}  // namespace splat
