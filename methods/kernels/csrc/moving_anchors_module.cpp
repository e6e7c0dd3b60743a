// Decoding of a hierarchy of anchors, for Python.
#include <nanobind/stl/vector.h>

#include <string>
#include <vector>

#include "arrays.hpp"
#include "moving_anchors.hpp"
#include "pool.hpp"

namespace splat {
namespace {

using Flat = nb::ndarray<nb::pytorch, float, nb::c_contig, nb::device::cpu>;
constexpr int TENSORS = 4;  // of a network

// Anchors and the networks that decode them; held while kernels read them.
struct MovingArrays {
  In<float, 2> features, instances, centres, velocities, log_scales;
  In<float, 1> peaks, log_spans;
  std::vector<In<float, 3>> offsets;
  Maybe<In<int64_t, 1>> index;
  In<float, 1> camera;
  bool own_features;
  int k, gaussians;
  float period, time, unit;
  In<float, 1> middle;
  std::vector<Flat> networks;  // each: weight, bias, weight, bias

  HierarchyArrays anchors() const {
    const int64_t stored = (int64_t)centres.shape(0);
    HierarchyArrays a = {features.data(), instances.data(), centres.data(), velocities.data(), log_scales.data(),
                         peaks.data(), log_spans.data(), {}, data(index), stored,
                         index ? (int64_t)index->shape(0) : stored, own_features, (int)offsets.size(), k, gaussians,
                         (int)features.shape(1), (int)instances.shape(1), period, time,
                         {camera.data()[0], camera.data()[1], camera.data()[2]}, unit,
                         {middle.data()[0], middle.data()[1], middle.data()[2]}};
    for (size_t i = 0; i < offsets.size(); ++i) a.offsets[i] = offsets[i].data();
    return a;
  }

  std::vector<SmallNetwork> stored() const {
    std::vector<SmallNetwork> found;
    for (size_t i = 0; i < networks.size(); i += TENSORS) {
      const Flat* t = &networks[i];
      found.push_back({t[0].data(), t[1].data(), t[2].data(), t[3].data(), (int)t[0].shape(0), (int)t[0].shape(1),
                       (int)t[2].shape(1)});
    }
    return found;
  }

  // Throws std::invalid_argument where they do not fit together.
  void check_all() const {
    check_anchors();
    const size_t residuals = (offsets.size() - 1) * RESIDUALS;
    check(networks.size() == (residuals + 1 + HEADS) * TENSORS, "the list of networks");
    const size_t f = features.shape(1), each = (size_t)gaussians / leaves(), children = (size_t)k;
    const size_t outputs[] = {3 * children, 3 * children, f * children}, heads[] = {3 * each, each, 7 * each};
    for (size_t i = 0; i < networks.size() / TENSORS; ++i) {
      const bool head = i > residuals;
      const size_t inputs = head ? f + VIEW : instances.shape(1) + CODE + TIME_CODE;
      check_network(i, inputs, head ? heads[i - residuals - 1] : i == residuals ? 3 * each : outputs[i % RESIDUALS]);
    }
    int64_t before = -1;
    for (size_t i = 0; index && i < index->shape(0); ++i) {
      const int64_t row = index->data()[i];
      if (row <= before || row >= (int64_t)centres.shape(0))
        throw std::invalid_argument("index[" + std::to_string(i) + "] is " + std::to_string(row) +
                                    ", expected rows in ascending order, below " + std::to_string(centres.shape(0)));
      before = row;
    }
  }

  size_t leaves() const {
    size_t count = 1;
    for (size_t i = 1; i < offsets.size(); ++i) count *= (size_t)k;
    return count;
  }

 private:
  void check_anchors() const {
    const size_t n = centres.shape(0);
    check(!offsets.empty() && offsets.size() <= (size_t)MOST_LEVELS, "the list of offsets");
    check(k > 0 && k <= 64 && gaussians > 0 && (size_t)gaussians % leaves() == 0, "the number of Gaussians");
    check(features.shape(0) == (own_features && index ? index->shape(0) : n), "features");
    check(instances.shape(0) == n, "instances");
    const std::pair<const In<float, 2>*, const char*> triples[] = {
        {&centres, "centres"}, {&velocities, "velocities"}, {&log_scales, "log_scales"}};
    for (const auto& [triple, name] : triples) check(triple->shape(0) == n && triple->shape(1) == 3, name);
    check(peaks.shape(0) == n, "peaks");
    check(log_spans.shape(0) == n, "log_spans");
    size_t rows = 1;
    for (size_t i = 0; i < offsets.size(); ++i) {
      rows *= (size_t)k;
      const size_t wanted = i + 1 < offsets.size() ? rows : (size_t)gaussians;
      check(offsets[i].shape(0) == n && offsets[i].shape(1) == wanted && offsets[i].shape(2) == 3, "offsets");
    }
    check(camera.shape(0) == 3, "camera_centre");
    check(middle.shape(0) == 3, "middle");
    if (!(period > 0)) throw std::invalid_argument("period must be positive: " + std::to_string(period));
  }

  void check_network(size_t i, size_t inputs, size_t outputs) const {
    const Flat* t = &networks[i * TENSORS];
    check(t[0].ndim() == 2 && t[1].ndim() == 1 && t[2].ndim() == 2 && t[3].ndim() == 1, "a network");
    const size_t hidden = t[0].shape(1);
    check(t[0].shape(0) == inputs && t[1].shape(0) == hidden, "a network's first layer");
    check(t[2].shape(0) == hidden && t[2].shape(1) == outputs && t[3].shape(0) == outputs, "a network's second layer");
  }
};

void visible(const MovingArrays& arrays, In<float, 2> pose, In<float, 2> sides, float near, float sigmas, float blur,
             Maybe<In<float, 2>> drift, Out<bool, 1> out) {
  const HierarchyArrays a = arrays.anchors();
  Pyramid pyramid = {};
  check(pose.shape(0) == 3 && pose.shape(1) == 4, "pose");
  check(sides.shape(0) == 4 && sides.shape(1) == 3, "sides");
  check_rows(drift, a.count, 3, "drift");
  check(out.shape(0) == (size_t)a.count, "out");
  for (int row = 0; row < 3; ++row) {
    for (int c = 0; c < 3; ++c) pyramid.rotation[3 * row + c] = pose.data()[4 * row + c];
    pyramid.shift[row] = pose.data()[4 * row + 3];
  }
  for (int side = 0; side < 4; ++side)
    for (int c = 0; c < 3; ++c) pyramid.sides[side][c] = sides.data()[3 * side + c];
  pyramid.near = near;
  pyramid.sigmas = sigmas;
  pyramid.blur = blur;
  const std::vector<SmallNetwork> networks = arrays.stored();
  nb::gil_scoped_release release;
  hierarchy_visible(a, networks, pyramid, data(drift), reinterpret_cast<uint8_t*>(out.data()), threads());
}

void decode(const MovingArrays& arrays, Out<float, 2> means, Out<float, 2> quaternions, Out<float, 2> scales,
            Out<float, 1> opacities, Out<float, 2> colours, Out<int64_t, 1> rows, Out<int64_t, 1> slots) {
  const HierarchyArrays a = arrays.anchors();
  const size_t n = (size_t)(a.count * a.gaussians);
  check(means.shape(0) == n && means.shape(1) == 3, "means");
  check(quaternions.shape(0) == n && quaternions.shape(1) == 4, "quaternions");
  check(scales.shape(0) == n && scales.shape(1) == 3, "scales");
  check(opacities.shape(0) == n, "opacities");
  check(colours.shape(0) == n && colours.shape(1) == 3, "colours");
  check(rows.shape(0) == n && slots.shape(0) == n, "rows");
  const HierarchyOutputs out = {means.data(),   quaternions.data(), scales.data(), opacities.data(),
                                colours.data(), rows.data(),        slots.data()};
  const std::vector<SmallNetwork> networks = arrays.stored();
  nb::gil_scoped_release release;
  hierarchy_decode(a, networks, out, threads());
}

void backward(const MovingArrays& arrays, Maybe<In<float, 2>> of_means, Maybe<In<float, 2>> of_quaternions,
              Maybe<In<float, 2>> of_scales, Maybe<In<float, 1>> of_opacities, Maybe<In<float, 2>> of_colours,
              const std::vector<Maybe<Flat>>& by_anchors, const std::vector<Flat>& by_networks) {
  const HierarchyArrays a = arrays.anchors();
  const int64_t n = a.count * a.gaussians;
  check_rows(of_means, n, 3, "gradient by means");
  check_rows(of_quaternions, n, 4, "gradient by quaternions");
  check_rows(of_scales, n, 3, "gradient by scales");
  check_rows(of_opacities, n, 1, "gradient by opacities");
  check_rows(of_colours, n, 3, "gradient by colours");
  constexpr size_t FLAT = 7;  // tensors of the anchors before the offsets
  check(by_anchors.size() == FLAT + arrays.offsets.size(), "the list of gradients by the anchors");
  std::vector<size_t> sizes = {arrays.features.size(), arrays.instances.size(), arrays.centres.size(), arrays.velocities.size(),
                               arrays.log_scales.size(), arrays.peaks.size(), arrays.log_spans.size()};
  for (const auto& offsets : arrays.offsets) sizes.push_back(offsets.size());
  for (size_t i = 0; i < sizes.size(); ++i) check(!by_anchors[i] || by_anchors[i]->size() == sizes[i], "gradient by the anchors");
  HierarchyGradients g = {data(of_means), data(of_quaternions), data(of_scales), data(of_opacities), data(of_colours),
                          data(by_anchors[0]), data(by_anchors[1]), data(by_anchors[2]), data(by_anchors[3]),
                          data(by_anchors[4]), data(by_anchors[5]), data(by_anchors[6]), {}};
  for (size_t i = 0; i < arrays.offsets.size(); ++i) g.offsets[i] = data(by_anchors[FLAT + i]);
  std::vector<SmallNetworkGradients> gradients;
  check(by_networks.empty() || by_networks.size() == arrays.networks.size(), "the list of gradients by the networks");
  for (size_t i = 0; i < by_networks.size(); ++i) check(by_networks[i].size() == arrays.networks[i].size(), "gradient by a network");
  for (size_t i = 0; i < by_networks.size(); i += TENSORS)
    gradients.push_back({by_networks[i].data(), by_networks[i + 1].data(), by_networks[i + 2].data(), by_networks[i + 3].data()});
  const std::vector<SmallNetwork> networks = arrays.stored();
  nb::gil_scoped_release release;
  hierarchy_backward(a, networks, g, gradients, threads());
}

}  // namespace

void bind_moving_anchors(nb::module_& m) {
  nb::class_<MovingArrays>(m, "MovingAnchors", "Arrays of a hierarchy of anchors and of the networks that decode it.")
      .def("__init__",
           [](MovingArrays* self, In<float, 2> features, In<float, 2> instances, In<float, 2> centres,
              In<float, 2> velocities, In<float, 2> log_scales, In<float, 1> peaks, In<float, 1> log_spans,
              const std::vector<In<float, 3>>& offsets, Maybe<In<int64_t, 1>> index, In<float, 1> camera_centre,
              bool own_features, int children, int gaussians, float period, float time, float unit, In<float, 1> middle,
              const std::vector<Flat>& networks) {
             new (self) MovingArrays{features, instances, centres, velocities, log_scales, peaks, log_spans, offsets,
                                     index, camera_centre, own_features, children, gaussians, period, time, unit, middle,
                                     networks};
             self->check_all();
           },
           array("features"), array("instances"), array("centres"), array("velocities"), array("log_scales"),
           array("peaks"), array("log_spans"), array("offsets"), array("index").none(), array("camera_centre"),
           nb::arg("own_features"), nb::arg("children"), nb::arg("gaussians"), nb::arg("period"), nb::arg("time"),
           nb::arg("unit"), array("middle"),
           array("networks"));
  m.def("visible_anchors", &visible, nb::arg("anchors"), array("pose"), array("sides"), nb::arg("near"),
        nb::arg("sigmas"), nb::arg("blur"), array("drift").none(), array("out"),
        "Whether a view's pyramid may show a Gaussian of each anchor.");
  m.def("decode_moving_anchors", &decode, nb::arg("anchors"), array("means"), array("quaternions"), array("scales"),
        array("opacities"), array("colours"), array("rows"), array("slots"),
        "Decode the Gaussians into the given arrays.");
  m.def("moving_anchors_backward", &backward, nb::arg("anchors"), array("of_means").none(),
        array("of_quaternions").none(), array("of_scales").none(), array("of_opacities").none(),
        array("of_colours").none(), array("by_anchors"), array("by_networks"),
        "Gradients by anchors and networks from gradients by what was decoded.");
}

}  // namespace splat
