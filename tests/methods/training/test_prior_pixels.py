"""Priors in training: each view's own, read once, and only of pixels that count."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import ThreeDGS
from splatproof.methods.training.prior_pixels import PriorPixels, require_prior
from splatproof.methods.training.terms import Frame
from splatproof.reference.types.scene import DepthPrior, View

SCENE = tiny_scene(views=3, points=10)
KNOWN = torch.rand(18, 24, generator=torch.Generator().manual_seed(0)) > 0.5
MASK = torch.rand(18, 24, generator=torch.Generator().manual_seed(1)) > 0.5


def told(view: View, value: float, reads: list[float]) -> View:
    """The view with a prior of one disparity, which notes each time that it is read."""

    def load() -> DepthPrior:
        reads.append(value)
        return DepthPrior(disparity=torch.full((18, 24), value), valid=KNOWN)

    return replace(view, load_prior=load)


def frame_of(view: View, mask: Tensor | None = None) -> Frame:
    model, _ = prepare(SCENE, ThreeDGS(iterations=1), Run())
    moment = Moment(step=1, total=1)
    splats = model.splats(view, moment)
    output = get_backend("cpu").draw(view.camera, splats)
    return Frame(
        view=view, moment=moment, splats=splats, output=output, image=output.colour,
        truth=view.load(), mask=mask, model=model,
    )  # fmt: skip


def test_each_view_has_its_own_prior_which_is_read_no_more_than_it_must():
    reads: list[float] = []
    views = [
        told(view, value, reads) for view, value in zip(SCENE.views[:2], (0.5, 2.0), strict=True)
    ]
    priors = PriorPixels()
    for _ in range(3):
        for view, value in zip(views, (0.5, 2.0), strict=True):
            found = priors.of(frame_of(view))
            assert found is not None
            assert torch.equal(found[0], torch.full((18, 24), value))
            assert torch.equal(found[1], KNOWN)
    assert sorted(reads) == [0.5, 0.5, 2.0, 2.0]  # once for the disparity, once for what is known


def test_pixels_that_a_mask_leaves_out_do_not_count():
    found = PriorPixels().of(frame_of(told(SCENE.views[0], 1.0, []), MASK))
    assert found is not None
    assert torch.equal(found[1], KNOWN & MASK)


def test_a_view_without_a_prior_has_none():
    assert PriorPixels().of(frame_of(SCENE.views[0])) is None
    with pytest.raises(DataError, match=r"no training view has a depth prior.*set a\.weight = 0"):
        require_prior(SCENE, "a.weight")
    views = (*SCENE.views[:2], told(SCENE.views[2], 1.0, []))
    require_prior(replace(SCENE, views=views), "a.weight")
