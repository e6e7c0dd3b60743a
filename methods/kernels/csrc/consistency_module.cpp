// The consistency step between anchors, for Python.
#include <nanobind/stl/vector.h>

#include <string>
#include <vector>

#include "arrays.hpp"
#include "consistency.hpp"
#include "pool.hpp"

namespace splat {
namespace {

using Flat = nb::ndarray<nb::pytorch, float, nb::c_contig, nb::device::cpu>;
// Parameters: convolution; weight, bias, weight, bias of modulation and of gate; weight and bias of the residual.
constexpr size_t MODULATION = 1, GATE = 5, RESIDUAL = 9, PARAMETERS = 11;

SmallNetwork network_at(const std::vector<Flat>& t, size_t i) {
  return {t[i].data(), t[i + 1].data(), t[i + 2].data(), t[i + 3].data(), (int)t[i].shape(0), (int)t[i].shape(1),
          (int)t[i + 2].shape(1)};
}
SmallNetworkGradients gradients_at(const std::vector<Flat>& t, size_t i) {
  return {t[i].data(), t[i + 1].data(), t[i + 2].data(), t[i + 3].data()};
}

// Sites, their pairs and the step's parameters; held while kernels read them.
struct SiteArrays {
  In<float, 2> features, centres, quaternions, scales;
  In<int64_t, 1> sites, neighbours;
  std::vector<int64_t> ends;
  In<int64_t, 1> seen;
  std::vector<Flat> parameters;
  bool modulated, gated;
  std::vector<int64_t> receive = {}, give = {}, kept_ends = {};  // the pairs whose receiving site is seen

  SupportArrays arrays() const {
    SupportArrays a = {features.data(), centres.data(), quaternions.data(), scales.data(), receive.data(),
                       give.data(), seen.data(), (int64_t)features.shape(0), (int64_t)receive.size(),
                       (int64_t)seen.shape(0), {}, parameters[0].data(), network_at(parameters, MODULATION),
                       network_at(parameters, GATE), parameters[RESIDUAL].data(), parameters[RESIDUAL + 1].data(),
                       (int)features.shape(1), modulated, gated};
    for (int i = 0; i < CELLS; ++i) a.ends[i] = kept_ends[(size_t)i];
    return a;
  }

  // Chooses the pairs; throws std::invalid_argument where things do not fit together.
  void take() {
    const size_t n = features.shape(0), c = features.shape(1);
    check(centres.shape(0) == n && centres.shape(1) == 3, "centres");
    check(quaternions.shape(0) == n && quaternions.shape(1) == 4, "quaternions");
    check(scales.shape(0) == n && scales.shape(1) == 3, "scales");
    check(parameters.size() == PARAMETERS, "the list of parameters");
    check(parameters[0].ndim() == 3 && parameters[0].shape(0) == CELLS && parameters[0].shape(1) == c &&
          parameters[0].shape(2) == c, "the convolution");
    check_network(MODULATION, PAIR_CODE, c, "the modulation");
    check_network(GATE, c, 1, "the gate");
    check(parameters[RESIDUAL].ndim() == 2 && parameters[RESIDUAL].shape(0) == c && parameters[RESIDUAL].shape(1) == c &&
          parameters[RESIDUAL + 1].size() == c, "the residual");
    take_pairs((int64_t)n);
  }

 private:
  void check_network(size_t i, size_t inputs, size_t outputs, const char* name) const {
    const Flat* t = &parameters[i];
    check(t[0].ndim() == 2 && t[1].ndim() == 1 && t[2].ndim() == 2 && t[3].ndim() == 1 && t[0].shape(0) == inputs &&
          t[1].shape(0) == t[0].shape(1) && t[2].shape(0) == t[0].shape(1) && t[2].shape(1) == outputs &&
          t[3].shape(0) == outputs, name);
  }

  void take_pairs(int64_t n) {
    check(sites.shape(0) == neighbours.shape(0), "neighbours");
    check(ends.size() == CELLS && ends.back() == (int64_t)sites.shape(0), "the list of ends");
    for (size_t i = 0; i < CELLS; ++i) check(ends[i] >= (i ? ends[i - 1] : 0), "the list of ends");
    std::vector<uint8_t> shown((size_t)n, 0);
    for (size_t i = 0; i < seen.shape(0); ++i) {
      const int64_t row = seen.data()[i];
      if (row < 0 || row >= n || shown[(size_t)row])
        throw std::invalid_argument("seen[" + std::to_string(i) + "] is " + std::to_string(row) +
                                    ", expected different rows below " + std::to_string(n));
      shown[(size_t)row] = 1;
    }
    const int64_t *from = sites.data(), *to = neighbours.data();
    receive.resize(sites.shape(0));
    give.resize(sites.shape(0));
    size_t count = 0, pair = 0;
    for (const int64_t end : ends) {
      for (; pair < (size_t)end; ++pair) {
        const int64_t site = from[pair], other = to[pair];
        if (site < 0 || site >= n || other < 0 || other >= n)
          throw std::invalid_argument("pair " + std::to_string(pair) + " is of " + std::to_string(site) + " and " +
                                      std::to_string(other) + ", expected rows below " + std::to_string(n));
        receive[count] = site;
        give[count] = other;
        count += shown[(size_t)site];
      }
      kept_ends.push_back((int64_t)count);
    }
    receive.resize(count);
    give.resize(count);
  }
};

void forward(const SiteArrays& arrays, Out<float, 2> out, Out<float, 2> mixed) {
  const SupportArrays a = arrays.arrays();
  const auto fits = [&](const Out<float, 2>& t) { return t.shape(0) == (size_t)a.shown && t.shape(1) == (size_t)a.c; };
  check(fits(out) && fits(mixed), "out");
  nb::gil_scoped_release release;
  support(a, out.data(), mixed.data(), threads());
}

void backward(const SiteArrays& arrays, Out<float, 2> mixed, In<float, 2> of_out, Maybe<Out<float, 2>> by_features,
              Maybe<Out<float, 2>> by_quaternions, Maybe<Out<float, 2>> by_scales, const std::vector<Flat>& by_parameters) {
  const SupportArrays a = arrays.arrays();
  check(mixed.shape(0) == (size_t)a.shown && mixed.shape(1) == (size_t)a.c, "mixed");
  check(of_out.shape(0) == (size_t)a.shown && of_out.shape(1) == (size_t)a.c, "gradient by the features");
  check_rows(by_features, a.count, (size_t)a.c, "features gradient");
  check_rows(by_quaternions, a.count, 4, "quaternions gradient");
  check_rows(by_scales, a.count, 3, "scales gradient");
  check(by_parameters.size() == PARAMETERS, "the list of gradients");
  for (size_t i = 0; i < PARAMETERS; ++i) check(by_parameters[i].size() == arrays.parameters[i].size(), "gradient by a parameter");
  const SupportGradients g = {of_out.data(), data(by_features), data(by_quaternions), data(by_scales),
                              by_parameters[0].data(), gradients_at(by_parameters, MODULATION),
                              gradients_at(by_parameters, GATE), by_parameters[RESIDUAL].data(),
                              by_parameters[RESIDUAL + 1].data()};
  nb::gil_scoped_release release;
  support_backward(a, mixed.data(), g, threads());
}

}  // namespace

void bind_consistency(nb::module_& m) {
  nb::class_<SiteArrays>(m, "Sites", "Arrays of anchors that support one another, and of the networks for it.")
      .def("__init__",
           [](SiteArrays* self, In<float, 2> features, In<float, 2> centres, In<float, 2> quaternions, In<float, 2> scales,
              In<int64_t, 1> sites, In<int64_t, 1> neighbours, const std::vector<int64_t>& ends, In<int64_t, 1> seen,
              const std::vector<Flat>& parameters, bool modulated, bool gated) {
             new (self) SiteArrays{features, centres, quaternions, scales, sites, neighbours, ends, seen, parameters,
                                   modulated, gated};
             self->take();
           },
           array("features"), array("centres"), array("quaternions"), array("scales"), array("sites"),
           array("neighbours"), nb::arg("ends"), array("seen"), array("parameters"), nb::arg("modulated"),
           nb::arg("gated"));
  m.def("support", &forward, nb::arg("sites"), array("out"), array("mixed"), "Features of the seen sites after the step.");
  m.def("support_backward", &backward, nb::arg("sites"), array("mixed"), array("of_out"), array("by_features").none(),
        array("by_quaternions").none(), array("by_scales").none(), array("by_parameters"),
        "Gradients by sites and parameters from gradients by the features after the step.");
}

}  // namespace splat
