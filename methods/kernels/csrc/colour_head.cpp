// The colour head over all threads, for Python.
#include "colour_head.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <vector>

#include "arrays.hpp"
#include "buffer.hpp"
#include "decode.hpp"
#include "levels.hpp"
#include "pool.hpp"
#include "render.hpp"

SPLAT_TABLES(splat::HeadKernels, head)

namespace splat {
namespace {

constexpr int64_t MOST_PARTS = 64;  // of the Gaussians, whatever the number of threads: each has sums of its own

using Matrix = In<float, 2>;
using Row = In<float, 1>;

struct HeadTensors {
  Matrix colours, of_each;
  In<int64_t, 1> owner;
  Matrix of_colour, second;
  Row second_bias;
  Matrix third;
  Row third_bias;

  HeadArrays arrays() const {
    return {colours.data(), of_each.data(), owner.data(), (int64_t)colours.shape(0), (int64_t)of_each.shape(0),
            (int)second.shape(0), (int)second.shape(1)};
  }

  void check_all() const {
    const size_t m = colours.shape(0), one = second.shape(0), two = second.shape(1);
    check(colours.shape(1) == 3, "colours");
    check(of_each.shape(1) == one, "of_each");
    check(owner.shape(0) == m, "owner");
    check(of_colour.shape(0) == 3 && of_colour.shape(1) == one, "the first layer");
    check(one > 0 && two > 0 && second_bias.shape(0) == two, "the second layer");
    check(third.shape(0) == two && third.shape(1) == HEAD_OUTPUTS && third_bias.shape(0) == HEAD_OUTPUTS,
          "the third layer");
    int64_t before = 0;
    for (size_t i = 0; i < m; ++i) {
      const int64_t anchor = owner.data()[i];
      if (anchor < before || anchor >= (int64_t)of_each.shape(0))
        throw std::invalid_argument("owner[" + std::to_string(i) + "] is " + std::to_string(anchor) +
                                    ", expected anchors in ascending order, below " +
                                    std::to_string(of_each.shape(0)));
      before = anchor;
    }
  }
};

// The weights of a head, padded; or the sums of the gradients by them, in the same places.
class HeadMemory {
 public:
  HeadMemory(int first, int second, int64_t copies)
      : first_(first), second_(second), one_(lanes_of(first)), two_(lanes_of(second)) {
    size_ = (size_t)3 * one_ + (size_t)(first + 1) * two_ + (size_t)(second + 1) * LANES;
    memory_.resize(size_ * copies);
    std::fill(memory_.data(), memory_.data() + memory_.size(), 0.0f);
  }
  HeadSums at(int64_t copy) {
    HeadSums s;
    s.of_colour = memory_.data() + size_ * copy;
    s.second = s.of_colour + 3 * one_;
    s.second_bias = s.second + first_ * two_;
    s.third = s.second_bias + two_;
    s.third_bias = s.third + second_ * LANES;
    return s;
  }
  void add(int64_t copy) {
    for (size_t i = 0; i < size_; ++i) memory_[i] += memory_[size_ * copy + i];
  }

 private:
  ptrdiff_t first_, second_, one_, two_;
  size_t size_;
  Buffer<float> memory_;
};

void place(const float* in, int rows, int columns, float* out, int stride, bool turned) {
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < columns; ++c) out[turned ? (size_t)c * stride + r : (size_t)r * stride + c] = in[r * columns + c];
}

struct Weights {
  HeadMemory memory;
  Buffer<float> turned;
  PackedHead head;

  explicit Weights(const HeadTensors& t)
      : memory((int)t.second.shape(0), (int)t.second.shape(1), 1) {
    const int first = (int)t.second.shape(0), second = (int)t.second.shape(1), one = lanes_of(first),
              two = lanes_of(second);
    const HeadSums p = memory.at(0);
    const size_t size = (size_t)first * LANES + (size_t)second * one + (size_t)HEAD_OUTPUTS * two;
    turned.resize(size);
    std::fill(turned.data(), turned.data() + size, 0.0f);
    float *of_colour = turned.data(), *of_second = of_colour + (size_t)first * LANES,
          *of_third = of_second + (size_t)second * one;
    place(t.of_colour.data(), 3, first, p.of_colour, one, false);
    place(t.of_colour.data(), 3, first, of_colour, LANES, true);
    place(t.second.data(), first, second, p.second, two, false);
    place(t.second.data(), first, second, of_second, one, true);
    place(t.second_bias.data(), 1, second, p.second_bias, 0, false);
    place(t.third.data(), second, HEAD_OUTPUTS, p.third, LANES, false);
    place(t.third.data(), second, HEAD_OUTPUTS, of_third, two, true);
    place(t.third_bias.data(), 1, HEAD_OUTPUTS, p.third_bias, 0, false);
    head = {one, two, p.of_colour, of_colour, p.second, p.second_bias, of_second, p.third, p.third_bias, of_third};
  }
};

void adapt(const HeadTensors& tensors, Out<float, 2> adapted) {
  const HeadArrays arrays = tensors.arrays();
  check(adapted.shape(0) == (size_t)arrays.count && adapted.shape(1) == 3, "adapted");
  float* out = adapted.data();
  nb::gil_scoped_release release;
  const Weights weights(tensors);
  const int64_t each = head_scratch(weights.head);
  constexpr int64_t PIECE = 16 * HEAD_ROWS;
  Buffer<float> scratch((size_t)(each * threads()));
  parallel(threads(), (int)((arrays.count + PIECE - 1) / PIECE), [&](int piece, int worker) {
    for (int64_t i = piece * PIECE; i < std::min(arrays.count, (piece + 1) * PIECE); i += HEAD_ROWS)
      head_in_use().forward(arrays, weights.head, scratch.data() + each * worker, i,
                             std::min(arrays.count, i + HEAD_ROWS), out);
  });
}

void adapt_backward(const HeadTensors& tensors, Matrix of, Out<float, 2> by_colours, Out<float, 2> by_each,
              Out<float, 2> by_of_colour, Out<float, 2> by_second, Out<float, 1> by_second_bias,
              Out<float, 2> by_third, Out<float, 1> by_third_bias) {
  const HeadArrays arrays = tensors.arrays();
  const int64_t m = arrays.count;
  const int first = arrays.first, second = arrays.second;
  check(of.size() == (size_t)m * 3 && by_colours.size() == (size_t)m * 3, "gradient by colours");
  check(by_each.size() == tensors.of_each.size(), "gradient by of_each");
  check(by_of_colour.size() == tensors.of_colour.size() && by_second.size() == tensors.second.size() &&
            by_second_bias.size() == (size_t)second && by_third.size() == tensors.third.size() &&
            by_third_bias.size() == (size_t)HEAD_OUTPUTS,
        "gradient by the head");
  nb::gil_scoped_release release;
  const Weights weights(tensors);
  const int64_t each = head_scratch(weights.head), parts = std::clamp<int64_t>(m / 512, 1, MOST_PARTS);
  Buffer<float> scratch((size_t)(each * threads()));
  HeadMemory sums(first, second, parts);
  std::fill(by_each.data(), by_each.data() + by_each.size(), 0.0f);
  // no anchor's Gaussians are in two parts, so no two threads add to one anchor
  const auto begin = [&](int64_t part) {
    int64_t i = m * part / parts;
    while (i > 0 && i < m && arrays.owner[i] == arrays.owner[i - 1]) ++i;
    return i;
  };
  parallel(threads(), (int)parts, [&](int part, int worker) {
    const int64_t last = begin(part + 1);
    for (int64_t i = begin(part); i < last; i += HEAD_ROWS)
      head_in_use().backward(arrays, weights.head, of.data(), scratch.data() + each * worker, i,
                              std::min(last, i + HEAD_ROWS), by_colours.data(), by_each.data(), sums.at(part));
  });
  for (int64_t part = 1; part < parts; ++part) sums.add(part);
  const HeadSums total = sums.at(0);
  const auto leave = [](const float* from, int stride, int rows, int columns, float* to) {
    for (int r = 0; r < rows; ++r) std::copy(from + (size_t)r * stride, from + (size_t)r * stride + columns, to + (size_t)r * columns);
  };
  leave(total.of_colour, lanes_of(first), 3, first, by_of_colour.data());
  leave(total.second, lanes_of(second), first, second, by_second.data());
  leave(total.second_bias, 0, 1, second, by_second_bias.data());
  leave(total.third, LANES, second, HEAD_OUTPUTS, by_third.data());
  leave(total.third_bias, 0, 1, HEAD_OUTPUTS, by_third_bias.data());
}

}  // namespace

void bind_colour_head(nb::module_& m) {
  nb::class_<HeadTensors>(m, "ColourHead", "Colours of Gaussians and the network that adapts them.")
      .def("__init__",
           [](HeadTensors* self, Matrix colours, Matrix of_each, In<int64_t, 1> owner, Matrix of_colour, Matrix second,
              Row second_bias, Matrix third, Row third_bias) {
             new (self) HeadTensors{colours, of_each, owner, of_colour, second, second_bias, third, third_bias};
             self->check_all();
           },
           array("colours"), array("of_each"), array("owner"), array("of_colour"), array("second"),
           array("second_bias"), array("third"), array("third_bias"));
  m.def("adapt_colours", &adapt, nb::arg("head"), array("adapted"), "Adapted colours into the given array.");
  m.def("adapt_colours_backward", &adapt_backward, nb::arg("head"), array("of"), array("by_colours"), array("by_each"),
        array("by_of_colour"), array("by_second"), array("by_second_bias"), array("by_third"), array("by_third_bias"),
        "Gradients by everything from the gradient by the adapted colours.");
}

}  // namespace splat
