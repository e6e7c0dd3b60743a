// The field over all threads, for Python.
#include "field.hpp"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <vector>

#include "arrays.hpp"
#include "buffer.hpp"
#include "decode.hpp"
#include "levels.hpp"
#include "pool.hpp"
#include "render.hpp"

SPLAT_TABLES(splat::FieldKernels, field)

namespace splat {
namespace {

constexpr int64_t MOST_PARTS = 64;  // of the places, whatever the number of threads: each has sums of its own
constexpr int64_t PIECE = 16 * FIELD_ROWS;

using Matrix = In<float, 2>;
using Row = In<float, 1>;
using Grid = In<float, 4>;

struct FieldTensors {
  Matrix places;
  std::vector<Grid> grids;
  Matrix hidden;
  Row hidden_bias;
  Matrix out;
  Row out_bias;

  FieldArrays arrays() const {
    FieldArrays a = {places.data(), (int64_t)places.shape(0), {}, {}, (int)out.shape(0), (int)out.shape(1)};
    for (int g = 0; g < FIELD_GRIDS; ++g) {
      a.grids[g] = grids[(size_t)g].data();
      a.sides[g] = (int)grids[(size_t)g].shape(0);
    }
    return a;
  }

  // Throws std::invalid_argument where they do not fit together.
  void check_all() const {
    check(places.shape(1) == 3, "places");
    check(grids.size() == FIELD_GRIDS, "the list of grids");
    for (const Grid& g : grids)
      check(g.shape(0) >= 2 && g.shape(0) < 1 << 10 && g.shape(1) == g.shape(0) && g.shape(2) == g.shape(0) &&
                g.shape(3) == FIELD_CHANNELS,
            "a grid");
    const size_t width = out.shape(0), outputs = out.shape(1);
    check(hidden.shape(0) == FIELD_FEATURES && hidden.shape(1) == width && width > 0, "hidden");
    check(hidden_bias.shape(0) == width, "hidden_bias");
    check(outputs > 0 && outputs <= LANES && out_bias.shape(0) == outputs, "out");
  }
};

// The network, padded; or the sums of the gradients by it, in the same places.
class FieldMemory {
 public:
  FieldMemory(int width, int64_t copies) : lanes_(lanes_of(width)), width_(width) {
    size_ = (size_t)(FIELD_FEATURES + 1) * lanes_ + (size_t)(width + 1) * LANES;
    memory_.resize(size_ * copies);
    std::fill(memory_.data(), memory_.data() + memory_.size(), 0.0f);
  }
  FieldSums at(int64_t copy) {
    FieldSums s;
    s.hidden = memory_.data() + size_ * copy;
    s.hidden_bias = s.hidden + FIELD_FEATURES * lanes_;
    s.out = s.hidden_bias + lanes_;
    s.out_bias = s.out + width_ * LANES;
    return s;
  }
  void add(int64_t copy) {
    for (size_t i = 0; i < size_; ++i) memory_[i] += memory_[size_ * copy + i];
  }

 private:
  ptrdiff_t lanes_, width_;
  size_t size_;
  Buffer<float> memory_;
};

void copy_rows(const float* from, ptrdiff_t from_stride, int rows, int columns, float* to, ptrdiff_t to_stride) {
  for (int r = 0; r < rows; ++r) std::copy(from + r * from_stride, from + r * from_stride + columns, to + r * to_stride);
}

struct Network {
  FieldMemory memory;
  std::vector<float> turned;
  PackedField field;

  explicit Network(const FieldTensors& t) : memory((int)t.out.shape(0), 1) {
    const int width = (int)t.out.shape(0), outputs = (int)t.out.shape(1), lanes = lanes_of(width);
    const FieldSums p = memory.at(0);
    turned.assign((size_t)width * LANES + (size_t)outputs * lanes, 0.0f);
    float *hidden = turned.data(), *out = hidden + (size_t)width * LANES;
    copy_rows(t.hidden.data(), width, FIELD_FEATURES, width, p.hidden, lanes);
    copy_rows(t.hidden_bias.data(), width, 1, width, p.hidden_bias, lanes);
    copy_rows(t.out.data(), outputs, width, outputs, p.out, LANES);
    copy_rows(t.out_bias.data(), outputs, 1, outputs, p.out_bias, LANES);
    for (int f = 0; f < FIELD_FEATURES; ++f)
      for (int i = 0; i < width; ++i) hidden[i * LANES + f] = t.hidden.data()[f * width + i];
    for (int i = 0; i < width; ++i)
      for (int o = 0; o < outputs; ++o) out[o * lanes + i] = t.out.data()[i * outputs + o];
    field = {lanes, p.hidden, p.hidden_bias, hidden, p.out, p.out_bias, out};
  }
};

void evaluate(const FieldTensors& tensors, Out<float, 2> features, Out<float, 2> values) {
  const FieldArrays a = tensors.arrays();
  check(features.shape(0) == (size_t)a.count && features.shape(1) == FIELD_FEATURES, "features");
  check(values.shape(0) == (size_t)a.count && values.shape(1) == (size_t)a.outputs, "values");
  float *kept = features.data(), *to = values.data();
  nb::gil_scoped_release release;
  const Network network(tensors);
  const int64_t each = field_scratch(network.field);
  Buffer<float> scratch((size_t)(each * threads()));
  parallel(threads(), (int)((a.count + PIECE - 1) / PIECE), [&](int piece, int worker) {
    for (int64_t i = piece * PIECE; i < std::min(a.count, (piece + 1) * PIECE); i += FIELD_ROWS)
      field_in_use().forward(a, network.field, scratch.data() + each * worker, i, std::min(a.count, i + FIELD_ROWS),
                              kept, to);
  });
}

void evaluate_backward(const FieldTensors& tensors, Matrix features, Matrix of, const std::vector<Out<float, 4>>& by_grids,
                       Out<float, 2> by_hidden, Out<float, 1> by_hidden_bias, Out<float, 2> by_out,
                       Out<float, 1> by_out_bias) {
  const FieldArrays a = tensors.arrays();
  const int64_t n = a.count;
  check(features.size() == (size_t)n * FIELD_FEATURES, "features");
  check(of.size() == (size_t)n * a.outputs, "gradient by values");
  check(by_grids.size() == FIELD_GRIDS, "the list of gradients by grids");
  for (size_t g = 0; g < FIELD_GRIDS; ++g) check(by_grids[g].size() == tensors.grids[g].size(), "gradient by a grid");
  check(by_hidden.size() == tensors.hidden.size() && by_hidden_bias.size() == (size_t)a.width &&
            by_out.size() == tensors.out.size() && by_out_bias.size() == (size_t)a.outputs,
        "gradient by the network");
  nb::gil_scoped_release release;
  const Network network(tensors);
  const int lanes = network.field.lanes;
  const int64_t each = field_scratch(network.field), parts = std::clamp<int64_t>(n / PIECE, 1, MOST_PARTS);
  Buffer<float> scratch((size_t)(each * threads())), by_features((size_t)(n * FIELD_FEATURES));
  FieldMemory sums(a.width, parts);
  parallel(threads(), (int)parts, [&](int part, int worker) {
    const int64_t last = n * (part + 1) / parts;
    for (int64_t i = n * part / parts; i < last; i += FIELD_ROWS)
      field_in_use().backward(a, network.field, features.data(), of.data(), scratch.data() + each * worker, i,
                               std::min(last, i + FIELD_ROWS), by_features.data(), sums.at(part));
  });
  // a grid is one thread's: places are added in their order, whatever the number of threads
  parallel(threads(), FIELD_GRIDS, [&](int g, int) {
    float* by = by_grids[(size_t)g].data();
    std::fill(by, by + by_grids[(size_t)g].size(), 0.0f);
    field_in_use().scatter(a, g, by_features.data(), by);
  });
  for (int64_t part = 1; part < parts; ++part) sums.add(part);
  const FieldSums total = sums.at(0);
  copy_rows(total.hidden, lanes, FIELD_FEATURES, a.width, by_hidden.data(), a.width);
  copy_rows(total.hidden_bias, lanes, 1, a.width, by_hidden_bias.data(), a.width);
  copy_rows(total.out, LANES, a.width, a.outputs, by_out.data(), a.outputs);
  copy_rows(total.out_bias, LANES, 1, a.outputs, by_out_bias.data(), a.outputs);
}

}  // namespace

void bind_field(nb::module_& m) {
  nb::class_<FieldTensors>(m, "Field", "Places, and the grids and network that give them values.")
      .def("__init__",
           [](FieldTensors* self, Matrix places, const std::vector<Grid>& grids, Matrix hidden, Row hidden_bias,
              Matrix out, Row out_bias) {
             new (self) FieldTensors{places, grids, hidden, hidden_bias, out, out_bias};
             self->check_all();
           },
           array("places"), array("grids"), array("hidden"), array("hidden_bias"), array("out"), array("out_bias"));
  m.def("evaluate_field", &evaluate, nb::arg("field"), array("features"), array("values"),
        "Features and values of all places into the given arrays.");
  m.def("evaluate_field_backward", &evaluate_backward, nb::arg("field"), array("features"), array("of"),
        array("by_grids"), array("by_hidden"), array("by_hidden_bias"), array("by_out"), array("by_out_bias"),
        "Gradients by grids and network from the gradient by the values.");
}

}  // namespace splat
