// Decoding of anchors, for Python.
#include <nanobind/stl/vector.h>

#include <cmath>
#include <string>
#include <vector>

#include "anchors.hpp"
#include "arrays.hpp"
#include "pool.hpp"

namespace splat {
namespace {

using Flat = nb::ndarray<nb::pytorch, float, nb::c_contig, nb::device::cpu>;
constexpr int TENSORS = 4;  // of a network

// Anchors and the networks that decode them; held while kernels read them.
struct DecoderArrays {
  In<float, 2> centres;
  In<float, 3> offsets;
  In<float, 2> features, log_scales;
  Maybe<In<int64_t, 1>> index;
  In<float, 1> camera;
  bool with_distance, own_features;
  std::vector<Flat> networks;  // opacity, shape, colour: weight, bias, weight, bias

  AnchorArrays anchors() const {
    const int64_t stored = (int64_t)centres.shape(0);
    return {centres.data(), offsets.data(), features.data(), log_scales.data(), data(index), stored,
            index ? (int64_t)index->shape(0) : stored, (int)offsets.shape(1), (int)features.shape(1),
            {camera.data()[0], camera.data()[1], camera.data()[2]}, with_distance, own_features};
  }

  StoredNetwork network(int i) const {
    const Flat* t = &networks[(size_t)i * TENSORS];
    return {t[0].data(), t[1].data(), t[2].data(), t[3].data(), (int)t[0].shape(1), (int)t[2].shape(1)};
  }

  // Throws std::invalid_argument where they do not fit together.
  void check_all() const {
    const size_t n = centres.shape(0), k = offsets.shape(1);
    check(centres.shape(1) == 3, "centres");
    check(offsets.shape(0) == n && offsets.shape(2) == 3, "offsets");
    check(features.shape(0) == (own_features && index ? index->shape(0) : n), "features");
    check(log_scales.shape(0) == n && log_scales.shape(1) == 6, "log_scales");
    check(camera.shape(0) == 3, "camera_centre");
    check(networks.size() == NETWORKS * TENSORS, "the list of networks");
    const size_t inputs = features.shape(1) + (with_distance ? 4 : 3), outputs[NETWORKS] = {k, SHAPE * k, 3 * k};
    for (int i = 0; i < NETWORKS; ++i) {
      const Flat* t = &networks[(size_t)i * TENSORS];
      check(t[0].ndim() == 2 && t[1].ndim() == 1 && t[2].ndim() == 2 && t[3].ndim() == 1, "a network");
      const size_t hidden = t[0].shape(1);
      check(t[0].shape(0) == inputs && t[1].shape(0) == hidden, "a network's first layer");
      check(t[2].shape(0) == hidden && t[2].shape(1) == outputs[i] && t[3].shape(0) == outputs[i],
            "a network's second layer");
    }
    int64_t before = -1;
    for (size_t i = 0; index && i < index->shape(0); ++i) {
      const int64_t row = index->data()[i];
      if (row <= before || row >= (int64_t)n)
        throw std::invalid_argument("index[" + std::to_string(i) + "] is " + std::to_string(row) +
                                    ", expected rows in ascending order, below " + std::to_string(n));
      before = row;
    }
  }
};

Decoded* open(const DecoderArrays& arrays) {
  const AnchorArrays anchors = arrays.anchors();
  StoredNetwork networks[NETWORKS];
  for (int i = 0; i < NETWORKS; ++i) networks[i] = arrays.network(i);
  nb::gil_scoped_release release;
  return new Decoded(anchors, networks, threads());
}

void fill(Decoded& state, const DecoderArrays& arrays, Out<float, 2> means, Out<float, 2> quaternions,
          Out<float, 2> scales, Out<float, 1> opacities, Out<float, 2> colours, Out<int64_t, 1> rows,
          Out<int64_t, 1> slots) {
  const AnchorArrays anchors = arrays.anchors();
  const size_t n = (size_t)state.count();
  check(anchors.count == state.anchors(), "the anchors");
  check(means.shape(0) == n && means.shape(1) == 3, "means");
  check(quaternions.shape(0) == n && quaternions.shape(1) == 4, "quaternions");
  check(scales.shape(0) == n && scales.shape(1) == 3, "scales");
  check(opacities.shape(0) == n, "opacities");
  check(colours.shape(0) == n && colours.shape(1) == 3, "colours");
  check(rows.shape(0) == n && slots.shape(0) == n, "rows");
  const DecodeOutputs out = {means.data(),   quaternions.data(), scales.data(), opacities.data(),
                             colours.data(), rows.data(),        slots.data()};
  nb::gil_scoped_release release;
  state.fill(anchors, out, threads());
}

void backward(const Decoded& state, const DecoderArrays& arrays, In<float, 2> quaternions, In<float, 2> scales,
              In<float, 2> colours, Maybe<In<float, 2>> of_means, Maybe<In<float, 2>> of_quaternions,
              Maybe<In<float, 2>> of_scales, Maybe<In<float, 1>> of_opacities, Maybe<In<float, 2>> of_colours,
              Maybe<Out<float, 2>> by_centres, Maybe<Out<float, 3>> by_offsets, Maybe<Out<float, 2>> by_features,
              Maybe<Out<float, 2>> by_log_scales, const std::vector<Flat>& by_networks) {
  const AnchorArrays anchors = arrays.anchors();
  const int64_t n = state.count(), stored = anchors.stored;
  check(anchors.count == state.anchors(), "the anchors");
  check(quaternions.size() == (size_t)n * 4 && scales.size() == (size_t)n * 3 && colours.size() == (size_t)n * 3,
        "what was decoded");
  check_rows(of_means, n, 3, "gradient by means");
  check_rows(of_quaternions, n, 4, "gradient by quaternions");
  check_rows(of_scales, n, 3, "gradient by scales");
  check_rows(of_opacities, n, 1, "gradient by opacities");
  check_rows(of_colours, n, 3, "gradient by colours");
  check_rows(by_centres, stored, 3, "centres gradient");
  check_rows(by_offsets, stored, (size_t)anchors.k * 3, "offsets gradient");
  check_rows(by_features, (int64_t)arrays.features.shape(0), anchors.f, "features gradient");
  check_rows(by_log_scales, stored, 6, "log_scales gradient");
  NetworkGradients networks[NETWORKS];
  if (!by_networks.empty()) {
    check(by_networks.size() == arrays.networks.size(), "the list of gradients by the networks");
    for (size_t i = 0; i < by_networks.size(); ++i)
      check(by_networks[i].size() == arrays.networks[i].size(), "gradient by a network");
    for (int i = 0; i < NETWORKS; ++i) {
      const Flat* t = &by_networks[(size_t)i * TENSORS];
      networks[i] = {t[0].data(), t[1].data(), t[2].data(), t[3].data()};
    }
  }
  const DecodeGradients g = {data(of_means),      data(of_quaternions), data(of_scales),    data(of_opacities),
                             data(of_colours),    quaternions.data(),   scales.data(),      colours.data(),
                             data(by_centres),    data(by_offsets),     data(by_features),  data(by_log_scales),
                             !by_networks.empty()};
  const NetworkGradients* wanted = by_networks.empty() ? nullptr : networks;
  nb::gil_scoped_release release;
  state.backward(anchors, g, wanted, threads());
}

}  // namespace

void bind_anchors(nb::module_& m) {
  nb::class_<DecoderArrays>(m, "Anchors", "Arrays of anchors and of the networks that decode them.")
      .def("__init__",
           [](DecoderArrays* self, In<float, 2> centres, In<float, 3> offsets, In<float, 2> features,
              In<float, 2> log_scales, Maybe<In<int64_t, 1>> index, In<float, 1> camera_centre, bool with_distance,
              bool own_features, const std::vector<Flat>& networks) {
             new (self) DecoderArrays{centres, offsets, features, log_scales, index, camera_centre, with_distance,
                                      own_features, networks};
             self->check_all();
           },
           array("centres"), array("offsets"), array("features"), array("log_scales"), array("index").none(),
           array("camera_centre"), nb::arg("with_distance"), nb::arg("own_features"),
           array("networks"));
  nb::class_<Decoded>(m, "Decoded", "What a backward pass needs of the decoding of anchors.")
      .def_prop_ro("count", &Decoded::count, "Gaussians.")
      .def_prop_ro("bytes", &Decoded::bytes, "Memory held.");
  m.def("open_anchors", &open, nb::arg("anchors"), "Evaluate what decides how many Gaussians there are.");
  m.def("fill_anchors", &fill, nb::arg("state"), nb::arg("anchors"), array("means"), array("quaternions"),
        array("scales"), array("opacities"), array("colours"), array("rows"), array("slots"),
        "Decode the Gaussians into the given arrays.");
  m.def("decode_backward", &backward, nb::arg("state"), nb::arg("anchors"), array("quaternions"), array("scales"),
        array("colours"), array("of_means").none(), array("of_quaternions").none(), array("of_scales").none(),
        array("of_opacities").none(), array("of_colours").none(), array("by_centres").none(),
        array("by_offsets").none(), array("by_features").none(), array("by_log_scales").none(),
        array("by_networks"), "Gradients by anchors and networks from gradients by what was decoded.");
}

}  // namespace splat
