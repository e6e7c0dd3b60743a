// Plain data that the kernels share. No functions here: this header is compiled for several SIMD levels.
#pragma once
#include <cstddef>
#include <cstdint>

namespace splat {

constexpr int LANES = 16;   // Gaussians or pixels that are worked on together
constexpr int TILE = 16;    // side of a tile in pixels: one list of Gaussians each
constexpr int BLOCK = 4;    // side of a block in pixels: its 16 pixels are the lanes
constexpr int BLOCKS = 16;  // blocks in a tile
constexpr int CHUNK = 256;  // Gaussians of a tile that are prepared together
constexpr int MAX_CHANNELS = 32;

constexpr float ALPHA_MAX = 0.99f;
constexpr float T_MIN = 1e-4f;
constexpr double BLUR = 0.3;
constexpr double WHITEN = 0.84932180028801904272;  // sqrt(log2(e) / 2): exponents are powers of 2

// One projected Gaussian, a line of the cache. With d = pixel - mean, u = l11 dx + l12 dy and v = l22 dy (a Cholesky
// factor of the inverse covariance, so that no large terms cancel as in a dx^2 + 2 b dx dy + c dy^2):
// alpha = opacity 2^-(u^2 + v^2), and the support is where that is 1/255 or more.
// The numbers that a record of a tile has too stand where it has them.
enum Geo {
  X_WHOLE, X_PART,  // mean in pixels = whole + part: float32 alone loses 1e-4 px at 1000
  L11, L12, L22,
  LOG_OPACITY,  // log2(opacity)
  OPACITY,
  Y_WHOLE,
  COLOUR,       // where there are three channels: what tiles need of most pictures is in this line
  DEPTH = COLOUR + 3,
  Y_PART,
  TIP,          // dy at the ellipse's rightmost point
  INV_L11,      // l12 times it is how the ellipse's middle moves with dy
  HALF_Y,       // half-extent of the support in pixels
  GEO
};

// One Gaussian as a tile sees it: u and v at the tile's corner, its rank in the tile's list, then its features.
// alpha = 2^(log2(opacity) - u^2 - v^2) down to 2^LEAST = 1/255.
enum Rec { R_U0, R_V0, R_L11, R_L12, R_L22, R_LOG_OPACITY, R_OPACITY, R_RANK, R_FEATURES };
static_assert((int)R_L11 == L11 && (int)R_LOG_OPACITY == LOG_OPACITY && (int)R_OPACITY == OPACITY &&
                  (int)R_FEATURES == COLOUR,
              "records are copies of what projection writes");
constexpr float LEAST = -7.99435343685885793f;

// A rank as the bits of a float that is no denormal: numbers of this kind are ordered as ranks are.
constexpr uint32_t FIRST_RANK = 0x3f800000;

// What the forward pass leaves of a block for the backward pass: transmittances, and the rank of the last Gaussian
// of each pixel, 0 where there is none.
enum Trace { TR_LEFT, TR_LAST, TRACE };

// One row of gradient sums over the pixels of a tile, with g = d loss / d ln(alpha). Where fragments are asked for,
// the sum of g^2 and the number of pixels stand in place of the sums of absolute values.
enum Sum { S_G, S_GU, S_GV, S_GUU, S_GUV, S_GVV, S_ABS_X, S_ABS_Y, S_FEATURES };
constexpr int S_SQUARES = S_ABS_X, S_COUNT = S_ABS_Y;

struct Camera {
  double rotation[9], translation[3], centre[3];
  double k[6];               // first two rows of K
  double low_x, high_x, low_y, high_y;   // clamp of x/z and y/z in the Jacobian
  double near;
  int width, height;
};

struct Model {
  const float *means, *quaternions, *scales, *opacities;
  const float* colours;  // [n - sh_count, channels], of the last Gaussians, or null
  const float* sh;       // [sh_count, sh_stored, 3], or [sh_count, 1, 3] beside sh_rest, or null
  const float* sh_rest;  // [sh_count, sh_stored - 1, 3], or null
  int64_t count;
  int64_t sh_count;      // of the first Gaussians, whose colours depend on where they are seen from
  int channels;          // of the image
  int sh_used, sh_stored;
  bool raw;              // scales are logarithms, opacities logits
  bool antialiased;
  float stop = T_MIN;               // light left of every pixel below which a block ends
  float reach = __builtin_inff();   // u^2 + v^2 beyond which no block is drawn
};

struct Projection {  // what projecting writes, per Gaussian
  float* geo;        // [n, GEO]
  float* features;   // [n, stride]: colours, depth, distance; null where geo has all that pictures need
  int stride;
  float* radii;      // [n]
  uint8_t* drawn;    // [n]: 0, or 1 with LIT << c where channel c of its harmonics is above 0
};
constexpr int LIT = 2;

// Which tiles a Gaussian touches: `rows` rows of tiles from `first_row` on; in each, columns [from, to].
struct Footprint {
  uint16_t first_row, rows;
};
struct Span {
  int16_t from, to;  // empty if to < from
};

// A Gaussian in a tile's list, and the row that the tile leaves the sums of its gradients in.
struct Entry {
  uint32_t gaussian, row;
};

struct Tiles {
  const float* geo;
  const float* features;       // null where geo has them
  int stride;                  // floats between the features of two Gaussians
  bool coloured;               // whether geo has their colours
  const Entry* entries;        // of all tiles, nearest first within a tile
  const uint32_t* start;       // [tiles + 1] into entries
  uint32_t* processed;         // [tiles]: entries looked at before all pixels were full
  uint16_t* blocks;            // [entries]: bit b where block b draws the Gaussian, for those looked at; or null
  float* trace;                // [tiles, BLOCKS, TRACE, LANES]; null with `blocks`
  float stop, reach;           // of the model
  int across;                  // tiles in a row
  int width, height;
};

struct Pictures {  // outputs, row-major; all but colour null where not asked for
  int channels;
  const float* background;
  float *colour, *alpha, *depth, *distance, *median;
  float* left;  // final transmittance
  int contributors;
  int64_t* ids;
  float* weights;
};

inline int features_of(const Pictures& p) { return p.channels + (p.distance ? 2 : p.depth || p.median ? 1 : 0); }

// Whether that many features of a picture are in a Gaussian's geo: three colours, and perhaps its depth.
inline bool in_geo(int channels, int features) { return channels == 3 && features <= 4; }

struct PictureGradients {  // d loss / d output; null is zero
  int channels;
  const float* background;
  const float *alpha_value, *depth_value, *distance_value;
  const float *colour, *alpha, *depth, *distance, *median;
  bool shapes;  // whether any gradient but those by the colours is wanted
  bool moduli;  // whether sums of absolute gradients by the 2D means are wanted; shapes are then, too
  bool fragments;  // whether squares and numbers are wanted in their place, of colours alone
};

struct ModelGradients {  // all written in full; null where not asked for
  float *means, *quaternions, *scales, *opacities, *colours, *sh, *sh_rest;
  float *screen, *screen_absolute;  // [n, 2]
  float* fragments;  // [n, 3]: sums of g and g^2 over all pixels and their number, g = d loss / d ln(alpha)
};

// Whether anything but colours has a gradient; harmonics reach the means, but not through the sums over pixels.
inline bool needs_shapes(const ModelGradients& g) {
  return g.means || g.quaternions || g.scales || g.opacities || g.screen || g.screen_absolute;
}

// Where tiles leave sums of gradients: memory that begins with row `first`.
struct SumRows {
  float* memory;
  uint32_t first;
  int stride;
  float* of(const Entry& entry) const { return memory + (size_t)(entry.row - first) * stride; }
};

struct Scratch {  // one a thread; grown by the caller before each use
  float* recs;        // [rows, rec stride]
  uint32_t* lists;    // [BLOCKS, rows + LANES]
  float* state;       // [BLOCKS, 4 + features, LANES]
  float* weights;     // [rows, LANES]
  float* alphas;      // [rows, LANES]
};

struct Loss {
  const float *image, *truth;  // [height, width, channels]
  const uint8_t* mask;         // [height, width] or null
  int width, height, channels;
  int margin;                  // floats that the window reaches to the side, up to a multiple of LANES
  float l1_weight, ssim_weight;
  float taps[6];               // the window from its middle outwards
  double* sums;                // [height, 2]: |a - b|, SSIM
  float* gradient;             // [height, width, channels] or null
};

constexpr int LOSS_STRIP = 448;  // floats of a row that are compared at once
constexpr int loss_margin(int channels) { return (5 * channels + LANES - 1) / LANES * LANES; }
inline size_t loss_scratch(int margin) { return (size_t)100 * LOSS_STRIP + (size_t)128 * margin; }

struct AdamTensor {
  float *value, *first, *second;
  const float* gradient;
};

struct AdamRate {
  float first_part;   // 1 - beta1
  float second_keep;  // beta2
  float second_part;  // 1 - beta2
  float spread;       // 1 / sqrt(1 - beta2^t)
  float rate;         // learning rate / (1 - beta1^t)
  float epsilon;
};

// The kernels of one SIMD level.
struct Kernels {
  const char* name;
  void (*project)(const Camera&, const Model&, const Projection&, int64_t first, int64_t last);
  void (*footprints)(const float* geo, const uint8_t* drawn, int down, Footprint*, int64_t first, int64_t last);
  void (*spans)(const float* geo, const Footprint*, const uint32_t* span_start, int across, float reach, Span*,
                uint32_t* touched, int64_t first, int64_t last);
  void (*render_tile)(const Tiles&, const Pictures&, const Scratch&, int tile);
  void (*render_tile_again)(const Tiles&, const Pictures&, const Scratch&, int tile);  // other colours of the same
  void (*backward_tile)(const Tiles&, const PictureGradients&, const Scratch&, int features, int tile,
                        const SumRows& sums);
  void (*backward_project)(const Camera&, const Model&, const Projection&, const float* sums,
                           int sums_stride, const uint32_t* row_start, const ModelGradients&, int64_t first,
                           int64_t last);
  void (*loss_rows)(const Loss&, float* scratch, int first, int last);
  void (*adam)(const AdamRate&, const AdamTensor&, int64_t begin, int64_t end);
  void (*exp2)(const float* x, float* y, int64_t count);
};

inline int rec_stride(int features) { return R_FEATURES + (features + 7) / 8 * 8; }
inline int sum_stride(int features) { return (S_FEATURES + features + LANES - 1) / LANES * LANES; }

}  // namespace splat
