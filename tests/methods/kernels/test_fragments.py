"""Tallies of single fragments: against the reference, one pixel's gradient after the other."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import camera, random_gaussians
from splatproof import _ext
from splatproof.methods.kernels.fragments import tallied
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.reference.density import opacity_spread
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians

SMALL = replace(camera(1), width=10, height=9)


def drawn(model: Gaussians, where: Camera, **asked):
    opacities = model.opacities.clone().requires_grad_()
    return rasterize(
        where, model.means, model.quaternions, model.scales, opacities, sh=model.sh, **asked
    )


def by_reference(model: Gaussians, where: Camera, by_colour: torch.Tensor, **asked) -> torch.Tensor:
    """The definition: g of each pixel by a backward pass of that pixel alone, in float64."""
    means, quaternions, scales, sh = (
        value.double() for value in (model.means, model.quaternions, model.scales, model.sh)
    )
    opacities = model.opacities.double().requires_grad_()
    image = reference.rasterize(
        where.to(torch.float64), means, quaternions, scales, opacities, sh=sh,
        contributors=len(means), **asked,
    )  # fmt: skip
    pixels = image.colour.reshape(-1, 3)
    weights = by_colour.double().reshape(-1, 3)
    gradients = torch.stack([
        torch.autograd.grad((pixel * weight).sum(), opacities, retain_graph=True)[0]
        for pixel, weight in zip(pixels, weights, strict=True)
    ])  # fmt: skip
    assert image.contributor_ids is not None
    ids = image.contributor_ids.reshape(len(pixels), -1)
    shown = torch.zeros(len(pixels), len(means) + 1, dtype=torch.bool)
    shown.scatter_(1, ids.where(ids >= 0, len(means)), value=True)
    return opacity_spread.tallied(gradients * opacities.detach(), shown[:, :-1])


def colours(where: Camera, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(where.height, where.width, 3, generator=generator)


@pytest.mark.usefixtures("simd_level")
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("background", [None, torch.tensor([0.2, 0.5, 0.9])])
def test_tallies_are_those_of_the_definition(mode, background):
    model, weights = random_gaussians(25), colours(SMALL)
    asked = {"mode": mode, "background": background}
    found = tallied(drawn(model, SMALL, **asked), weights)
    if background is not None:
        asked["background"] = background.double()
    want = by_reference(model, SMALL, weights, **asked).float()
    assert torch.equal(found[:, 2], want[:, 2])
    # float32 sums over 90 pixels, as other gradients are held to
    torch.testing.assert_close(found, want, rtol=1e-3, atol=1e-4 * float(want.abs().max()))
    assert (found[:, 2] > 1).any()


@given(seed=st.integers(0, 20), count=st.integers(1, 60))
def test_the_sum_is_the_gradient_by_opacity_and_squares_bound_it(seed, count):
    model, weights = random_gaussians(count), colours(camera(2), seed)
    opacities = model.opacities.clone().requires_grad_()
    image = rasterize(
        camera(2), model.means, model.quaternions, model.scales, opacities, sh=model.sh
    )
    found = tallied(image, weights)
    (gradient,) = torch.autograd.grad(image.colour, opacities, weights)
    torch.testing.assert_close(found[:, 0], opacities.detach() * gradient, rtol=1e-4, atol=1e-5)
    # Cauchy and Schwarz, up to rounding
    assert (found[:, 0].square() <= found[:, 1] * found[:, 2] * (1 + 1e-4) + 1e-6).all()
    assert torch.equal(found[:, 2], found[:, 2].round())
    assert not found[found[:, 2] == 0].any()


def test_threads_do_not_change_a_bit():
    model, weights = random_gaussians(300), colours(camera(2))
    before = torch.get_num_threads()
    found = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            found.append(tallied(drawn(model, camera(2)), weights))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*found)


def test_bands_do_not_change_a_bit():
    """Where a backward pass holds few pairs at once, rows are added up in the same order."""
    model, weights = random_gaussians(300), colours(camera(2))
    image = drawn(model, camera(2))
    whole = tallied(image, weights)
    _ext.set_backward_rows(50)
    try:
        assert torch.equal(tallied(image, weights), whole)
    finally:
        _ext.set_backward_rows(2**22)


def test_what_else_was_drawn_does_not_matter():
    model, weights = random_gaussians(30), colours(SMALL)
    plain = tallied(drawn(model, SMALL), weights)
    more = drawn(model, SMALL, distance=True, median=True, contributors=2)
    assert torch.equal(tallied(more, weights), plain)


def test_nothing_drawn_has_tallies_of_nothing():
    model = random_gaussians(20)
    behind = replace(model, means=model.means - 1e3)
    assert not tallied(drawn(behind, SMALL), colours(SMALL)).any()


def test_pictures_that_tell_no_fragments_are_refused():
    model, weights = random_gaussians(5), colours(SMALL)
    image = drawn(model, SMALL)
    with pytest.raises(ValueError, match=r"by_colour is torch.float32 \(9, 3, 3\), expected"):
        tallied(image, weights[:, :3])
    with pytest.raises(ValueError, match="no picture of this rasterizer"):
        tallied(replace(image, colour=image.colour.detach()), weights)
    two = rasterize(
        SMALL, model.means, model.quaternions, model.scales, model.opacities.requires_grad_(),
        colours=torch.rand(5, 2),
    )  # fmt: skip
    with pytest.raises(ValueError, match=r"expected torch.float32 \(9, 10, 2\)"):
        tallied(two, weights)
