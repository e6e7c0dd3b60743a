"""Depth terms: what they say against the reference's, what they need, what they draw."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from helpers.tiny_drive import tiny_drive
from splatproof.base.errors import DataError
from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.hdgs.depth import depth_terms
from splatproof.methods.hdgs.settings import DepthSettings
from splatproof.methods.training.terms import Frame
from splatproof.reference.supervision.depth_supervision import outlier_loss, smoothness_loss
from splatproof.reference.supervision.soft_rank import soft_rank, standardised
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import DepthPrior, View
from splatproof.reference.types.splats import Splats

NOTHING = Splats(
    means=torch.zeros(0, 3), quaternions=torch.zeros(0, 4), scales=torch.zeros(0, 3),
    opacities=torch.zeros(0), colours=torch.zeros(0, 3),
)  # fmt: skip


class Unseen(Model):
    """Depth terms do not look at the model."""

    def splats(self, view: View, moment: Moment) -> Splats:
        raise AssertionError("a depth term looked at the model")


def frame(
    depth: torch.Tensor,
    prior: DepthPrior | None = None,
    seed: int = 0,
    mask: torch.Tensor | None = None,
) -> Frame:
    """A view of the tiny drive with some depth rendered, all opaque."""
    view = tiny_drive().views[0]
    if prior is not None:
        view = replace(view, load_prior=lambda: prior)
    output = RenderOutput(
        colour=torch.zeros(*depth.shape, 3), depth=depth, radii=torch.zeros(0),
        alpha=torch.full_like(depth, 0.99),
    )  # fmt: skip
    moment = Moment(step=1, total=2, generator=torch.Generator().manual_seed(seed))
    return Frame(
        view=view, moment=moment, splats=NOTHING, output=output, image=output.colour,
        truth=view.load(), mask=mask, model=Unseen(Parameters({}), {}),
    )  # fmt: skip


def depths(seed: int = 1) -> torch.Tensor:
    return 2 + 5 * torch.rand(18, 24, generator=torch.Generator().manual_seed(seed))


def term(name: str, **more: Any):
    chosen: dict[str, Any] = {"global_weight": 0.1, **more}
    settings = DepthSettings(**chosen)
    view = replace(tiny_drive().views[0], load_prior=pytest.fail)
    scene = replace(tiny_drive(), views=(view,), train=(0,), test=())
    return {t.name: t for t in depth_terms(scene, settings, unit=4.0)}[name]


def prior(disparity: torch.Tensor, valid: torch.Tensor | None = None) -> DepthPrior:
    valid = torch.ones_like(disparity, dtype=torch.bool) if valid is None else valid
    return DepthPrior(disparity=disparity, valid=valid)


def test_steps_are_the_references():
    depth, given = depths(), frame(depths())
    want = smoothness_loss(depth / 4.0, given.truth, 10.0)
    torch.testing.assert_close(term("depth steps").loss(given), want)


def test_outliers_are_the_references_where_the_crop_is_the_image():
    depth, given = depths(), frame(depths())
    ranks = soft_rank(standardised(depth.flatten()), 0.1) / depth.numel()
    want = outlier_loss(ranks.reshape(depth.shape), given.truth, 10.0, 0.05)
    assert want > 0
    torch.testing.assert_close(term("depth outliers", crop=24).loss(given), want)


def test_crops_are_drawn_from_the_moment():
    small = term("depth outliers", crop=7)
    one, same, other = (float(small.loss(frame(depths(), seed=s))) for s in (0, 0, 1))
    assert one == same != other


@pytest.mark.parametrize("name", ["depth steps", "depth outliers"])
def test_what_a_mask_hides_says_nothing(name):
    mask, local = torch.zeros(18, 24, dtype=torch.bool), term(name, crop=24, delta=0.01)
    mask[:, :12] = True
    assert float(local.loss(frame(depths(), mask=mask & False))) == 0
    every = local.loss(frame(depths(), mask=mask | True))
    torch.testing.assert_close(every, local.loss(frame(depths())))
    hidden = depths()
    hidden[:, 12:] = 100 * depths(2)[:, 12:]
    one, other = (local.loss(frame(depth, mask=mask)) for depth in (depths(), hidden))
    assert 0 < float(one) == float(other)
    level = torch.where(mask, 3.0, depths())  # the rim of the mask has neighbours on one side alone
    assert float(local.loss(frame(level, mask=mask))) == pytest.approx(0, abs=1e-6)


def test_order_counts_and_neither_scale_nor_zero_point_of_the_prior():
    order, depth = term("depth order", temperature=0.01), depths()
    right = frame(depth, prior(7 / depth - 3))
    wrong = frame(depth, prior(3 - 7 / depth))
    assert float(order.loss(right)) < 1e-3
    assert float(order.loss(wrong)) > 2 - 1e-3


def test_a_prior_is_compared_in_disparity():
    # a zero point below 0: the inverse of this prior changes sign in the middle of the image
    depth = depths()
    given = frame(depth.requires_grad_(), prior(1 / depth.detach() - 0.3))
    assert float(term("depth order", temperature=0.01).loss(given).detach()) < 1e-3


def test_order_pulls_at_depth_and_not_where_the_prior_says_nothing():
    depth, valid = depths().requires_grad_(), torch.zeros(18, 24, dtype=torch.bool)
    valid[:9] = True
    given = frame(depth, prior(depths(2), valid))
    term("depth order", pixels=10_000).loss(given).backward()
    assert depth.grad is not None
    assert depth.grad[:9].abs().sum() > 0
    assert (depth.grad[9:] == 0).all()


def test_as_many_pixels_are_drawn_as_asked_for():
    depth = depths().requires_grad_()
    term("depth order", pixels=50).loss(frame(depth, prior(depths(2)))).backward()
    assert depth.grad is not None
    assert 40 < int((depth.grad != 0).sum()) <= 50


def test_a_view_without_a_prior_says_nothing():
    assert term("depth order").loss(frame(depths())) == 0


def test_a_scene_without_priors_is_refused_with_the_setting_that_does_without():
    with pytest.raises(DataError, match=r"no training view has a depth prior; .*global_weight = 0"):
        depth_terms(tiny_drive(), DepthSettings(global_weight=0.005), unit=1.0)
    names = [t.name for t in depth_terms(tiny_drive(), DepthSettings(), unit=1.0)]
    assert names == ["depth steps", "depth outliers"]
    assert depth_terms(tiny_drive(), DepthSettings(smooth=0.0, outlier=0.0), unit=1.0) == ()
