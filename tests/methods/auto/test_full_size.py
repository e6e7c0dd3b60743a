"""Trained small, drawn large: the large image is the small one, smooth, and not what is left of it."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import camera, random_gaussians
from splatproof.methods.auto.full_size import enlarge
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.gaussians import Gaussians

FACTOR = 8
SMALL, LARGE = camera(2), camera(2, width=24 * FACTOR, height=18 * FACTOR)


def image(where, gaussians: Gaussians) -> Tensor:
    return rasterize(
        where, gaussians.means, gaussians.quaternions, gaussians.scales, gaussians.opacities,
        sh=gaussians.sh,
    ).colour  # fmt: skip


def model_of(gaussians: Gaussians) -> GaussianModel:
    return GaussianModel(gaussians, Settings().rates, extent=1.0)


@pytest.mark.parametrize("finest", [0.002, 0.02])
def test_a_large_image_shows_what_the_small_one_shows(finest):
    """In the middle of each small pixel, which is what the rasterizer computes of it."""
    fine = random_gaussians(60)
    fine = replace(fine, log_scales=(fine.log_scales.exp() * finest / 0.1).log())
    small = image(SMALL, fine)
    model = model_of(fine)
    enlarge(model, [SMALL], float(FACTOR))
    errors = []
    for gaussians in (fine, model.gaussians()):
        middles = image(LARGE, gaussians).reshape(18, FACTOR, 24, FACTOR, 3)[:, 3:5, :, 3:5]
        large = middles.mean(dim=(1, 3))
        errors.append(float((large - small).square().mean().sqrt() / small.square().mean().sqrt()))
    before, after = errors
    assert before > 0.5  # hardly anything is left
    assert after < 0.03
    kept = model.gaussians()
    assert torch.equal(kept.means, fine.means)
    assert torch.equal(kept.opacity_logits, fine.opacity_logits)


def test_what_is_as_large_as_it_was_stays():
    fine = random_gaussians(60)
    model = model_of(fine)
    enlarge(model, [SMALL], 1.0)
    torch.testing.assert_close(model.gaussians().log_scales, fine.log_scales)


def test_the_nearest_camera_says_how_wide_a_pixel_is():
    far = SMALL.world_to_camera.clone()
    far[2, 3] += 100
    one, two = (model_of(random_gaussians(60)) for _ in range(2))
    enlarge(one, [SMALL], 2.0)
    enlarge(two, [SMALL, replace(SMALL, world_to_camera=far)], 2.0)
    pixels, _ = project_points(SMALL, one.gaussians().means)
    seen = ((pixels > 0) & (pixels < torch.tensor([24, 18]))).all(dim=1)
    assert int(seen.sum()) > 20
    assert torch.equal(one.gaussians().log_scales[seen], two.gaussians().log_scales[seen])
