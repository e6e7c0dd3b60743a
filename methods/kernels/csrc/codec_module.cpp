// Coding of the codes of Gaussians, for Python.
#include <string>
#include <vector>

#include "arrays.hpp"
#include "codec.hpp"

namespace splat {
namespace {

constexpr int CLASSES = 7;
constexpr int MOST_SIZE = 1 << 20;  // of a signed code

// Tables of the logistic function; held while streams are coded.
struct Tables {
  In<int16_t, 1> stretch;
  In<uint16_t, 1> squash;
  Logistic view() const {
    check(stretch.shape(0) == 4096, "stretch");
    check(squash.shape(0) == 4096, "squash");
    return {stretch.data(), squash.data()};
  }
};

void check_within(const int32_t* values, size_t count, int64_t low, int64_t high, const char* what) {
  for (size_t i = 0; i < count; ++i)
    if (values[i] < low || values[i] > high)
      throw std::invalid_argument(std::string(what) + " has " + std::to_string(values[i]) + ", expected " +
                                  std::to_string(low) + " to " + std::to_string(high));
}

void check_nearest(const In<int32_t, 2>& nearest, size_t n) {
  check(nearest.shape(0) == n && nearest.shape(1) == NEAREST, "nearest");
  for (size_t i = 0; i < n; ++i) check_within(nearest.data() + NEAREST * i, NEAREST, -1, (int64_t)i - 1, "nearest");
}

template <class Codes>
Columns columns_of(const In<int32_t, 1>& bits, const In<int32_t, 2>& nearest, const In<int32_t, 1>& side,
                   const Codes& codes) {
  const size_t n = codes.shape(1);
  check(bits.shape(0) == codes.shape(0), "bits");
  check(side.shape(0) == n, "side");
  check_nearest(nearest, n);
  check_within(bits.data(), bits.size(), 0, MOST_CODE_BITS, "bits");
  check_within(side.data(), n, 0, MOST_SIZE, "side");
  return {(int64_t)n, (int)codes.shape(0), bits.data(), nearest.data(), side.data()};
}

template <class Codes>
Harmonics harmonics_of(const In<int32_t, 2>& nearest, const In<int32_t, 1>& classes, const Codes& codes) {
  const size_t n = codes.shape(1);
  check(codes.shape(0) % 3 == 0, "codes");
  check(classes.shape(0) == n, "classes");
  check_nearest(nearest, n);
  check_within(classes.data(), n, 0, CLASSES - 1, "classes");
  return {(int64_t)n, (int)codes.shape(0) / 3, nearest.data(), classes.data()};
}

template <class Work>
nb::bytes encoded(Work work) {
  std::vector<uint8_t> found;
  {
    nb::gil_scoped_release release;
    found = work();
  }
  return nb::bytes(found.data(), found.size());
}

// Decodes what `work` is given; a stream that no encoder wrote is a ValueError.
template <class Work>
void decoded(const nb::bytes& data, Work work) {
  const auto* bytes = (const uint8_t*)data.data();
  const auto size = (int64_t)data.size();
  nb::gil_scoped_release release;
  try {
    work(bytes, size);
  } catch (const BadStream& error) {
    throw std::invalid_argument(error.what());
  }
}

}  // namespace

void bind_codec(nb::module_& m) {
  nb::class_<Tables>(m, "CodecTables", "Tables of the logistic function.")
      .def("__init__",
           [](Tables* self, In<int16_t, 1> stretch, In<uint16_t, 1> squash) {
             new (self) Tables{stretch, squash};
             self->view();
           },
           array("stretch"), array("squash"));
  m.def("morton_of_cells", [](In<int32_t, 2> cells, Out<int64_t, 1> codes) {
    check(cells.shape(1) == 3 && codes.shape(0) == cells.shape(0), "cells");
    check_within(cells.data(), cells.size(), 0, (1 << 21) - 1, "cells");
    morton_codes(cells.data(), (int64_t)codes.shape(0), codes.data());
  }, array("cells"), array("codes"), "Places of cells on the Morton curve.");
  m.def("cells_of_morton", [](In<int64_t, 1> codes, Out<int32_t, 2> cells) {
    check(cells.shape(1) == 3 && codes.shape(0) == cells.shape(0), "cells");
    morton_cells(codes.data(), (int64_t)codes.shape(0), cells.data());
  }, array("codes"), array("cells"), "Cells of places on the Morton curve.");
  m.def("nearest_before", [](In<int32_t, 2> cells, int window, Out<int32_t, 2> nearest) {
    const size_t n = cells.shape(0);
    check(cells.shape(1) == 3 && nearest.shape(0) == n && nearest.shape(1) == NEAREST, "nearest");
    check_within(cells.data(), cells.size(), 0, (1 << 21) - 1, "cells");
    nb::gil_scoped_release release;
    nearest_before(cells.data(), (int64_t)n, window, nearest.data());
  }, array("cells"), nb::arg("window"), array("nearest"), "The three nearest of those just before each.");
  m.def("encode_gaps", [](const Tables& tables, In<int64_t, 1> codes) {
    int64_t before = 0;
    for (size_t i = 0; i < codes.size(); ++i) {
      if (codes.data()[i] < before) throw std::invalid_argument("codes decrease or are below 0");
      before = codes.data()[i];
    }
    return encoded([&] { return encode_gaps(tables.view(), codes.data(), (int64_t)codes.size()); });
  }, nb::arg("tables"), array("codes"), "A stream of codes that never decrease.");
  m.def("decode_gaps", [](const Tables& tables, nb::bytes data, Out<int64_t, 1> codes) {
    decoded(data, [&](const uint8_t* bytes, int64_t size) {
      decode_gaps(tables.view(), bytes, size, codes.data(), (int64_t)codes.size());
    });
  }, nb::arg("tables"), nb::arg("data"), array("codes"), "The codes of such a stream.");
  m.def("encode_columns", [](const Tables& tables, In<int32_t, 2> codes, In<int32_t, 1> bits, In<int32_t, 2> nearest,
                             In<int32_t, 1> side) {
    const Columns shape = columns_of(bits, nearest, side, codes);
    for (size_t c = 0; c < codes.shape(0); ++c)
      check_within(codes.data() + c * codes.shape(1), codes.shape(1), 0, ((int64_t)1 << bits.data()[c]) - 1, "codes");
    return encoded([&] { return encode_columns(tables.view(), shape, codes.data()); });
  }, nb::arg("tables"), array("codes"), array("bits"), array("nearest"), array("side"), "A stream of columns.");
  m.def("decode_columns", [](const Tables& tables, nb::bytes data, In<int32_t, 1> bits, In<int32_t, 2> nearest,
                             In<int32_t, 1> side, Out<int32_t, 2> codes) {
    const Columns shape = columns_of(bits, nearest, side, codes);
    decoded(data, [&](const uint8_t* bytes, int64_t size) {
      decode_columns(tables.view(), shape, bytes, size, codes.data());
    });
  }, nb::arg("tables"), nb::arg("data"), array("bits"), array("nearest"), array("side"), array("codes"),
     "The columns of such a stream.");
  m.def("encode_harmonics", [](const Tables& tables, In<int32_t, 2> codes, In<int32_t, 2> nearest,
                               In<int32_t, 1> classes) {
    const Harmonics shape = harmonics_of(nearest, classes, codes);
    check_within(codes.data(), codes.size(), -MOST_SIZE, MOST_SIZE, "codes");
    return encoded([&] { return encode_harmonics(tables.view(), shape, codes.data()); });
  }, nb::arg("tables"), array("codes"), array("nearest"), array("classes"), "A stream of codes of harmonics.");
  m.def("decode_harmonics", [](const Tables& tables, nb::bytes data, In<int32_t, 2> nearest, In<int32_t, 1> classes,
                               Out<int32_t, 2> codes) {
    const Harmonics shape = harmonics_of(nearest, classes, codes);
    decoded(data, [&](const uint8_t* bytes, int64_t size) {
      decode_harmonics(tables.view(), shape, bytes, size, codes.data());
    });
  }, nb::arg("tables"), nb::arg("data"), array("nearest"), array("classes"), array("codes"),
     "The codes of such a stream.");
  m.def("restore_harmonics", [](In<int32_t, 2> codes, In<int32_t, 1> classes, double base, In<double, 2> opponent,
                                Out<float, 3> sh) {
    const size_t n = codes.shape(1);
    check(codes.shape(0) % 3 == 0 && classes.shape(0) == n, "codes");
    check(opponent.shape(0) == 3 && opponent.shape(1) == 3, "opponent");
    check(sh.shape(0) == n && 3 * sh.shape(1) == codes.shape(0) && sh.shape(2) == 3, "sh");
    check_within(classes.data(), n, 0, CLASSES - 1, "classes");
    const Harmonics shape = {(int64_t)n, (int)sh.shape(1), nullptr, classes.data()};
    nb::gil_scoped_release release;
    restore_harmonics(shape, codes.data(), base, opponent.data(), sh.data());
  }, array("codes"), array("classes"), nb::arg("base"), array("opponent"), array("sh"), "SH coefficients of codes.");
}

}  // namespace splat
