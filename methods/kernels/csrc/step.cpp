#include "step.hpp"

#include <cmath>

#include "loss.hpp"
#include "render.hpp"

namespace splat {

double photometric_step(const Model& model, const Camera& camera, const float* background, const Photo& photo,
                        const ModelGradients& out, float* radii, int threads) {
  const size_t floats = (size_t)camera.width * camera.height * model.channels;
  Buffer<float> colour(floats), gradient(floats);
  State state;
  state.camera = camera;
  Pictures pictures = {};
  pictures.channels = model.channels;
  pictures.background = background;
  pictures.colour = colour.data();
  forward(model, pictures, radii, threads, state);
  const double loss = photometric(colour.data(), photo.truth, photo.mask, camera.height, camera.width, model.channels,
                                  photo.dssim, gradient.data(), threads);
  if (!std::isfinite(loss)) return loss;
  PictureGradients by = {};
  by.channels = model.channels;
  by.background = background;
  by.colour = gradient.data();
  backward(model, by, out, threads, state);
  return loss;
}

}  // namespace splat
