// Attention by lists over all threads, for Python.
#include "attention.hpp"

#include <algorithm>
#include <string>

#include "arrays.hpp"
#include "buffer.hpp"
#include "decode.hpp"
#include "levels.hpp"
#include "pool.hpp"
#include "render.hpp"

SPLAT_TABLES(splat::AttentionKernels, attention)

namespace splat {
namespace {

constexpr int PIECE = 32;  // rows that a thread takes at once

using Matrix = In<float, 2>;

// Lists of all stored anchors, checked once for the many steps that read them.
struct NearLists {
  In<int64_t, 1> targets;
  Buffer<int64_t> starts;
  int64_t longest = 0;

  NearLists(const In<int64_t, 1>& first, const In<int64_t, 1>& given) : targets(given) {
    const int64_t stored = (int64_t)first.shape(0), pairs = (int64_t)given.shape(0);
    starts.resize((size_t)stored + 1);
    std::copy(first.data(), first.data() + stored, starts.data());
    starts[stored] = pairs;
    for (int64_t i = 0; i < stored; ++i) {
      if (starts[i] < (i ? starts[i - 1] : 0) || starts[i] > pairs)
        throw std::invalid_argument("starts[" + std::to_string(i) + "] is " + std::to_string(starts[i]) +
                                    ", expected to ascend from 0 to " + std::to_string(pairs));
      longest = std::max(longest, starts[i + 1] - starts[i]);
    }
    if (stored ? starts[0] != 0 : pairs != 0) throw std::invalid_argument("starts must begin with 0");
    for (int64_t p = 0; p < pairs; ++p)
      if (targets.data()[p] < 0 || targets.data()[p] >= stored)
        throw std::invalid_argument("targets[" + std::to_string(p) + "] is " + std::to_string(targets.data()[p]) +
                                    ", expected 0 to " + std::to_string(stored - 1));
  }
  int64_t stored() const { return (int64_t)starts.size() - 1; }
};

// Rows of a matrix, padded with zeros.
void pad(const float* rows, int64_t count, int columns, int width, Buffer<float>& out) {
  out.resize((size_t)count * width);
  for (int64_t r = 0; r < count; ++r) {
    float* to = out.data() + r * width;
    std::copy(rows + r * columns, rows + (r + 1) * columns, to);
    std::fill(to + columns, to + width, 0.0f);
  }
}

void unpad(const Buffer<float>& rows, int64_t count, int columns, int width, float* out) {
  for (int64_t r = 0; r < count; ++r) std::copy(rows.data() + r * width, rows.data() + r * width + columns, out + r * columns);
}

// One forward pass, and what its backward pass needs.
class Attended {
 public:
  Attended(const NearLists& lists, Matrix query, Matrix key, Matrix value, In<int64_t, 1> rows,
           Maybe<Matrix> centres, double radius)
      : lists_(&lists), rows_(rows), centres_(centres) {
    const int64_t n = (int64_t)query.shape(0), stored = lists_->stored();
    columns_ = (int)query.shape(1);
    value_columns_ = (int)value.shape(1);
    check(key.shape(0) == (size_t)n && key.shape(1) == (size_t)columns_ && columns_ > 0, "key");
    check(value.shape(0) == (size_t)n && value_columns_ > 0, "value");
    check(rows.shape(0) == (size_t)n && !(n >> 31), "rows");
    check(!centres || (centres->shape(0) == (size_t)stored && centres->shape(1) == 3), "centres");
    place_.resize((size_t)stored);
    std::fill(place_.data(), place_.data() + stored, -1);
    int64_t before = -1;
    for (int64_t r = 0; r < n; ++r) {
      const int64_t anchor = rows.data()[r];
      if (anchor <= before || anchor >= stored)
        throw std::invalid_argument("rows[" + std::to_string(r) + "] is " + std::to_string(anchor) +
                                    ", expected anchors in ascending order, below " + std::to_string(stored));
      place_[anchor] = (int32_t)r;
      before = anchor;
    }
    const int width = lanes_of(columns_), value_width = lanes_of(value_columns_);
    pad(query.data(), n, columns_, width, query_);
    pad(key.data(), n, columns_, width, key_);
    pad(value.data(), n, value_columns_, value_width, value_);
    highest_.resize((size_t)n);
    inverse_.resize((size_t)n);
    arrays_ = {query_.data(), key_.data(), value_.data(), n, width, value_width, rows_.data(), lists_->starts.data(),
               lists_->targets.data(), place_.data(), data(centres_), (float)radius};
    sums_ = {highest_.data(), inverse_.data()};
  }

  void forward(const Out<float, 2>& mixed) {
    check(mixed.shape(0) == (size_t)arrays_.count && mixed.shape(1) == (size_t)value_columns_, "mixed");
    nb::gil_scoped_release release;
    const int64_t n = arrays_.count;
    mixed_.resize((size_t)n * arrays_.value_width);
    over_rows([&](float* scratch, int64_t first, int64_t last) {
      attention_in_use().forward(arrays_, scratch, lists_->longest, first, last, mixed_.data(), sums_);
    });
    unpad(mixed_, n, value_columns_, arrays_.value_width, mixed.data());
  }

  void backward(const Matrix& of, const Out<float, 2>& by_query, const Out<float, 2>& by_key,
                const Out<float, 2>& by_value) const {
    const auto fits = [&](const auto& a, int columns, const char* what) {
      check(a.shape(0) == (size_t)arrays_.count && a.shape(1) == (size_t)columns, what);
    };
    fits(of, value_columns_, "gradient by what was mixed");
    fits(by_query, columns_, "gradient by query");
    fits(by_key, columns_, "gradient by key");
    fits(by_value, value_columns_, "gradient by value");
    check(mixed_.size() == (size_t)(arrays_.count * arrays_.value_width), "what was mixed");
    nb::gil_scoped_release release;
    const int64_t n = arrays_.count;
    const int width = arrays_.width, value_width = arrays_.value_width;
    Buffer<float> given, mean((size_t)n), query((size_t)n * width), key((size_t)n * width), value((size_t)n * value_width);
    pad(of.data(), n, value_columns_, value_width, given);
    attention_in_use().means(arrays_, given.data(), mixed_.data(), 0, n, mean.data());
    const AttentionGradients gradients = {given.data(), mean.data(), query.data(), key.data(), value.data()};
    over_rows([&](float* scratch, int64_t first, int64_t last) {
      attention_in_use().backward(arrays_, scratch, lists_->longest, first, last, sums_, gradients);
    });
    unpad(query, n, columns_, width, by_query.data());
    unpad(key, n, columns_, width, by_key.data());
    unpad(value, n, value_columns_, value_width, by_value.data());
  }

 private:
  template <class Task>
  void over_rows(Task task) const {
    const int64_t each = attention_scratch(lists_->longest), n = arrays_.count;
    Buffer<float> scratch((size_t)(each * threads()));
    parallel(threads(), (int)((n + PIECE - 1) / PIECE), [&](int piece, int worker) {
      const int64_t first = (int64_t)piece * PIECE;
      task(scratch.data() + each * worker, first, std::min(n, first + PIECE));
    });
  }

  const NearLists* lists_;
  In<int64_t, 1> rows_;
  Maybe<Matrix> centres_;
  int columns_, value_columns_;
  Buffer<int32_t> place_;
  Buffer<float> query_, key_, value_, highest_, inverse_, mixed_;
  AttentionArrays arrays_;
  AttentionSums sums_;
};

}  // namespace

void bind_attention(nb::module_& m) {
  nb::class_<NearLists>(m, "NearLists", "Of each anchor those near it.")
      .def("__init__",
           [](NearLists* self, In<int64_t, 1> starts, In<int64_t, 1> targets) { new (self) NearLists(starts, targets); },
           array("starts"), array("targets"));
  nb::class_<Attended>(m, "Attended", "Query, key and value of some anchors, and what each mixed of those near it.")
      .def("__init__",
           [](Attended* self, const NearLists& lists, Matrix query, Matrix key, Matrix value, In<int64_t, 1> rows,
              Maybe<Matrix> centres, double radius) {
             new (self) Attended(lists, query, key, value, rows, centres, radius);
           },
           nb::arg("lists"), array("query"), array("key"), array("value"), array("rows"), array("centres").none(),
           nb::arg("radius"), nb::keep_alive<1, 2>());
  m.def("attend", [](Attended& state, Out<float, 2> mixed) { state.forward(mixed); }, nb::arg("state"), array("mixed"),
        "What each anchor mixes into the given array.");
  m.def("attend_backward",
        [](const Attended& state, Matrix of, Out<float, 2> by_query, Out<float, 2> by_key, Out<float, 2> by_value) {
          state.backward(of, by_query, by_key, by_value);
        },
        nb::arg("state"), array("of"), array("by_query"), array("by_key"), array("by_value"),
        "Gradients by query, key and value from the gradient by what was mixed.");
}

}  // namespace splat
