#include "moving_anchors.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "buffer.hpp"
#include "levels.hpp"
#include "pool.hpp"
#include "sums.hpp"

SPLAT_TABLES(splat::HierarchyKernels, hierarchy)

namespace splat {
namespace {

constexpr int64_t MOST_PARTS = 32;  // partial sums of the networks' gradients, whatever the number of threads

void record_rows(const HierarchyArrays& a, HierarchyPlaces& p) {
  int row = a.f;
  const auto take = [&](int64_t rows) {
    const int here = row;
    row += (int)rows;
    return here;
  };
  p.instances = take(a.h);
  p.centres = take(3);
  p.velocities = take(3);
  p.log_scales = take(3);
  p.peak = take(1);
  p.log_span = take(1);
  for (int level = 0; level < a.levels; ++level) {
    p.nodes[level] = level == 0 ? 1 : p.nodes[level - 1] * a.k;
    p.offsets[level] = take(3 * (level + 1 < a.levels ? (int64_t)p.nodes[level] * a.k : a.gaussians));
  }
  p.width = row;
}

HierarchyPlaces places_of(const HierarchyArrays& a, const HierarchyModel& model) {
  HierarchyPlaces p = {};
  record_rows(a, p);
  const int last = a.levels - 1, lanes = p.nodes[last] * GROUP;
  int64_t size = 0;
  const auto take = [&](int64_t count) {
    const int64_t here = size;
    size += padded(count);
    return here;
  };
  p.record = take(padded(p.width) * GROUP);
  p.by_record = take(padded(p.width) * GROUP);
  for (int64_t* plane : {&p.sine, &p.cosine, &p.life, &p.by_life}) *plane = take(GROUP);
  int64_t outputs = 0, hidden = 0;
  for (int level = 0; level < a.levels; ++level) {
    const int64_t wide = (int64_t)p.nodes[level] * GROUP, held = a.f + (level == last ? VIEW : 0);
    p.inputs[level] = take((a.h + CODE) * wide);
    p.sizes[level] = take(3 * wide);
    p.log_scales_of[level] = level == 0 ? p.record + (int64_t)p.log_scales * GROUP : take(3 * wide);
    p.held[level] = level == 0 && last > 0 ? p.record : take(held * wide);
    p.by_at[level] = take(3 * wide);
    p.by_log_scales[level] = take(3 * wide);
    p.by_held[level] = take(held * wide);
  }
  for (int i = 0; i < model.heads + HEADS; ++i) {
    const SmallNetwork& network = model.networks[i];
    const int64_t wide = (int64_t)p.nodes[std::min(i / RESIDUALS, last)] * GROUP;
    p.hidden[i] = take(network.hidden * wide);
    hidden = std::max(hidden, (int64_t)network.hidden);
    if (i < model.heads) outputs = std::max(outputs, network.outputs * wide);
    else p.heads[i - model.heads] = take(network.outputs * wide);
  }
  p.moved = take((int64_t)model.networks[model.leaf_position].outputs * lanes);
  p.by_inputs = take((int64_t)(a.h + CODE) * lanes);
  p.by_outputs = take(outputs);
  p.by_hidden = take(hidden * lanes);
  int64_t widest = hidden;
  for (int i = 0; i < model.heads + HEADS; ++i) widest = std::max(widest, (int64_t)model.networks[i].outputs);
  p.turned = take(padded(widest) * lanes);
  const int64_t columns = GAUSSIAN * a.gaussians;
  p.decoded = take(padded(columns) * GROUP);
  p.row_stride = padded(std::max<int64_t>(columns, p.width));
  p.rows = take(p.row_stride * GROUP);
  p.size = size;
  return p;
}

// The networks with the time in the biases of those that read it.
struct Prepared {
  HierarchyModel model;
  float code[TIME_CODE];
  std::vector<float> biases;

  Prepared(const HierarchyArrays& a, const std::vector<SmallNetwork>& stored) : model{} {
    model.leaf_position = (a.levels - 1) * RESIDUALS;
    model.heads = model.leaf_position + 1;
    code[0] = a.time;
    for (int octave = 0; octave < OCTAVES; ++octave) {
      code[1 + 2 * octave] = (float)std::sin(std::ldexp((double)a.time, octave));
      code[2 + 2 * octave] = (float)std::cos(std::ldexp((double)a.time, octave));
    }
    size_t units = 0;
    for (int i = 0; i < model.heads; ++i) units += stored[i].hidden;
    biases.resize(units);
    float* bias = biases.data();
    for (size_t i = 0; i < stored.size(); ++i) {
      SmallNetwork& network = model.networks[i];
      network = stored[i];
      if ((int)i >= model.heads) continue;
      network.inputs -= TIME_CODE;
      for (int unit = 0; unit < network.hidden; ++unit) {
        float sum = network.bias0[unit];
        for (int c = 0; c < TIME_CODE; ++c) sum += code[c] * network.weight0[(network.inputs + c) * network.hidden + unit];
        bias[unit] = sum;
      }
      network.bias0 = bias;
      bias += network.hidden;
    }
    model.places = places_of(a, model);
  }
};

int64_t blocks_of(const HierarchyArrays& a) { return (a.count + GROUP - 1) / GROUP; }

// task(first anchor, last anchor, memory)
template <class Task>
void over_blocks(const HierarchyArrays& a, const HierarchyModel& model, int threads, Task task) {
  const int64_t each = model.places.size;
  Buffer<float> memory((size_t)(each * threads));
  parallel(threads, (int)blocks_of(a), [&](int block, int worker) {
    const int64_t first = (int64_t)block * GROUP;
    task(first, std::min(a.count, first + GROUP), memory.data() + each * worker);
  });
}

// Zeroes the rows of the gradients that no decoded anchor from `first` to `last` writes, up to the next decoded one.
void clear_between(const HierarchyArrays& a, const HierarchyPlaces& p, const HierarchyGradients& g, int64_t first,
                   int64_t last) {
  const auto clear = [&](int64_t from, int64_t to) {
    if (to <= from) return;
    const auto zero = [&](float* by, int64_t width) {
      if (by) std::memset(by + from * width, 0, (size_t)((to - from) * width) * sizeof(float));
    };
    if (!a.own_features) zero(g.features, a.f);
    zero(g.instances, a.h);
    for (float* by : {g.centres, g.velocities, g.log_scales}) zero(by, 3);
    for (float* by : {g.peaks, g.log_spans}) zero(by, 1);
    for (int level = 0; level < a.levels; ++level)
      zero(g.offsets[level], 3 * (level + 1 < a.levels ? (int64_t)p.nodes[level + 1] : a.gaussians));
  };
  if (first == 0) clear(0, a.count ? row_of(a, 0) : a.stored);
  for (int64_t i = first; i < last; ++i) clear(row_of(a, i) + 1, i + 1 < a.count ? row_of(a, i + 1) : a.stored);
}

int64_t sums_size(const HierarchyModel& model) {
  int64_t size = 0;
  for (int i = 0; i < model.heads + HEADS; ++i) size += splat::sums_size(model.networks[i]);
  return size;
}

// The sums of all networks in one piece of memory of that size.
void lay_out(const HierarchyModel& model, float* memory, NetworkSums* sums) {
  for (int i = 0; i < model.heads + HEADS; ++i) sums[i] = lay_out_sums(model.networks[i], memory);
}

void leave_all(const Prepared& prepared, const NetworkSums* sums, const std::vector<SmallNetworkGradients>& to) {
  for (size_t i = 0; i < to.size(); ++i) {
    const SmallNetwork& n = prepared.model.networks[i];
    leave_sums(n, sums[i], to[i]);
    if ((int)i >= prepared.model.heads) continue;
    for (int c = 0; c < TIME_CODE; ++c)
      for (int unit = 0; unit < n.hidden; ++unit)
        to[i].weight0[(n.inputs + c) * n.hidden + unit] = prepared.code[c] * sums[i].bias0[unit];
  }
}

}  // namespace

void hierarchy_visible(const HierarchyArrays& a, const std::vector<SmallNetwork>& networks, const Pyramid& pyramid,
                       const float* drift, uint8_t* out, int threads) {
  const Prepared prepared(a, networks);
  over_blocks(a, prepared.model, threads, [&](int64_t first, int64_t last, float* memory) {
    hierarchy_in_use().visible(a, prepared.model, pyramid, drift, out, memory, first, last);
  });
}

void hierarchy_decode(const HierarchyArrays& a, const std::vector<SmallNetwork>& networks,
                      const HierarchyOutputs& out, int threads) {
  const Prepared prepared(a, networks);
  over_blocks(a, prepared.model, threads, [&](int64_t first, int64_t last, float* memory) {
    hierarchy_in_use().decode(a, prepared.model, out, memory, first, last);
  });
}

void hierarchy_backward(const HierarchyArrays& a, const std::vector<SmallNetwork>& networks, HierarchyGradients g,
                        const std::vector<SmallNetworkGradients>& by_networks, int threads) {
  const Prepared prepared(a, networks);
  const HierarchyModel& model = prepared.model;
  const int64_t blocks = blocks_of(a), parts = std::clamp<int64_t>(blocks / 4, 1, MOST_PARTS);
  const int64_t each = model.places.size, size = by_networks.empty() ? 0 : sums_size(model);
  Buffer<float> memory((size_t)(each * threads)), sums((size_t)(size * parts));
  parallel(threads, (int)parts, [&](int part, int worker) {
    NetworkSums here[MOST_NETWORKS];
    if (size) {
      std::fill(sums.data() + size * part, sums.data() + size * (part + 1), 0.0f);
      lay_out(model, sums.data() + size * part, here);
    }
    for (int64_t b = blocks * part / parts; b < blocks * (part + 1) / parts; ++b) {
      const int64_t first = b * GROUP, last = std::min(a.count, first + GROUP);
      hierarchy_in_use().backward(a, model, g, size ? here : nullptr, memory.data() + each * worker, first, last);
      clear_between(a, model.places, g, first, last);
    }
  });
  if (a.count == 0) clear_between(a, model.places, g, 0, 0);
  if (!size) return;
  for (int64_t part = 1; part < parts; ++part)
    for (int64_t i = 0; i < size; ++i) sums[i] += sums[size * part + i];
  NetworkSums total[MOST_NETWORKS];
  lay_out(model, sums.data(), total);
  leave_all(prepared, total, by_networks);
}

}  // namespace splat
