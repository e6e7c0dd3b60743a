// Rendering and its backward pass, for Python. Outputs are written into arrays that the caller allocated.
#include <nanobind/stl/tuple.h>

#include <limits>
#include <memory>
#include <tuple>

#include "arrays.hpp"
#include "pool.hpp"
#include "render.hpp"

namespace splat {

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
  const double reach_x = 1.3 * 0.5 * width / K[0], reach_y = 1.3 * 0.5 * height / K[4];
  const double middle_x = (0.5 * width - K[2]) / K[0], middle_y = (0.5 * height - K[5]) / K[4];
  c.low_x = middle_x - reach_x;
  c.high_x = middle_x + reach_x;
  c.low_y = middle_y - reach_y;
  c.high_y = middle_y + reach_y;
  c.near = near;
  c.width = width;
  c.height = height;
  return c;
}

Model ModelArrays::model() const {
  const size_t n = means.shape(0);
  const int stored = (int)((sh ? sh->shape(1) : 0) + (sh_rest ? sh_rest->shape(1) : 0));
  const size_t lit = sh ? sh->shape(0) : 0, plain = colours ? colours->shape(0) : 0;
  const bool good = means.shape(1) == 3 && quaternions.shape(0) == n && quaternions.shape(1) == 4 &&
                    scales.shape(0) == n && scales.shape(1) == 3 && opacities.shape(0) == n &&
                    (sh || colours) && lit + plain == n &&
                    (!colours || (sh ? colours->shape(1) == 3 : colours->shape(1) <= MAX_CHANNELS)) &&
                    (!sh || (sh->shape(2) == 3 && sh_used >= 1 && sh_used <= stored &&
                             (stored == 1 || stored == 4 || stored == 9 || stored == 16))) &&
                    (!sh_rest || (sh && sh->shape(1) == 1 && sh_rest->shape(0) == lit && sh_rest->shape(2) == 3));
  if (!good || n >> 31) throw std::invalid_argument("the Gaussians' arrays do not fit together");
  Model m = {};
  m.means = means.data();
  m.quaternions = quaternions.data();
  m.scales = scales.data();
  m.opacities = opacities.data();
  m.colours = data(colours);
  m.sh = data(sh);
  m.sh_rest = data(sh_rest);
  m.count = (int64_t)n;
  m.sh_count = (int64_t)lit;
  m.channels = colours ? (int)colours->shape(1) : 3;
  m.sh_used = sh_used;
  m.sh_stored = stored;
  m.raw = raw;
  m.antialiased = antialiased;
  m.stop = (float)stop;
  m.reach = (float)(sigmas * sigmas * WHITEN * WHITEN);
  return m;
}

namespace {

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

State* render_again(State& before, const ModelArrays& arrays, Background background, Out<float, 3> colour) {
  const Model model = arrays.model();
  check(model.count == before.count && model.colours && model.sh_count == 0, "the model");
  check_image(colour, before.camera, "colour");
  check(colour.shape(2) == (size_t)model.channels, "colour");
  check(!background || background->shape(0) == (size_t)model.channels, "background");
  auto state = std::make_unique<State>();
  Pictures p = {};
  p.channels = model.channels;
  p.background = data(background);
  p.colour = colour.data();
  nb::gil_scoped_release release;
  forward_again(model, p, before, threads(), *state);
  return state.release();
}

void render_blocks(const ModelArrays& arrays, const In<double, 2>& k, const In<double, 2>& pose, int width, int height,
                   double near, Background background, In<int64_t, 1> blocks, Out<float, 4> colour, Out<float, 3> alpha,
                   Out<float, 3> depth) {
  const Camera camera = make_camera(k, pose, width, height, near);
  const Model model = arrays.model();
  const size_t count = colour.shape(0), h = height, w = width;
  check(colour.shape(1) == h && colour.shape(2) == w && colour.shape(3) == (size_t)model.channels, "colour");
  check(alpha.shape(0) == count && alpha.shape(1) == h && alpha.shape(2) == w, "alpha");
  check(depth.shape(0) == count && depth.shape(1) == h && depth.shape(2) == w, "depth");
  check(blocks.shape(0) == (size_t)model.count && !(count >> 31), "blocks");
  check(!background || background->shape(0) == (size_t)model.channels, "background");
  const int64_t* block = blocks.data();
  for (int64_t i = 0; i < model.count; ++i)
    if (block[i] < 0 || block[i] >= (int64_t)count)
      throw std::invalid_argument("blocks[" + std::to_string(i) + "] is " + std::to_string(block[i]) +
                                  ", expected 0 to " + std::to_string((int64_t)count - 1));
  Pictures p = {};
  p.channels = model.channels;
  p.background = data(background);
  p.colour = colour.data();
  p.alpha = alpha.data();
  p.depth = depth.data();
  nb::gil_scoped_release release;
  forward_blocks(model, camera, block, (int)count, p, threads());
}

void render_backward(State& state, const ModelArrays& arrays, Background background, In<float, 2> alpha_value,
                     In<float, 2> depth_value, Maybe<In<float, 2>> distance_value, Maybe<In<float, 3>> colour,
                     Maybe<In<float, 2>> alpha, Maybe<In<float, 2>> depth, Maybe<In<float, 2>> distance,
                     Maybe<In<float, 2>> median, Maybe<Out<float, 2>> means, Maybe<Out<float, 2>> quaternions,
                     Maybe<Out<float, 2>> scales, Maybe<Out<float, 1>> opacities, Maybe<Out<float, 2>> colours,
                     Maybe<Out<float, 3>> sh, Maybe<Out<float, 2>> screen, Maybe<Out<float, 2>> screen_absolute,
                     Maybe<Out<float, 2>> fragments) {
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
  check_rows(colours, n - model.sh_count, model.channels, "colours gradient");
  check(!arrays.sh_rest, "sh_rest");
  check_rows(sh, model.sh_count, (size_t)3 * model.sh_stored, "sh gradient");
  check_rows(screen, n, 2, "screen gradient");
  check_rows(screen_absolute, n, 2, "absolute screen gradient");
  check_rows(fragments, n, 3, "fragments");
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
                            data(colours), data(sh), nullptr, data(screen), data(screen_absolute),
                            data(fragments)};
  nb::gil_scoped_release release;
  backward(model, p, g, threads(), state);
}

}  // namespace

void bind_raster(nb::module_& m) {
  nb::class_<ModelArrays>(m, "Model", "Arrays of a set of Gaussians.")
      .def("__init__",
           [](ModelArrays* self, In<float, 2> means, In<float, 2> quaternions, In<float, 2> scales,
              In<float, 1> opacities, Maybe<In<float, 2>> colours, Maybe<In<float, 3>> sh, int sh_used, bool raw,
              bool antialiased, Maybe<In<float, 3>> sh_rest, double stop, double sigmas) {
             if (!(stop >= T_MIN && stop < 1 && sigmas > 0))
               throw std::invalid_argument("stop must be in [1e-4, 1) and sigmas above 0");
             new (self)
                 ModelArrays{means, quaternions, scales, opacities, colours, sh, sh_rest, sh_used, raw, antialiased, stop, sigmas};
           },
           array("means"), array("quaternions"), array("scales"), array("opacities"),
           array("colours").none(), array("sh").none(), nb::arg("sh_used"), nb::arg("raw"),
           nb::arg("antialiased"), array("sh_rest").none() = nb::none(), nb::arg("stop") = T_MIN,
           nb::arg("sigmas") = std::numeric_limits<double>::infinity());
  nb::class_<State>(m, "State", "What a backward pass needs of the forward pass.")
      .def_prop_ro("bytes", &State::bytes, "Memory held.")
      .def_prop_ro("pairs", [](const State& s) { return s.bins.entries.size(); }, "Pairs of Gaussian and tile.");
  m.def("render", &render, nb::arg("model"), array("K"), array("world_to_camera"), nb::arg("width"),
        nb::arg("height"), nb::arg("near"), array("background").none(), array("colour"), array("alpha"),
        array("depth"), array("radii"), array("left").none(), array("distance").none(), array("median").none(),
        array("ids").none(), array("weights").none(), "Render into the given arrays.");
  m.def("render_again", &render_again, nb::arg("before"), nb::arg("model"), array("background").none(), array("colour"),
        nb::keep_alive<0, 1>(), "Other colours of Gaussians that were drawn, and what a backward pass needs of that.");
  m.def("render_backward", &render_backward, nb::arg("state"), nb::arg("model"), array("background").none(),
        array("alpha_value"), array("depth_value"), array("distance_value").none(), array("colour").none(),
        array("alpha").none(), array("depth").none(), array("distance").none(), array("median").none(),
        array("means").none(), array("quaternions").none(), array("scales").none(),
        array("opacities").none(), array("colours").none(), array("sh").none(), array("screen").none(),
        array("screen_absolute").none(), array("fragments").none() = nb::none(), "Gradients of the model from gradients of the pictures.");
  m.def("render_blocks", &render_blocks, nb::arg("model"), array("K"), array("world_to_camera"), nb::arg("width"),
        nb::arg("height"), nb::arg("near"), array("background").none(), array("blocks"), array("colour"),
        array("alpha"), array("depth"), "Render each block of Gaussians alone.");
  m.def("memory", [] {
    const Memory now = memory_in_use();
    return std::make_tuple(now.held, now.peak, now.idle);
  }, "Bytes of scratch in use, most in use at once, and kept for later.");
  m.def("forget_peak", &forget_peak, "The most in use starts again at what is in use now.");
  m.def("pairs_listed", &pairs_listed, "Pairs of Gaussian and tile of all pictures of this process so far.");
  m.def("set_backward_rows", &set_backward_rows, nb::arg("count"),
        "Pairs of Gaussian and tile whose gradients a backward pass holds at once.");
}

}  // namespace splat
