// Decoding of a hierarchy of anchors at one SIMD level; no standard library here (see level.cpp).
//
// Lanes lie side by side in memory, so every step of a network is a product whose left side is the weights as they are
// stored, and everything else is worked on sixteen anchors at a time.
#include "hierarchy.hpp"
#include "simd.hpp"

#include "activations.inl"
#include "products.inl"
#include "planes.inl"
#include "waves.inl"

namespace {

constexpr float WHOLE_TURN = 6.28318531f;
INLINE int64_t offsets_of(const HierarchyArrays& a, const HierarchyPlaces& p, int layer) {
  return 3 * (int64_t)(layer < a.levels ? p.nodes[layer] : a.gaussians);
}

// Lanes beyond the last anchor are those of an anchor whose every number is 0.
STAGE void read_records(const HierarchyArrays& a, const HierarchyPlaces& p, float* m, int64_t first, int64_t last) {
  float* rows = m + p.rows;
  clear((GROUP - (last - first)) * p.row_stride, rows + (last - first) * p.row_stride);
  for (int64_t i = first; i < last; ++i) {
    const int64_t row = row_of(a, i);
    float* to = rows + (i - first) * p.row_stride;
    piece(a.features, feature_row(a, i), a.f, to);
    piece(a.instances, row, a.h, to);
    piece(a.centres, row, 3, to);
    piece(a.velocities, row, 3, to);
    piece(a.log_scales, row, 3, to);
    piece(a.peaks, row, 1, to);
    piece(a.log_spans, row, 1, to);
    for (int layer = 1; layer <= a.levels; ++layer)
      piece(a.offsets[layer - 1], row, offsets_of(a, p, layer), to);
  }
  to_planes(rows, p.row_stride, p.width, m + p.record);
}

STAGE void leave_records(const HierarchyArrays& a, const HierarchyPlaces& p, const HierarchyGradients& g, float* m,
                         int64_t first, int64_t last) {
  to_rows(m + p.by_record, p.width, m + p.rows, p.row_stride);
  for (int64_t i = first; i < last; ++i) {
    const int64_t row = row_of(a, i);
    const float* from = m + p.rows + (i - first) * p.row_stride;
    leave(from, feature_row(a, i), a.f, g.features);
    leave(from, row, a.h, g.instances);
    leave(from, row, 3, g.centres);
    leave(from, row, 3, g.velocities);
    leave(from, row, 3, g.log_scales);
    leave(from, row, 1, g.peaks);
    leave(from, row, 1, g.log_spans);
    for (int layer = 1; layer <= a.levels; ++layer) leave(from, row, offsets_of(a, p, layer), g.offsets[layer - 1]);
  }
}

// Sines and cosines of a position's first octave; each further one by doubling the angle, which is exact to 1e-6.
STAGE void write_code(float* code, int lanes) {
  for (int i = 0; i < 3 * lanes; i += LANES) {
    vf sine, cosine;
    sine_cosine(load(code + i), sine, cosine);
    float* to = code + 3 * lanes + i;
    for (int octave = 0; octave < OCTAVES; ++octave, to += 6 * lanes) {
      store(to, sine);
      store(to + 3 * lanes, cosine);
      const vf twice = sine + sine;
      cosine = all(1) - twice * sine;
      sine = twice * load(to + 3 * lanes);
    }
  }
}

// by_at += what the gradients by a code say about its position.
STAGE void pull_code(const float* code, const float* by_code, int lanes, float* by_at) {
  for (int i = 0; i < 3 * lanes; i += LANES) {
    vf sum = load(by_at + i) + load(by_code + i);
    float factor = 1;
    for (int octave = 0; octave < OCTAVES; ++octave, factor *= 2) {
      const int64_t at = (int64_t)(3 + 6 * octave) * lanes + i, other = at + 3 * lanes;
      sum = sum + all(factor) * (load(by_code + at) * load(code + other) - load(by_code + other) * load(code + at));
    }
    store(by_at + i, sum);
  }
}

// visit(parent, child, nth): lanes from which a node's planes start, in its layer's planes, and which child it is.
template <class Visit>
INLINE void each_child(const HierarchyArrays& a, int nodes, Visit visit) {
  for (int node = 0; node < nodes; ++node)
    for (int q = 0; q < a.k; ++q) visit(node * GROUP, (node * a.k + q) * GROUP, q);
}

STAGE void vibrate(const HierarchyArrays& a, const HierarchyPlaces& p, float* m) {
  const float *record = m + p.record, *peaks = record + p.peak * GROUP, *spans = record + p.log_span * GROUP;
  for (int i = 0; i < GROUP; i += LANES) {
    const vf since = all(a.time) - load(peaks + i);
    vf sine, cosine;
    sine_cosine(all(WHOLE_TURN) * since / all(a.period), sine, cosine);
    store(m + p.sine + i, sine);
    store(m + p.cosine + i, cosine);
    const vf spread = since * exponential(all(0) - load(spans + i));
    store(m + p.life + i, exponential(all(-0.5f) * spread * spread));
    for (int c = 0; c < 3; ++c) {
      const vf swing = all(a.period / WHOLE_TURN) * sine * load(record + (p.velocities + c) * GROUP + i);
      store(m + p.inputs[0] + (a.h + c) * GROUP + i, load(record + (p.centres + c) * GROUP + i) + swing);
    }
  }
}

// Positions, scales and, where asked for, features of the children of layer `level`.
STAGE void descend(const HierarchyArrays& a, const HierarchyModel& net, float* m, int level, bool features) {
  const HierarchyPlaces& p = net.places;
  const int lanes = p.nodes[level] * GROUP, below = lanes * a.k;
  const float *inputs = m + p.inputs[level], *sizes = m + p.sizes[level];
  const float* offsets = m + p.record + (int64_t)p.offsets[level] * GROUP;
  float* change = m + p.by_outputs;
  const struct {
    const float* of;
    float* to;
    int width;
  } parts[RESIDUALS] = {{inputs + a.h * lanes, m + p.inputs[level + 1] + a.h * below, 3},
                        {m + p.log_scales_of[level], m + p.log_scales_of[level + 1], 3},
                        {m + p.held[level], m + p.held[level + 1], a.f}};
  for (int part = 0; part < (features ? RESIDUALS : FEATURE); ++part) {
    const int number = level * RESIDUALS + part, width = parts[part].width;
    evaluate(net.networks[number], inputs, lanes, m + p.hidden[number], change);
    each_child(a, p.nodes[level], [&](int parent, int child, int q) {
      for (int c = 0; c < width; ++c) {
        const float *from = parts[part].of + c * lanes + parent, *by = change + (q * width + c) * lanes + parent;
        float* to = parts[part].to + c * below + child;
        each(GROUP, to, [=](int64_t i) { return load(from + i) + load(by + i); });
        if (part != POSITION) continue;
        const float *offset = offsets + 3 * child + c * GROUP, *size = sizes + c * lanes + parent;
        each(GROUP, to, [=](int64_t i) { return load(to + i) + load(offset + i) * load(size + i); });
      }
    });
  }
}

// Everything of all layers of anchors, and where the Gaussians of the last stand; features where asked for.
STAGE void place(const HierarchyArrays& a, const HierarchyModel& net, float* m, bool features) {
  const HierarchyPlaces& p = net.places;
  vibrate(a, p, m);
  for (int level = 0; level < a.levels; ++level) {
    const int lanes = p.nodes[level] * GROUP;
    float *inputs = m + p.inputs[level], *log_scales = m + p.log_scales_of[level];
    const float* instances = m + p.record + p.instances * GROUP;
    for (int row = 0; row < a.h; ++row)
      for (int node = 0; node < p.nodes[level]; ++node)
        copy(instances + row * GROUP, GROUP, inputs + row * lanes + node * GROUP);
    write_code(inputs + a.h * lanes, lanes);
    each(3 * lanes, m + p.sizes[level], [=](int64_t i) { return exponential(load(log_scales + i)); });
    if (level + 1 < a.levels) descend(a, net, m, level, features);
    else evaluate(net.networks[net.leaf_position], inputs, lanes, m + p.hidden[net.leaf_position], m + p.moved);
  }
}

struct Last {  // the last layer of anchors
  int nodes, lanes, each;  // `each`: Gaussians of one
  const float *at, *sizes, *offsets, *moved;
  INLINE Last of(const HierarchyArrays& a, const HierarchyPlaces& p, const float* m) {
    const int last = a.levels - 1, nodes = p.nodes[last], lanes = nodes * GROUP;
    return {nodes, lanes, a.gaussians / nodes, m + p.inputs[last] + a.h * lanes, m + p.sizes[last],
            m + p.record + (int64_t)p.offsets[last] * GROUP, m + p.moved};
  }
  // Offset of Gaussian g of a node from it, along one axis.
  __attribute__((always_inline)) vf away(int node, int g, int axis, int i) const {
    const vf offset = load(offsets + ((int64_t)(node * each + g) * 3 + axis) * GROUP + i);
    return offset * load(sizes + axis * lanes + node * GROUP + i) +
           load(moved + (g * 3 + axis) * lanes + node * GROUP + i);
  }
};

void visible(const HierarchyArrays& a, const HierarchyModel& net, const Pyramid& pyramid, const float* drift,
             uint8_t* out, float* m, int64_t first, int64_t last) {
  const HierarchyPlaces& p = net.places;
  read_records(a, p, m, first, last);
  place(a, net, m, false);
  const Last l = Last::of(a, p, m);
  alignas(64) float moved[3 * GROUP] = {}, shown[GROUP] = {};
  for (int64_t i = first; drift && i < last; ++i)
    for (int c = 0; c < 3; ++c) moved[c * GROUP + i - first] = drift[3 * i + c];
  for (int node = 0; node < l.nodes; ++node)
    for (int i = 0; i < GROUP; i += LANES) {
      vf square = all(0), largest = all(0), at[3], local[3];
      for (int g = 0; g < l.each; ++g) {
        const vf x = l.away(node, g, 0, i), y = l.away(node, g, 1, i), z = l.away(node, g, 2, i);
        square = maximum(square, x * x + y * y + z * z);
      }
      for (int c = 0; c < 3; ++c) {
        at[c] = load(l.at + c * l.lanes + node * GROUP + i) + load(moved + c * GROUP + i);
        largest = maximum(largest, load(l.sizes + c * l.lanes + node * GROUP + i));
      }
      for (int c = 0; c < 3; ++c) {
        const float* row = pyramid.rotation + 3 * c;
        local[c] = all(row[0]) * at[0] + all(row[1]) * at[1] + all(row[2]) * at[2] + all(pyramid.shift[c]);
      }
      const vf away = square_root(square), depth = local[2], far = maximum(depth, all(0) - depth);
      const vf radius = away + all(pyramid.sigmas) * largest + all(pyramid.blur) * (far + away);
      vf inside = select(depth + away <= all(pyramid.near), all(0), all(1));
      for (const auto& side : pyramid.sides) {
        const vf along = local[0] * all(side[0]) + local[1] * all(side[1]) + local[2] * all(side[2]);
        inside = select(along + radius <= all(0), all(0), inside);
      }
      store(shown + i, maximum(load(shown + i), inside));
    }
  for (int64_t i = first; i < last; ++i) out[i] = shown[i - first] > 0;
}

// Features, distance and direction of the last anchors, and the networks that read them, activated.
STAGE void run_heads(const HierarchyArrays& a, const HierarchyModel& net, float* m) {
  const HierarchyPlaces& p = net.places;
  const Last l = Last::of(a, p, m);
  float *seen = m + p.held[a.levels - 1], *view = seen + a.f * l.lanes;
  if (a.levels == 1) copy(m + p.record, (int64_t)a.f * GROUP, seen);
  for (int i = 0; i < l.lanes; i += LANES) {
    vf offset[3], square = all(0);
    for (int c = 0; c < 3; ++c) {
      offset[c] = load(l.at + c * l.lanes + i) - all(a.camera[c]);
      square = square + offset[c] * offset[c];
    }
    const vf distance = square_root(square), divisor = select(square <= all(0), all(1), distance);
    store(view + i, distance);
    for (int c = 0; c < 3; ++c) store(view + (1 + c) * l.lanes + i, offset[c] / divisor);
  }
  for (int head = 0; head < HEADS; ++head) {
    const int number = net.heads + head;
    float* out = m + p.heads[head];
    evaluate(net.networks[number], seen, l.lanes, m + p.hidden[number], out);
    const int rows = net.networks[number].outputs;
    for (int row = 0; row < rows; ++row) {
      float* here = out + row * l.lanes;
      if (head == SHAPE_HEAD && row % 7 >= 3) continue;  // quaternions
      each(l.lanes, here, [=](int64_t i) { return sigmoid(load(here + i)); });
    }
  }
}

struct Columns {  // of an anchor's Gaussians: one kind of number after another
  int means, quaternions, scales, opacities, colours;
  INLINE Columns of(int k) { return {0, 3 * k, 7 * k, 10 * k, 11 * k}; }
};

void decode(const HierarchyArrays& a, const HierarchyModel& net, const HierarchyOutputs& out, float* m, int64_t first,
            int64_t last) {
  const HierarchyPlaces& p = net.places;
  read_records(a, p, m, first, last);
  place(a, net, m, true);
  run_heads(a, net, m);
  const Last l = Last::of(a, p, m);
  const int k = a.gaussians;
  const Columns at = Columns::of(k);
  float* planes = m + p.decoded;
  const float *colours = m + p.heads[COLOUR_HEAD], *opacities = m + p.heads[OPACITY_HEAD], *shapes = m + p.heads[SHAPE_HEAD];
  for (int node = 0; node < l.nodes; ++node)
    for (int g = 0; g < l.each; ++g) {
      const int j = node * l.each + g;
      const auto put = [&](int column, auto value) {
        each(GROUP, planes + (int64_t)column * GROUP, [&](int64_t i) { return value((int)i); });
      };
      const auto head = [&](const float* of, int row, int64_t i) { return load(of + row * l.lanes + node * GROUP + i); };
      for (int c = 0; c < 3; ++c) {
        put(at.means + j * 3 + c, [&](int i) {
          return all(a.unit) * (load(l.at + c * l.lanes + node * GROUP + i) + l.away(node, g, c, i)) + all(a.middle[c]);
        });
        put(at.scales + j * 3 + c, [&](int i) { return all(a.unit) * head(l.sizes, c, i) * head(shapes, g * 7 + c, i); });
        put(at.colours + j * 3 + c, [&](int i) { return head(colours, g * 3 + c, i); });
      }
      for (int c = 0; c < 4; ++c) put(at.quaternions + j * 4 + c, [&](int i) { return head(shapes, g * 7 + 3 + c, i); });
      put(at.opacities + j, [&](int i) { return head(opacities, g, i) * load(m + p.life + i); });
    }
  to_rows(planes, GAUSSIAN * k, m + p.rows, p.row_stride);
  for (int64_t i = first; i < last; ++i) {
    const float* from = m + p.rows + (i - first) * p.row_stride;
    leave(from, i, 3 * k, out.means);
    leave(from, i, 4 * k, out.quaternions);
    leave(from, i, 3 * k, out.scales);
    leave(from, i, k, out.opacities);
    leave(from, i, 3 * k, out.colours);
    const int64_t row = row_of(a, i);
    for (int64_t j = 0; j < k; ++j) {
      out.rows[i * k + j] = row;
      out.slots[i * k + j] = row * k + j;
    }
  }
}

STAGE void read_gradients(const HierarchyArrays& a, const HierarchyPlaces& p, const HierarchyGradients& g, float* m,
                          int64_t first, int64_t last) {
  const int k = a.gaussians;
  float* rows = m + p.rows;
  clear(GROUP * p.row_stride, rows);
  for (int64_t i = first; i < last; ++i) {
    float* to = rows + (i - first) * p.row_stride;
    piece(g.means, i, 3 * k, to);
    piece(g.quaternions, i, 4 * k, to);
    piece(g.scales, i, 3 * k, to);
    piece(g.opacities, i, k, to);
    piece(g.colours, i, 3 * k, to);
  }
  to_planes(rows, p.row_stride, GAUSSIAN * k, m + p.decoded);
}

// Gradients by the Gaussians: to the outputs of the heads, which they take the place of, to the residuals of the
// positions, to life, offsets, positions and scales.
STAGE void pull_gaussians(const HierarchyArrays& a, const HierarchyModel& net, float* m) {
  const HierarchyPlaces& p = net.places;
  const Last l = Last::of(a, p, m);
  const Columns at = Columns::of(a.gaussians);
  const int last = a.levels - 1;
  const float *by = m + p.decoded, *life = m + p.life;
  float *colours = m + p.heads[COLOUR_HEAD], *opacities = m + p.heads[OPACITY_HEAD], *shapes = m + p.heads[SHAPE_HEAD];
  float *by_at = m + p.by_at[last], *by_scales = m + p.by_log_scales[last], *moved = m + p.by_outputs;
  float *by_offsets = m + p.by_record + (int64_t)p.offsets[last] * GROUP, *by_life = m + p.by_life;
  clear(3 * l.lanes, by_at);
  clear(3 * l.lanes, by_scales);
  clear(GROUP, by_life);
  for (int node = 0; node < l.nodes; ++node)
    for (int g = 0; g < l.each; ++g)
      for (int i = 0; i < GROUP; i += LANES) {
        const int j = node * l.each + g;
        const int64_t lane = node * GROUP + i;
        const auto of = [&](int column) { return load(by + (int64_t)column * GROUP + i); };
        for (int c = 0; c < 3; ++c) {
          float *colour = colours + (g * 3 + c) * l.lanes + lane, *share = shapes + (g * 7 + c) * l.lanes + lane;
          const vf value = load(colour), grown = load(share), size = load(l.sizes + c * l.lanes + lane);
          store(colour, of(at.colours + j * 3 + c) * value * (all(1) - value));
          const vf by_scale = all(a.unit) * of(at.scales + j * 3 + c) * size * grown;
          const vf by_mean = all(a.unit) * of(at.means + j * 3 + c);
          store(share, by_scale * (all(1) - grown));
          const int64_t offset = (int64_t)(j * 3 + c) * GROUP + i;
          const vf reached = by_mean * size;
          store(by_offsets + offset, reached);
          store(moved + (g * 3 + c) * l.lanes + lane, by_mean);
          float *here = by_at + c * l.lanes + lane, *scale = by_scales + c * l.lanes + lane;
          store(here, load(here) + by_mean);
          store(scale, load(scale) + by_scale + reached * load(l.offsets + offset));
        }
        for (int c = 0; c < 4; ++c) store(shapes + (g * 7 + 3 + c) * l.lanes + lane, of(at.quaternions + j * 4 + c));
        float* opacity = opacities + g * l.lanes + lane;
        const vf by_opacity = of(at.opacities + j), value = load(opacity);
        store(by_life + i, load(by_life + i) + by_opacity * value);
        store(opacity, by_opacity * load(life + i) * value * (all(1) - value));
      }
}

// Through the heads, to the features and, by way of distance and direction, to the positions.
STAGE void pull_heads(const HierarchyArrays& a, const HierarchyModel& net, const NetworkSums* sums, float* m) {
  const HierarchyPlaces& p = net.places;
  const Last l = Last::of(a, p, m);
  const int last = a.levels - 1;
  const float *seen = m + p.held[last], *view = seen + a.f * l.lanes;
  float *by_seen = m + p.by_held[last], *by_view = by_seen + a.f * l.lanes, *by_at = m + p.by_at[last];
  clear((int64_t)(a.f + VIEW) * l.lanes, by_seen);
  for (int head = 0; head < HEADS; ++head) {
    const int number = net.heads + head;
    pull(net.networks[number], sums ? sums + number : nullptr, seen, m + p.hidden[number], m + p.heads[head],
         l.lanes, m + p.by_hidden, m + p.turned, by_seen);
  }
  for (int i = 0; i < l.lanes; i += LANES) {
    const vf distance = load(view + i), divisor = select(distance <= all(0), all(1), distance);
    vf along = all(0);
    for (int c = 1; c < VIEW; ++c) along = along + load(view + c * l.lanes + i) * load(by_view + c * l.lanes + i);
    for (int c = 0; c < 3; ++c) {
      const vf direction = load(view + (1 + c) * l.lanes + i), turned = load(by_view + (1 + c) * l.lanes + i);
      float* to = by_at + c * l.lanes + i;
      store(to, load(to) + (turned - direction * along) / divisor + load(by_view + i) * direction);
    }
  }
}

// From the inputs of the networks of a layer, to its positions and to the instances of the record.
STAGE void pull_inputs(const HierarchyArrays& a, const HierarchyPlaces& p, float* m, int level) {
  const int lanes = p.nodes[level] * GROUP;
  const float* by = m + p.by_inputs;
  float* instances = m + p.by_record + p.instances * GROUP;
  for (int row = 0; row < a.h; ++row)
    for (int node = 0; node < p.nodes[level]; ++node)
      add(by + row * lanes + node * GROUP, GROUP, instances + row * GROUP);
  pull_code(m + p.inputs[level] + a.h * lanes, by + a.h * lanes, lanes, m + p.by_at[level]);
}

// From a layer's children to itself.
STAGE void ascend(const HierarchyArrays& a, const HierarchyModel& net, const NetworkSums* sums, float* m, int level) {
  const HierarchyPlaces& p = net.places;
  const int nodes = p.nodes[level], lanes = nodes * GROUP, below = lanes * a.k;
  const float *inputs = m + p.inputs[level], *sizes = m + p.sizes[level];
  const int64_t offsets = (int64_t)p.offsets[level] * GROUP;
  float *change = m + p.by_outputs, *by_scales = m + p.by_log_scales[level];
  const struct {
    const float* by;
    float* to;
    int width;
  } parts[RESIDUALS] = {{m + p.by_at[level + 1], m + p.by_at[level], 3},
                        {m + p.by_log_scales[level + 1], by_scales, 3},
                        {m + p.by_held[level + 1], m + p.by_held[level], a.f}};
  clear((int64_t)(a.h + CODE) * lanes, m + p.by_inputs);
  for (const auto& part : parts) clear((int64_t)part.width * lanes, part.to);
  for (int number = 0; number < RESIDUALS; ++number) {
    const auto& part = parts[number];
    each_child(a, nodes, [&](int parent, int child, int q) {
      for (int c = 0; c < part.width; ++c) {
        const float* by = part.by + c * below + child;
        copy(by, GROUP, change + (q * part.width + c) * lanes + parent);
        add(by, GROUP, part.to + c * lanes + parent);
        if (number != POSITION) continue;
        const int64_t offset = offsets + 3 * child + c * GROUP;
        const float *size = sizes + c * lanes + parent, *held = m + p.record + offset;
        float *by_offset = m + p.by_record + offset, *scale = by_scales + c * lanes + parent;
        each(GROUP, by_offset, [=](int64_t i) { return load(by + i) * load(size + i); });
        each(GROUP, scale, [=](int64_t i) { return load(scale + i) + load(by_offset + i) * load(held + i); });
      }
    });
    const int network = level * RESIDUALS + number;
    pull(net.networks[network], sums ? sums + network : nullptr, inputs, m + p.hidden[network], change, lanes,
         m + p.by_hidden, m + p.turned, m + p.by_inputs);
  }
  pull_inputs(a, p, m, level);
}

// Layer 0 and life: the rest of the record.
STAGE void pull_stored(const HierarchyArrays& a, const HierarchyPlaces& p, float* m) {
  const float *record = m + p.record, *by_at = m + p.by_at[0];
  float* by = m + p.by_record;
  copy(m + p.by_held[0], (int64_t)a.f * GROUP, by);
  copy(by_at, 3 * GROUP, by + p.centres * GROUP);
  copy(m + p.by_log_scales[0], 3 * GROUP, by + p.log_scales * GROUP);
  for (int i = 0; i < GROUP; i += LANES) {
    vf by_sine = all(0);
    for (int c = 0; c < 3; ++c) {
      const vf here = load(by_at + c * GROUP + i);
      by_sine = by_sine + here * load(record + (p.velocities + c) * GROUP + i);
      store(by + (p.velocities + c) * GROUP + i, all(a.period / WHOLE_TURN) * load(m + p.sine + i) * here);
    }
    const vf since = all(a.time) - load(record + p.peak * GROUP + i);
    const vf inverse = exponential(all(0) - load(record + p.log_span * GROUP + i)), spread = since * inverse;
    const vf by_spread = load(m + p.by_life + i) * load(m + p.life + i) * spread;
    store(by + p.log_span * GROUP + i, by_spread * spread);
    store(by + p.peak * GROUP + i, by_spread * inverse - by_sine * load(m + p.cosine + i));
  }
}

void backward(const HierarchyArrays& a, const HierarchyModel& net, const HierarchyGradients& g,
              const NetworkSums* sums, float* m, int64_t first, int64_t last) {
  const HierarchyPlaces& p = net.places;
  const int leaf = a.levels - 1, lanes = p.nodes[leaf] * GROUP;
  read_records(a, p, m, first, last);
  place(a, net, m, true);
  run_heads(a, net, m);
  read_gradients(a, p, g, m, first, last);
  clear((int64_t)a.h * GROUP, m + p.by_record + p.instances * GROUP);
  pull_gaussians(a, net, m);
  clear((int64_t)(a.h + CODE) * lanes, m + p.by_inputs);
  pull(net.networks[net.leaf_position], sums ? sums + net.leaf_position : nullptr, m + p.inputs[leaf],
       m + p.hidden[net.leaf_position], m + p.by_outputs, lanes, m + p.by_hidden,
       m + p.turned, m + p.by_inputs);
  pull_inputs(a, p, m, leaf);
  pull_heads(a, net, sums, m);
  for (int level = leaf - 1; level >= 0; --level) ascend(a, net, sums, m, level);
  pull_stored(a, p, m);
  leave_records(a, p, g, m, first, last);
}

}  // namespace

#define JOIN2(a, b) a##b
#define JOIN(a, b) JOIN2(a, b)

extern const splat::HierarchyKernels JOIN(splat_hierarchy_, SPLAT_LEVEL);
const splat::HierarchyKernels JOIN(splat_hierarchy_, SPLAT_LEVEL) = {visible, decode, backward};
