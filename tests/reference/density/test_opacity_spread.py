"""Spread of opacity gradients: by hand, order, scale, bounds."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import camera, random_gaussians
from splatproof.reference.density.opacity_spread import fragment_gradients, spread, tallied
from splatproof.reference.rasterizer.rasterize import rasterize


def draws(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).double()


def test_a_fragments_gradient_is_its_pixels_alone():
    """Definition: o dL_p / do of each pixel p by a backward pass of that pixel alone."""
    model, where = random_gaussians(12), replace(camera(1), width=7, height=6)
    means, turns, scales = (v.double() for v in (model.means, model.quaternions, model.scales))
    opacities, sh = model.opacities.double().requires_grad_(), model.sh.double()
    by_colour = draws(6, 7, 3)
    image = rasterize(where, means, turns, scales, opacities, sh=sh, contributors=12)
    loss = (image.colour * by_colour).sum(dim=2).flatten()
    wanted = [torch.autograd.grad(one, opacities, retain_graph=True)[0] for one in loss]
    found, drawn = fragment_gradients(
        where, means, turns, scales, opacities.detach(), sh, by_colour
    )
    torch.testing.assert_close(found, torch.stack(wanted) * opacities.detach())
    assert image.contributor_ids is not None
    assert torch.equal(drawn.sum(dim=1), (image.contributor_ids >= 0).sum(dim=2).flatten())
    assert not found[~drawn].any()
    assert drawn.any()


def test_a_clamped_fragment_passes_nothing_on_and_counts():
    model = random_gaussians(1)
    shape = (model.quaternions.double(), 0 * model.scales.double() + 100)
    where = replace(camera(1), width=4, height=4)
    found, drawn = fragment_gradients(
        where,
        model.means.double(),
        *shape,
        torch.ones(1).double(),
        model.sh.double(),
        draws(4, 4, 3),
    )
    assert drawn.all()
    assert not found.any()


def test_by_hand():
    gradients = torch.tensor([[1.0, 2.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 2.0, 0.0]]).double()
    drawn = torch.tensor([[True, True, True], [True, True, False], [False, True, False]])
    tallies = tallied(gradients, drawn)
    assert tallies.tolist() == [[0, 2, 2], [6, 12, 3], [0, 0, 1]]
    # 2 (2 / 3 - 0) and 3 (12 / 4 - (6 / 4)^2)
    assert spread(tallies).tolist() == pytest.approx([4 / 3, 2.25, 0])


def test_pixels_that_disagree_count_more_than_those_that_agree():
    drawn = torch.ones(40, 2, dtype=torch.bool)
    gradients = torch.ones(40, 2).double()
    gradients[:20, 0] = -1
    disputed, agreed = spread(tallied(gradients, drawn)).tolist()
    assert disputed > 30 * agreed


@given(seed=st.integers(0, 99), parts=st.integers(1, 4), scale=st.floats(1e-6, 1e6))
def test_order_and_parts_do_not_matter_and_it_grows_by_the_square(seed, parts, scale):
    gradients = draws(24, 5, seed=seed)
    drawn = draws(24, 5, seed=seed + 1) > -0.5
    gradients = gradients.where(drawn, 0)
    whole = spread(tallied(gradients, drawn))
    mixed = torch.randperm(24, generator=torch.Generator().manual_seed(seed))
    pieces = zip(gradients[mixed].chunk(parts), drawn[mixed].chunk(parts), strict=True)
    together = torch.stack([tallied(*piece) for piece in pieces]).sum(dim=0)
    torch.testing.assert_close(spread(together), whole)
    torch.testing.assert_close(spread(tallied(scale * gradients, drawn)), scale**2 * whole)
    assert (whole >= 0).all()
    assert (whole <= gradients.square().sum(dim=0) * (1 + 1e-9)).all()


def test_it_is_never_negative_where_rounding_would_make_it_so():
    # equal gradients of 1e4 pixels in float32: squares lose what the mean has
    tallies = torch.tensor([[1e4 * 0.3, 1e4 * 0.09, 1e4], [1e7, 0.999e10, 1e4], [0, 0, 0]])
    found = spread(tallies)
    assert found.isfinite().all()
    assert (found >= 0).all()
    assert found[2] == 0
