// Decoding of anchors at one SIMD level; no standard library here (see level.cpp).
//
// Every step of the networks is a product of small matrices whose rows are the anchors of a block.
#include "decode.hpp"
#include "simd.hpp"

#include "activations.inl"
#include "products.inl"

namespace {

struct Memory {  // of one block
  float* inputs;      // [ANCHORS, input lanes]: feature, direction, distance
  float* by_inputs;   // likewise
  float* by_hidden;   // [ANCHORS, hidden lanes]
  float* outputs;     // [ANCHORS, output lanes]: of the networks, before activation, or gradients by them
  float* sizes;       // [ANCHORS, 6]: exp(log scales)
  float* log_scales;  // likewise
};

INLINE Memory carve(float* scratch, const PackedNetworks& n) {
  const int in = ANCHORS * lanes_of(n.inputs);
  Memory m;
  m.inputs = scratch;
  m.by_inputs = m.inputs + in;
  m.by_hidden = m.by_inputs + in;
  m.outputs = m.by_hidden + ANCHORS * n.hidden_lanes;
  m.sizes = m.outputs + ANCHORS * n.output_lanes;
  m.log_scales = m.sizes + ANCHORS * 6;
  return m;
}

// Distance from the camera to a centre, and the direction, 0 where they meet.
INLINE float look(const AnchorArrays& a, int64_t row, float* direction) {
  float square = 0;
  for (int c = 0; c < 3; ++c) {
    direction[c] = a.centres[row * 3 + c] - a.camera[c];
    square += direction[c] * direction[c];
  }
  const float distance = __builtin_sqrtf(square);
  const float divisor = square > 0 ? distance : 1;
  for (int c = 0; c < 3; ++c) direction[c] /= divisor;
  return distance;
}

STAGE void read_inputs(const AnchorArrays& a, int lanes, int64_t first, int64_t last, float* inputs) {
  for (int64_t i = first; i < last; ++i, inputs += lanes) {
    __builtin_memcpy(inputs, a.features + feature_row(a, i) * a.f, a.f * sizeof(float));
    const float distance = look(a, row_of(a, i), inputs + a.f);
    if (a.with_distance) inputs[a.f + 3] = distance;
  }
}

STAGE void read_sizes(const AnchorArrays& a, const Memory& m, int64_t first, int64_t last) {
  for (int64_t i = first; i < last; ++i)
    __builtin_memcpy(m.log_scales + (i - first) * 6, a.log_scales + row_of(a, i) * 6, 6 * sizeof(float));
  for (int j = 0; j < (last - first) * 6; j += LANES) store(m.sizes + j, exponential(load(m.log_scales + j)));
}

int64_t open(const AnchorArrays& a, const PackedNetworks& n, const DecodeState& s, float* scratch, int64_t first,
             int64_t last) {
  const Memory m = carve(scratch, n);
  const int rows = (int)(last - first), in = lanes_of(n.inputs), all_hidden = n.hidden_lanes;
  read_inputs(a, in, first, last, m.inputs);
  float* hidden = s.hidden + first * all_hidden;
  product({m.inputs, in, 1}, {n.weight, all_hidden}, rows, all_hidden, n.inputs, {n.bias, 0}, hidden, all_hidden);
  for (int i = 0; i < rows * all_hidden; i += LANES) store(hidden + i, maximum(all(0), load(hidden + i)));
  const PackedLayer& layer = n.layers[OPACITY_NETWORK];
  const int lanes = lanes_of(layer.outputs);
  product({hidden + layer.first, all_hidden, 1}, {layer.weight, lanes}, rows, lanes, layer.hidden, {layer.bias, 0},
          m.outputs, lanes);
  for (int i = 0; i < rows * lanes; i += LANES) store(m.outputs + i, hyperbolic_tangent(load(m.outputs + i)));
  int64_t count = 0;
  for (int r = 0; r < rows; ++r)
    for (int j = 0; j < a.k; ++j) {
      const float opacity = m.outputs[r * lanes + j];
      s.opacity[(first + r) * a.k + j] = opacity;
      count += opacity > 0;
    }
  return count;
}

// Up to sixteen Gaussians on their way from the networks to the outputs, one a row.
enum Column { SCALE, QUATERNION = 3, COLOUR = 7, BASE = 10 };
struct Group {
  alignas(64) float rows[LANES][LANES] = {};
  int count = 0;
};

// Activates a group: scales, quaternions and colours go to the outputs from place `at` on.
STAGE void flush(Group& g, const DecodeState& s, const DecodeOutputs& out, int64_t at) {
  alignas(64) float column[LANES][LANES], kept[LANES][LANES];
  transpose(g.rows[0], LANES, column[0], LANES);
  for (int c = 0; c < 3; ++c) {
    const vf share = sigmoid(load(column[SCALE + c]));
    store(kept[c], share);
    store(column[SCALE + c], load(column[BASE + c]) * share);
    store(column[COLOUR + c], sigmoid(load(column[COLOUR + c])));
  }
  // dividing by the largest component first keeps norms of 1e-30 and 1e30 exact
  vf q[4], largest = all(0), square = all(0);
  for (int c = 0; c < 4; ++c) {
    q[c] = load(column[QUATERNION + c]);
    largest = maximum(largest, absolute(q[c]));
  }
  const mask zero = largest <= all(0);
  for (int c = 0; c < 4; ++c) {
    q[c] = select(zero, all(c == 0), q[c] / largest);
    square = square + q[c] * q[c];
  }
  const vf inverse = all(1) / square_root(square);
  for (int c = 0; c < 4; ++c) store(column[QUATERNION + c], q[c] * inverse);
  store(kept[3], select(zero, all(0), minimum(inverse / largest, all(3e38f))));
  transpose(column[0], LANES, g.rows[0], LANES);
  transpose(kept[0], LANES, column[0], LANES);
  for (int l = 0; l < g.count; ++l) {
    const float* row = g.rows[l];
    __builtin_memcpy(out.scales + (at + l) * 3, row + SCALE, 3 * sizeof(float));
    __builtin_memcpy(out.quaternions + (at + l) * 4, row + QUATERNION, 4 * sizeof(float));
    __builtin_memcpy(out.colours + (at + l) * 3, row + COLOUR, 3 * sizeof(float));
    __builtin_memcpy(s.kept + (at + l) * KEPT, column[l], KEPT * sizeof(float));
  }
  g.count = 0;
}

void fill(const AnchorArrays& a, const PackedNetworks& n, const DecodeState& s, const DecodeOutputs& out,
          float* scratch, int64_t first, int64_t last, int64_t at) {
  const Memory m = carve(scratch, n);
  const int rows = (int)(last - first), all_outputs = n.output_lanes;
  for (int network = SHAPE_NETWORK; network <= COLOUR_NETWORK; ++network) {
    const PackedLayer& layer = n.layers[network];
    const int lanes = lanes_of(layer.outputs);
    product({s.hidden + first * n.hidden_lanes + layer.first, n.hidden_lanes, 1}, {layer.weight, lanes}, rows, lanes,
            layer.hidden, {layer.bias, 0}, m.outputs + layer.first_output, all_outputs);
  }
  read_sizes(a, m, first, last);
  Group group;
  int64_t begun = at;
  for (int r = 0; r < rows; ++r) {
    const int64_t row = row_of(a, first + r);
    const float* opacity = s.opacity + (first + r) * a.k;
    const float* shape = m.outputs + r * all_outputs + n.layers[SHAPE_NETWORK].first_output;
    const float* colour = m.outputs + r * all_outputs + n.layers[COLOUR_NETWORK].first_output;
    const float *size = m.sizes + r * 6, *centre = a.centres + row * 3, *offsets = a.offsets + row * a.k * 3;
    for (int j = 0; j < a.k; ++j) {
      if (!(opacity[j] > 0)) continue;
      float* raw = group.rows[group.count];
      __builtin_memcpy(raw + SCALE, shape + j * SHAPE, SHAPE * sizeof(float));
      __builtin_memcpy(raw + COLOUR, colour + j * 3, 3 * sizeof(float));
      __builtin_memcpy(raw + BASE, size + 3, 3 * sizeof(float));
      for (int c = 0; c < 3; ++c) out.means[at * 3 + c] = centre[c] + offsets[j * 3 + c] * size[c];
      out.opacities[at] = opacity[j];
      out.rows[at] = row;
      out.slots[at] = row * a.k + j;
      ++at;
      if (++group.count == LANES) {
        flush(group, s, out, begun);
        begun = at;
      }
    }
  }
  if (group.count) flush(group, s, out, begun);
}

// What the gradients by Gaussian p say about the outputs of the networks for it.
INLINE void by_outputs(const DecodeState& s, const DecodeGradients& g, int64_t p, const float* base, float* shape,
                       float* colour) {
  const float* kept = s.kept + p * KEPT;
  if (g.scales)
    for (int c = 0; c < 3; ++c) shape[c] = g.scales[p * 3 + c] * base[c] * kept[c] * (1 - kept[c]);
  if (g.quaternions) {
    const float *by = g.quaternions + p * 4, *q = g.out_quaternions + p * 4;
    const float along = by[0] * q[0] + by[1] * q[1] + by[2] * q[2] + by[3] * q[3];
    for (int c = 0; c < 4; ++c) shape[3 + c] = (by[c] - q[c] * along) * kept[3];
  }
  if (g.colours)
    for (int c = 0; c < 3; ++c) {
      const float value = g.out_colours[p * 3 + c];
      colour[c] = g.colours[p * 3 + c] * value * (1 - value);
    }
}

// Gradients by the Gaussians of a block: to the outputs of its networks, offsets, log scales and, by their means, to
// the centres.
STAGE void by_gaussians(const AnchorArrays& a, const PackedNetworks& n, const DecodeState& s, const DecodeGradients& g,
                        const Memory& m, int64_t first, int64_t last, int64_t at) {
  for (int64_t i = 0; i < (last - first) * n.output_lanes; i += LANES) store(m.outputs + i, all(0));
  for (int r = 0; r < last - first; ++r) {
    const int64_t row = row_of(a, first + r);
    const float *opacity = s.opacity + (first + r) * a.k, *size = m.sizes + r * 6;
    float* outputs = m.outputs + r * n.output_lanes;
    float centre[3] = {}, reach[3] = {}, base[3] = {};
    for (int j = 0; j < a.k; ++j) {
      const int64_t slot = row * a.k + j;
      const bool there = opacity[j] > 0, moved = there && g.means;
      for (int c = 0; c < 3; ++c) {
        const float by = moved ? g.means[at * 3 + c] : 0;
        centre[c] += by;
        reach[c] += by * a.offsets[slot * 3 + c];
        if (g.by_offsets) g.by_offsets[slot * 3 + c] = by * size[c];
      }
      if (!there) continue;
      if (g.opacities) outputs[j] = g.opacities[at] * (1 - opacity[j] * opacity[j]);
      by_outputs(s, g, at, size + 3, outputs + n.layers[SHAPE_NETWORK].first_output + j * SHAPE,
                 outputs + n.layers[COLOUR_NETWORK].first_output + j * 3);
      if (g.scales)
        for (int c = 0; c < 3; ++c) base[c] += g.scales[at * 3 + c] * g.out_scales[at * 3 + c];
      ++at;
    }
    for (int c = 0; c < 3; ++c) {
      if (g.by_centres) g.by_centres[row * 3 + c] = centre[c];
      if (!g.by_log_scales) continue;
      g.by_log_scales[row * 6 + c] = reach[c] * size[c];
      g.by_log_scales[row * 6 + 3 + c] = base[c];
    }
  }
}

// Gradients by the inputs of the networks: to the features and, through direction and distance, to the centres.
STAGE void leave_inputs(const AnchorArrays& a, const DecodeGradients& g, const Memory& m, int lanes, int64_t first,
                        int64_t last) {
  for (int r = 0; r < last - first; ++r) {
    const int64_t row = row_of(a, first + r);
    const float* by = m.by_inputs + r * lanes;
    if (g.by_features)
      __builtin_memcpy(g.by_features + feature_row(a, first + r) * a.f, by, a.f * sizeof(float));
    if (!g.by_centres) continue;
    float direction[3];
    const float distance = look(a, row, direction), divisor = distance > 0 ? distance : 1;
    const float* turn = by + a.f;
    const float along = direction[0] * turn[0] + direction[1] * turn[1] + direction[2] * turn[2];
    const float away = a.with_distance ? turn[3] : 0;
    for (int c = 0; c < 3; ++c)
      g.by_centres[row * 3 + c] += (turn[c] - direction[c] * along) / divisor + away * direction[c];
  }
}

void backward(const AnchorArrays& a, const PackedNetworks& n, const DecodeState& s, const DecodeGradients& g,
              const WeightSums& sums, float* scratch, int64_t first, int64_t last, int64_t at) {
  const Memory m = carve(scratch, n);
  const int rows = (int)(last - first), in = lanes_of(n.inputs), all_hidden = n.hidden_lanes;
  read_sizes(a, m, first, last);
  by_gaussians(a, n, s, g, m, first, last, at);
  if (!g.by_networks && !g.by_features && !g.by_centres) return;
  const float* hidden = s.hidden + first * all_hidden;
  for (int network = 0; network < NETWORKS; ++network) {
    const PackedLayer& layer = n.layers[network];
    const int lanes = lanes_of(layer.outputs), units = lanes_of(layer.hidden);
    const float* by = m.outputs + layer.first_output;
    product({by, n.output_lanes, 1}, {layer.transposed, units}, rows, units, layer.outputs, {nullptr, 0},
            m.by_hidden + layer.first, all_hidden);
    if (!g.by_networks) continue;
    product({hidden + layer.first, 1, all_hidden}, {by, n.output_lanes}, layer.hidden, lanes, rows,
            {sums.layer_weight[network], lanes}, sums.layer_weight[network], lanes);
    add_rows(by, n.output_lanes, rows, lanes, sums.layer_bias[network]);
  }
  for (int i = 0; i < rows * all_hidden; i += LANES)
    store(m.by_hidden + i, keep(load(hidden + i) > all(0), load(m.by_hidden + i)));
  if (g.by_networks) {
    read_inputs(a, in, first, last, m.inputs);
    product({m.inputs, 1, in}, {m.by_hidden, all_hidden}, n.inputs, all_hidden, rows, {sums.weight, all_hidden},
            sums.weight, all_hidden);
    add_rows(m.by_hidden, all_hidden, rows, all_hidden, sums.bias);
  }
  if (!g.by_features && !g.by_centres) return;
  product({m.by_hidden, all_hidden, 1}, {n.transposed, in}, rows, g.by_centres ? in : lanes_of(a.f), all_hidden,
          {nullptr, 0}, m.by_inputs, in);
  leave_inputs(a, g, m, in, first, last);
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::DecodeKernels JOIN(splat_decode_, SPLAT_LEVEL);
const splat::DecodeKernels JOIN(splat_decode_, SPLAT_LEVEL) = {open, fill, backward};
