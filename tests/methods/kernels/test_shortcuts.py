"""Shortcuts of the native rasterizer: none by default, and errors below what their definition allows."""

import math

import pytest
import torch
from torch import Tensor

from splatproof.methods.kernels import rasterizer as native
from splatproof.reference.rasterizer import compositing, projection, rotation
from splatproof.reference.rasterizer.spherical_harmonics import seen_colours
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene, random_scene
from splatproof.suites.twins.random_scenes import speed_scene

ROUNDING = 2e-5
"""What test_rasterizer allows the pictures themselves."""
FULL = 1e-2
"""Light that is left before the Gaussian of alpha 0.99 or less that would leave less than 1e-4."""
SEEDS = range(4)


def crowded(seed: int) -> GaussianScene:
    """Pixels are full long before the last Gaussian."""
    return random_scene(600, seed, width=40, height=28)


def both(scene: GaussianScene, shortcuts: native.Shortcuts) -> tuple[Tensor, Tensor]:
    """Colours with shortcuts and without, on black."""
    *model, sh = scene.arguments(torch.float32)
    rough = native.rasterize_roughly(shortcuts, scene.camera, *model, sh=sh)
    exact = native.rasterize(scene.camera, *model, sh=sh)
    return rough.colour.detach(), exact.colour.detach()


def brightest(scene: GaussianScene) -> float:
    """Largest colour of any Gaussian: on black the largest difference of two."""
    centre = scene.camera.centre.to(scene.means)
    return float(seen_colours(scene.means, centre, scene.sh, None).max())


def alphas(scene: GaussianScene) -> tuple[Tensor, Tensor]:
    """Alpha of each Gaussian at each pixel, and its distance there in standard deviations, in float64."""
    means, quaternions, scales, opacities = (
        v.double().detach() for v in scene.arguments(torch.float32)[:4]
    )
    flat = projection.project(scene.camera, means, rotation.half_covariance(quaternions, scales))
    y, x = torch.meshgrid(
        torch.arange(scene.camera.height), torch.arange(scene.camera.width), indexing="ij"
    )
    pixels = torch.stack([x, y], dim=-1).reshape(-1, 1, 2).double() + 0.5
    offsets = pixels - flat.means
    alpha = compositing.alphas(offsets, flat.conics, opacities) * flat.in_front
    return alpha, torch.einsum("pni,nij,pnj->pn", offsets, flat.conics, offsets).sqrt()


def test_without_shortcuts_every_bit_is_the_usual_picture(simd_level):
    rough, exact = both(crowded(1), native.Shortcuts())
    assert torch.equal(rough, exact)


@pytest.mark.parametrize("stop", [1 / 255, 0.05])
def test_an_early_stop_loses_no_more_light_than_it_says(simd_level, stop):
    changed = 0
    for seed in SEEDS:
        scene = crowded(seed)
        rough, exact = both(scene, native.Shortcuts(stop=stop))
        error = (rough - exact).abs().max()
        assert error <= stop * brightest(scene) + ROUNDING
        changed += int((rough != exact).sum())
    assert changed > 0  # or the shortcut is none


def test_an_early_stop_leaves_fewer_gaussians_gradients(simd_level):
    *model, sh = crowded(2).arguments(torch.float32)
    camera = crowded(2).camera
    touched = []
    for stop in (1e-4, 0.2):
        out = native.rasterize_roughly(native.Shortcuts(stop=stop), camera, *model, sh=sh)
        (gradient,) = torch.autograd.grad(out.colour.sum(), [sh])
        assert bool(torch.isfinite(gradient).all())
        touched.append(int((gradient.abs().sum(dim=(1, 2)) > 0).sum()))
    assert 0 < touched[1] < touched[0]


def test_three_sigma_cut_no_more_than_they_say(simd_level):
    """Every Gaussian that may be missing at a pixel takes at most its alpha there of what lies behind."""
    changed = 0
    for seed in SEEDS:
        scene = random_scene(120, seed, width=40, height=28)
        rough, exact = both(scene, native.Shortcuts(sigmas=3.0))
        alpha, distance = alphas(scene)
        beyond = torch.where(distance > 3, alpha, 0)
        opacities = scene.opacities.double()
        assert bool((beyond <= opacities * math.exp(-4.5) + 1e-12).all())
        full = torch.where(
            (1 - alpha).prod(dim=1) < 2e-4, FULL, 0
        )  # another may be the one that fills it
        allowed = (beyond.sum(dim=1) + full) * brightest(scene) + ROUNDING
        error = (rough - exact).abs().amax(dim=2).flatten().double()
        assert bool((error <= allowed).all()), float((error - allowed).max())
        changed += int((error > ROUNDING).sum())
    assert changed > 0


@pytest.mark.parametrize("sigmas", [1.0, 3.0])
@pytest.mark.parametrize("half_turn", [0.0, 0.2, 0.39, 1.1])
def test_a_single_gaussian_is_whole_within_its_sigmas(simd_level, sigmas, half_turn):
    """Also a long one across several tiles, turned about the line of sight by twice `half_turn`."""
    camera = random_scene(1, 3, width=64, height=64).camera
    ahead = camera.rotation.double().T @ torch.tensor([0.0, 0.0, 4.0]).double()
    axis = math.sin(half_turn) * camera.rotation[2]
    scene = GaussianScene(
        camera=camera,
        means=(camera.centre.double() + ahead).float()[None],
        quaternions=torch.tensor([[math.cos(half_turn), *axis.tolist()]]),
        scales=torch.tensor([[1.0, 0.1, 0.1] if half_turn else [0.3, 0.3, 0.3]]),
        opacities=torch.tensor([0.9]),
        sh=torch.zeros(1, 1, 3),  # grey: 0.5
    )
    rough, exact = both(scene, native.Shortcuts(sigmas=sigmas))
    _, distance = alphas(scene)
    within = (distance[:, 0] < sigmas).reshape(64, 64)
    assert torch.equal(rough[within], exact[within])
    lost = (exact - rough)[~within]
    assert 0 < float(lost.max()) <= 0.5 * 0.9 * math.exp(-(sigmas**2) / 2) + ROUNDING


def test_bits_do_not_depend_on_threads(simd_level):
    scene, gradient = speed_scene(3_000, 130, 75)
    results = []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        leaves = scene.arguments(torch.float32)
        shortcuts = native.Shortcuts(stop=1 / 255, sigmas=3.0)
        out = native.rasterize_roughly(shortcuts, scene.camera, *leaves[:4], sh=leaves[4])
        results.append([out.colour, *torch.autograd.grad(out.colour, leaves, gradient)])
    for one, three in zip(*results, strict=True):
        assert torch.equal(one, three)


@pytest.mark.parametrize(
    "wrong", [{"stop": 0.0}, {"stop": 1.0}, {"stop": math.nan}, {"sigmas": 0.0}]
)
def test_shortcuts_that_mean_nothing_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        native.Shortcuts(**wrong)
