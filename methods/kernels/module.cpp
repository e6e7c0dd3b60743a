// The compiled module splatbench._ext: what the machine offers, and the native kernels.
//
// Arrays come in through DLPack, float32, contiguous, on the CPU; the Python wrappers see to that and check
// the shapes. Outputs are written into arrays that the caller allocated.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "adam.hpp"
#include "loss.hpp"
#include "pool.hpp"
#include "render.hpp"
#include "roofline.hpp"

namespace nb = nanobind;
using namespace splat;

extern const Kernels splat_kernels_portable;
#if defined(__x86_64__)
extern const Kernels splat_kernels_avx2, splat_kernels_avx512;
#endif

namespace {

template <class T, int N>
using In = nb::ndarray<nb::pytorch, const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T, int N>
using Out = nb::ndarray<nb::pytorch, T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class A>
using Maybe = std::optional<A>;

template <class A>
auto* data(const Maybe<A>& array) {
  return array ? array->data() : nullptr;
}

// Levels that this machine can run, slowest first.
std::vector<const Kernels*> levels() {
  std::vector<const Kernels*> found = {&splat_kernels_portable};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    found.push_back(&splat_kernels_avx2);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
      found.push_back(&splat_kernels_avx512);
  }
#endif
  return found;
}

const Kernels* current = nullptr;

void set_simd_level(const std::string& name) {
  std::string known;
  for (const Kernels* k : levels()) {
    if (name == k->name) {
      current = k;
      return;
    }
    known += std::string(known.empty() ? "" : ", ") + k->name;
  }
  throw std::invalid_argument("SIMD level '" + name + "' is not one that this machine has: " + known);
}

const Kernels& from_environment() {
  const char* name = std::getenv("SPLATBENCH_SIMD");
  if (name && *name) set_simd_level(name);
  else current = levels().back();
  return *current;
}

Camera make_camera(const In<double, 2>& k, const In<double, 2>& pose, int width, int height, double near) {
  if (k.shape(0) != 3 || k.shape(1) != 3 || pose.shape(0) != 4 || pose.shape(1) != 4 || width < 1 || height < 1)
    throw std::invalid_argument("K must be [3, 3], world_to_camera [4, 4], width and height at least 1");
  Camera c;
  const double *K = k.data(), *P = pose.data();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) c.rotation[3 * i + j] = P[4 * i + j];
    c.translation[i] = P[4 * i + 3];
  }
  for (int j = 0; j < 3; ++j)
    c.centre[j] = -(P[j] * P[3] + P[4 + j] * P[7] + P[8 + j] * P[11]);
  for (int i = 0; i < 6; ++i) c.k[i] = K[i];
  c.limit_x = 1.3 * 0.5 * width / K[0];
  c.limit_y = 1.3 * 0.5 * height / K[4];
  c.near = near;
  c.width = width;
  c.height = height;
  return c;
}

// What a set of Gaussians is given as; held while kernels read it.
struct ModelArrays {
  In<float, 2> means, quaternions, scales;
  In<float, 1> opacities;
  Maybe<In<float, 2>> colours;
  Maybe<In<float, 3>> sh;
  int sh_used;
  bool raw, antialiased;

  Model model() const {
    const size_t n = means.shape(0);
    const bool good = means.shape(1) == 3 && quaternions.shape(0) == n && quaternions.shape(1) == 4 &&
                      scales.shape(0) == n && scales.shape(1) == 3 && opacities.shape(0) == n &&
                      (colours ? colours->shape(0) == n && colours->shape(1) <= MAX_CHANNELS
                               : sh && sh->shape(0) == n && sh->shape(2) == 3 && sh_used >= 1 && sh_used <= 16 &&
                                     (size_t)sh_used <= sh->shape(1));
    if (!good || n >> 31) throw std::invalid_argument("the Gaussians' arrays do not fit together");
    Model m = {};
    m.means = means.data();
    m.quaternions = quaternions.data();
    m.scales = scales.data();
    m.opacities = opacities.data();
    m.colours = data(colours);
    m.sh = data(sh);
    m.count = (int64_t)n;
    m.channels = colours ? (int)colours->shape(1) : 3;
    m.sh_used = sh_used;
    m.sh_stored = sh ? (int)sh->shape(1) : 0;
    m.raw = raw;
    m.antialiased = antialiased;
    return m;
  }
};

using Background = Maybe<In<float, 1>>;

void check(bool good, const char* what) {
  if (!good) throw std::invalid_argument(std::string(what) + " has the wrong shape");
}

template <class A>
void check_image(const A& a, const Camera& c, const char* what) {
  check(a.shape(0) == (size_t)c.height && a.shape(1) == (size_t)c.width, what);
}

template <class A>
void check_image(const Maybe<A>& a, const Camera& c, const char* what) {
  if (a) check_image(*a, c, what);
}

template <class A>
void check_rows(const Maybe<A>& a, int64_t n, size_t columns, const char* what) {
  check(!a || (a->shape(0) == (size_t)n && a->size() == (size_t)n * columns), what);
}

State* render(const ModelArrays& arrays, const In<double, 2>& k, const In<double, 2>& pose, int width,
                              int height, double near, Background background, Out<float, 3> colour,
                              Out<float, 2> alpha, Out<float, 2> depth, Out<float, 1> radii,
                              Maybe<Out<float, 2>> left, Maybe<Out<float, 2>> distance, Maybe<Out<float, 2>> median,
                              Maybe<Out<int64_t, 3>> ids, Maybe<Out<float, 3>> weights) {
  auto state = std::make_unique<State>();
  state->camera = make_camera(k, pose, width, height, near);
  const Model model = arrays.model();
  const Camera& c = state->camera;
  check_image(colour, c, "colour");
  check_image(alpha, c, "alpha");
  check_image(depth, c, "depth");
  check_image(left, c, "left");
  check_image(distance, c, "distance");
  check_image(median, c, "median");
  check_image(ids, c, "ids");
  check_image(weights, c, "weights");
  check(colour.shape(2) == (size_t)model.channels, "colour");
  check(!background || background->shape(0) == (size_t)model.channels, "background");
  check(radii.shape(0) == (size_t)model.count, "radii");
  check(ids.has_value() == weights.has_value() && (!ids || ids->shape(2) == weights->shape(2)), "ids");
  Pictures p = {};
  p.channels = model.channels;
  p.background = data(background);
  p.colour = colour.data();
  p.alpha = alpha.data();
  p.depth = depth.data();
  p.left = data(left);
  p.distance = data(distance);
  p.median = data(median);
  p.contributors = ids ? (int)ids->shape(2) : 0;
  p.ids = data(ids);
  p.weights = data(weights);
  nb::gil_scoped_release release;
  forward(model, p, radii.data(), threads(), *state);
  return state.release();
}

void render_backward(State& state, const ModelArrays& arrays, Background background, In<float, 2> alpha_value,
                     In<float, 2> depth_value, Maybe<In<float, 2>> distance_value, Maybe<In<float, 3>> colour,
                     Maybe<In<float, 2>> alpha, Maybe<In<float, 2>> depth, Maybe<In<float, 2>> distance,
                     Maybe<In<float, 2>> median, Maybe<Out<float, 2>> means, Maybe<Out<float, 2>> quaternions,
                     Maybe<Out<float, 2>> scales, Maybe<Out<float, 1>> opacities, Maybe<Out<float, 2>> colours,
                     Maybe<Out<float, 3>> sh, Maybe<Out<float, 2>> screen, Maybe<Out<float, 2>> screen_absolute) {
  const Model model = arrays.model();
  const Camera& c = state.camera;
  const int64_t n = model.count;
  check(n == state.count && model.channels == state.channels, "the model");
  check_image(alpha_value, c, "alpha_value");
  check_image(depth_value, c, "depth_value");
  check_image(distance_value, c, "distance_value");
  check_image(colour, c, "colour gradient");
  check_image(alpha, c, "alpha gradient");
  check_image(depth, c, "depth gradient");
  check_image(distance, c, "distance gradient");
  check_image(median, c, "median gradient");
  check(!colour || colour->shape(2) == (size_t)model.channels, "colour gradient");
  check(!distance || distance_value, "distance_value");
  check(!background || background->shape(0) == (size_t)model.channels, "background");
  check_rows(means, n, 3, "means gradient");
  check_rows(quaternions, n, 4, "quaternions gradient");
  check_rows(scales, n, 3, "scales gradient");
  check_rows(opacities, n, 1, "opacities gradient");
  check_rows(colours, n, model.channels, "colours gradient");
  check_rows(sh, n, (size_t)3 * model.sh_stored, "sh gradient");
  check_rows(screen, n, 2, "screen gradient");
  check_rows(screen_absolute, n, 2, "absolute screen gradient");
  PictureGradients p = {};
  p.channels = model.channels;
  p.background = data(background);
  p.alpha_value = alpha_value.data();
  p.depth_value = depth_value.data();
  p.distance_value = data(distance_value);
  p.colour = data(colour);
  p.alpha = data(alpha);
  p.depth = data(depth);
  p.distance = data(distance);
  p.median = data(median);
  const ModelGradients g = {data(means),   data(quaternions), data(scales), data(opacities),
                            data(colours), data(sh),          data(screen), data(screen_absolute)};
  nb::gil_scoped_release release;
  backward(model, p, g, threads(), state);
}

double photometric_loss(In<float, 3> image, In<float, 3> truth, Maybe<In<bool, 2>> mask, double dssim,
                        Maybe<Out<float, 3>> gradient) {
  const size_t h = image.shape(0), w = image.shape(1), c = image.shape(2);
  const auto same = [&](const auto& a) { return a.shape(0) == h && a.shape(1) == w && a.shape(2) == c; };
  check(same(truth) && h * w * c > 0 && h * w * c < (size_t)1 << 31, "truth");
  check(!mask || (mask->shape(0) == h && mask->shape(1) == w), "mask");
  check(!gradient || same(*gradient), "gradient");
  const uint8_t* valid = reinterpret_cast<const uint8_t*>(data(mask));
  nb::gil_scoped_release release;
  return photometric(image.data(), truth.data(), valid, (int)h, (int)w, (int)c, dssim, data(gradient), threads());
}

using Flat = nb::ndarray<nb::pytorch, float, nb::c_contig, nb::device::cpu>;

void adam_update(const std::vector<Flat>& values, const std::vector<Flat>& gradients, const std::vector<Flat>& first,
                 const std::vector<Flat>& second, const std::vector<double>& rates, int64_t step, double beta1,
                 double beta2, double epsilon, Maybe<In<bool, 1>> rows) {
  const size_t n = values.size();
  check(gradients.size() == n && first.size() == n && second.size() == n && rates.size() == n, "a list of tensors");
  std::vector<AdamGroup> groups;
  for (size_t i = 0; i < n; ++i) {
    const size_t size = values[i].size();
    check(gradients[i].size() == size && first[i].size() == size && second[i].size() == size, "a gradient or moment");
    const size_t length = values[i].ndim() ? values[i].shape(0) : 0;
    check(!rows || rows->shape(0) == length, "rows");
    groups.push_back({{values[i].data(), first[i].data(), second[i].data(), gradients[i].data()},
                      (int64_t)length, length ? (int64_t)(size / length) : 0, rates[i]});
  }
  const uint8_t* chosen = reinterpret_cast<const uint8_t*>(data(rows));
  nb::gil_scoped_release release;
  adam_step(groups, step, beta1, beta2, epsilon, chosen, threads());
}

}  // namespace

const Kernels& splat::kernels() { return *current; }

NB_MODULE(_ext, m) {
  m.doc() = "Native CPU kernels of splatbench.";
  nb::set_leak_warnings(false);  // a result that lives until the interpreter ends is no leak
  from_environment();
  m.def("simd_level", [] { return std::string(current->name); }, "The SIMD level in use.");
  m.def("simd_levels", [] {
    std::vector<std::string> names;
    for (const Kernels* k : levels()) names.push_back(k->name);
    return names;
  }, "SIMD levels that this machine can run, slowest first.");
  m.def("set_simd_level", &set_simd_level, nb::arg("name"), "Use another level from now on.");
  m.def("threads", &threads, "Threads in use.");
  m.def("set_threads", &set_threads, nb::arg("count"), "Use so many threads from now on.");
  m.def("compiler", [] { return std::string(__VERSION__); }, "The compiler that built this module.");
  m.def("exp2", [](In<float, 1> x, Out<float, 1> y) {
    check(x.shape(0) == y.shape(0), "y");
    current->exp2(x.data(), y.data(), (int64_t)x.shape(0));
  }, nb::arg("x"), nb::arg("y"), "y = 2^x for x in [-100, 0], as the kernels compute it.");

  register_roofline(m);
  m.def("photometric", &photometric_loss, nb::arg("image"), nb::arg("truth"), nb::arg("mask").none(),
        nb::arg("dssim"), nb::arg("gradient").none(), "The loss; its gradient goes into `gradient`.");
  m.def("adam", &adam_update, nb::arg("values"), nb::arg("gradients"), nb::arg("first"), nb::arg("second"),
        nb::arg("rates"), nb::arg("step"), nb::arg("beta1"), nb::arg("beta2"), nb::arg("epsilon"),
        nb::arg("rows").none(), "One update of all tensors in place.");

  nb::class_<ModelArrays>(m, "Model", "Arrays of a set of Gaussians.")
      .def("__init__",
           [](ModelArrays* self, In<float, 2> means, In<float, 2> quaternions, In<float, 2> scales,
              In<float, 1> opacities, Maybe<In<float, 2>> colours, Maybe<In<float, 3>> sh, int sh_used, bool raw,
              bool antialiased) {
             new (self) ModelArrays{means, quaternions, scales, opacities, colours, sh, sh_used, raw, antialiased};
           },
           nb::arg("means"), nb::arg("quaternions"), nb::arg("scales"), nb::arg("opacities"),
           nb::arg("colours").none(), nb::arg("sh").none(), nb::arg("sh_used"), nb::arg("raw"),
           nb::arg("antialiased"));
  nb::class_<State>(m, "State", "What a backward pass needs of the forward pass.")
      .def_prop_ro("bytes", &State::bytes, "Memory held.")
      .def_prop_ro("pairs", [](const State& s) { return s.bins.entries.size(); }, "Pairs of Gaussian and tile.");
  m.def("render", &render, nb::arg("model"), nb::arg("K"), nb::arg("world_to_camera"), nb::arg("width"),
        nb::arg("height"), nb::arg("near"), nb::arg("background").none(), nb::arg("colour"), nb::arg("alpha"),
        nb::arg("depth"), nb::arg("radii"), nb::arg("left").none(), nb::arg("distance").none(), nb::arg("median").none(),
        nb::arg("ids").none(), nb::arg("weights").none(), "Render into the given arrays.");
  m.def("render_backward", &render_backward, nb::arg("state"), nb::arg("model"), nb::arg("background").none(),
        nb::arg("alpha_value"), nb::arg("depth_value"), nb::arg("distance_value").none(), nb::arg("colour").none(),
        nb::arg("alpha").none(), nb::arg("depth").none(), nb::arg("distance").none(), nb::arg("median").none(),
        nb::arg("means").none(), nb::arg("quaternions").none(), nb::arg("scales").none(),
        nb::arg("opacities").none(), nb::arg("colours").none(), nb::arg("sh").none(), nb::arg("screen").none(),
        nb::arg("screen_absolute").none(), "Gradients of the model from gradients of the pictures.");
}
