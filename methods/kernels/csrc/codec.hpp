// Adaptive binary range coding with mixed contexts, for the codes of Gaussians: scalar integers only, so that every
// machine writes and reads the same bytes. Twin of reference.compression: range_coder, mixing, gaps, columns, harmonics.
#pragma once
#include <cstdint>
#include <stdexcept>
#include <vector>

namespace splat {

// Thrown for streams that no encoder wrote.
struct BadStream : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Tables of the logistic function that the caller makes: stretch[p >> 4] and squash[x + 2048], see mixing.
struct Logistic {
  const int16_t* stretch;  // 4096
  const uint16_t* squash;  // 4096
};

constexpr int NEAREST = 3;          // earlier Gaussians whose codes are contexts
constexpr int MOST_CODE_BITS = 12;  // of a column

// Place on the Morton curve, 21 bits an axis, x in the lowest bits.
void morton_codes(const int32_t* cells, int64_t n, int64_t* codes);
void morton_cells(const int64_t* codes, int64_t n, int32_t* cells);

// The three nearest of the `window` Gaussians before each; -1 where there are fewer.
void nearest_before(const int32_t* cells, int64_t n, int window, int32_t* nearest);

// Codes that never decrease. Decoding throws BadStream.
std::vector<uint8_t> encode_gaps(const Logistic& tables, const int64_t* codes, int64_t n);
void decode_gaps(const Logistic& tables, const uint8_t* data, int64_t size, int64_t* codes, int64_t n);

// Columns of codes in [0, 2^bits), each with the codes of near Gaussians and of the columns before as contexts;
// side: a number of each Gaussian that the decoder knows, >= 0.
struct Columns {
  int64_t n;
  int columns;
  const int32_t* bits;     // columns
  const int32_t* nearest;  // n x 3
  const int32_t* side;     // n
};
std::vector<uint8_t> encode_columns(const Logistic& tables, const Columns& shape, const int32_t* codes);
void decode_columns(const Logistic& tables, const Columns& shape, const uint8_t* data, int64_t size, int32_t* codes);

// Signed codes of harmonics, coefficient after coefficient, three channels each; classes in [0, 7).
struct Harmonics {
  int64_t n;
  int coefficients;        // without the first
  const int32_t* nearest;  // n x 3
  const int32_t* classes;  // n
};
std::vector<uint8_t> encode_harmonics(const Logistic& tables, const Harmonics& shape, const int32_t* codes);
void decode_harmonics(const Logistic& tables, const Harmonics& shape, const uint8_t* data, int64_t size,
                      int32_t* codes);

// SH coefficients, n x coefficients x 3, of codes: base 2^(class - 3) code, back from opponent channels (rows of
// `opponent`). One operation after another in double, so that every machine finds the same.
void restore_harmonics(const Harmonics& shape, const int32_t* codes, double base, const double* opponent, float* sh);

}  // namespace splat
