// Loss, optimiser and whole training steps, for Python.
#include <nanobind/stl/vector.h>

#include <cmath>
#include <vector>

#include "adam.hpp"
#include "arrays.hpp"
#include "loss.hpp"
#include "pool.hpp"
#include "step.hpp"

namespace splat {
namespace {

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

// Tensors come as addresses: a model has a hundred of them, four to a parameter, and taking each as an array costs as
// much as the update of most. The caller has checked what they are, and holds them.
using Addresses = std::vector<uintptr_t>;

void adam_update(const Addresses& values, const Addresses& gradients, const Addresses& first, const Addresses& second,
                 const std::vector<int64_t>& lengths, const std::vector<int64_t>& sizes,
                 const std::vector<double>& rates, int64_t step, double beta1, double beta2, double epsilon,
                 Maybe<In<bool, 1>> rows) {
  const size_t n = values.size();
  check(gradients.size() == n && first.size() == n && second.size() == n && lengths.size() == n &&
        sizes.size() == n && rates.size() == n, "a list of tensors");
  const auto at = [](uintptr_t address) { return reinterpret_cast<float*>(address); };
  std::vector<AdamGroup> groups;
  for (size_t i = 0; i < n; ++i) {
    check(!rows || (int64_t)rows->shape(0) == lengths[i], "rows");
    groups.push_back({{at(values[i]), at(first[i]), at(second[i]), at(gradients[i])}, lengths[i],
                      lengths[i] ? sizes[i] / lengths[i] : 0, rates[i]});
  }
  const uint8_t* chosen = reinterpret_cast<const uint8_t*>(data(rows));
  nb::gil_scoped_release release;
  adam_step(groups, step, beta1, beta2, epsilon, chosen, threads());
}

// Loss of the raw parameters against a photo, and its gradients.
double step(const ModelArrays& arrays, const In<double, 2>& k, const In<double, 2>& pose, int width, int height,
            double near, Background background, In<float, 3> truth, Maybe<In<bool, 2>> mask, double dssim,
            Maybe<Out<float, 2>> means, Maybe<Out<float, 2>> quaternions, Maybe<Out<float, 2>> scales,
            Maybe<Out<float, 1>> opacities, Maybe<Out<float, 3>> sh, Maybe<Out<float, 3>> sh_rest,
            Maybe<Out<float, 2>> screen, Maybe<Out<float, 2>> screen_absolute, Out<float, 1> radii) {
  const Camera camera = make_camera(k, pose, width, height, near);
  const Model model = arrays.model();
  const int64_t n = model.count;
  check(arrays.sh.has_value(), "sh");
  check_image(truth, camera, "truth");
  check(truth.shape(2) == 3 && truth.size() < (size_t)1 << 31, "truth");
  check_image(mask, camera, "mask");
  check(!background || background->shape(0) == 3, "background");
  check_rows(means, n, 3, "means gradient");
  check_rows(quaternions, n, 4, "quaternions gradient");
  check_rows(scales, n, 3, "scales gradient");
  check_rows(opacities, n, 1, "opacities gradient");
  check_rows(sh, n, (size_t)3 * (arrays.sh_rest ? 1 : model.sh_stored), "sh gradient");
  check_rows(sh_rest, n, (size_t)3 * (model.sh_stored - 1), "sh_rest gradient");
  check_rows(screen, n, 2, "screen gradient");
  check_rows(screen_absolute, n, 2, "absolute screen gradient");
  check(radii.shape(0) == (size_t)n, "radii");
  const Photo photo = {truth.data(), reinterpret_cast<const uint8_t*>(data(mask)), dssim};
  const ModelGradients out = {data(means), data(quaternions), data(scales), data(opacities),      nullptr,
                              data(sh),    data(sh_rest),     data(screen), data(screen_absolute), nullptr};
  const float* behind = data(background);
  nb::gil_scoped_release release;
  return photometric_step(model, camera, behind, photo, out, radii.data(), threads());
}

// gradient_sum += |(half_width x, half_height y)| and seen += 1 where a Gaussian has a radius.
void observe(In<float, 2> screen, In<float, 1> radii, double half_width, double half_height, Out<float, 1> gradient_sum,
             Out<float, 1> seen) {
  const size_t n = radii.shape(0);
  check(screen.shape(0) == n && screen.shape(1) == 2, "screen");
  check(gradient_sum.shape(0) == n && seen.shape(0) == n, "a sum");
  const float *by = screen.data(), *radius = radii.data();
  float *sum = gradient_sum.data(), *count = seen.data();
  nb::gil_scoped_release release;
  over_gaussians(threads(), (int64_t)n, [&](int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
      if (!(radius[i] > 0)) continue;
      const double x = half_width * by[2 * i], y = half_height * by[2 * i + 1];
      sum[i] += (float)std::sqrt(x * x + y * y);
      count[i] += 1;
    }
  });
}

}  // namespace

void bind_training(nb::module_& m) {
  m.def("photometric", &photometric_loss, array("image"), array("truth"), array("mask").none(),
        nb::arg("dssim"), array("gradient").none(), "The loss; its gradient goes into `gradient`.");
  m.def("adam", &adam_update, nb::arg("values"), nb::arg("gradients"), nb::arg("first"), nb::arg("second"),
        nb::arg("lengths"), nb::arg("sizes"), nb::arg("rates"), nb::arg("step"), nb::arg("beta1"), nb::arg("beta2"), nb::arg("epsilon"),
        array("rows").none(), "One update of all tensors in place.");
  m.def("step", &step, nb::arg("model"), array("K"), array("world_to_camera"), nb::arg("width"), nb::arg("height"),
        nb::arg("near"), array("background").none(), array("truth"), array("mask").none(), nb::arg("dssim"),
        array("means").none(), array("quaternions").none(), array("scales").none(), array("opacities").none(),
        array("sh").none(), array("sh_rest").none(), array("screen").none(), array("screen_absolute").none(),
        array("radii"), "The loss of one view; its gradients go into the given arrays, unless it is not finite.");
  m.def("observe", &observe, array("screen"), array("radii"), nb::arg("half_width"), nb::arg("half_height"),
        array("gradient_sum"), array("seen"), "Add one view's screen gradients to the sums.");
}

}  // namespace splat
