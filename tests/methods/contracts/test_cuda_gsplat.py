"""The adapter to gsplat against a stand-in module of the same documented signature.

This shows that arguments and results are translated rightly; it runs no line of gsplat.
"""

import gc
import sys
import weakref
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians
from splatproof.base.errors import UsageError
from splatproof.methods.contracts import cuda_gsplat
from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.camera import Camera


def rasterization(
    means, quats, scales, opacities, colors, viewmats, Ks, width, height, *,
    near_plane, sh_degree, packed, render_mode, backgrounds, rasterize_mode, absgrad,
):  # fmt: skip
    """gsplat's function on the reference rasterizer: one camera, colours and expected depth."""
    assert (viewmats.shape, Ks.shape) == ((1, 4, 4), (1, 3, 3))
    assert (packed, render_mode, absgrad) == (False, "RGB+ED", True)
    assert backgrounds is None or backgrounds.shape == (1, 3)
    assert sh_degree is None or colors.shape[1:] == ((sh_degree + 1) ** 2, 3)
    view = Camera(K=Ks[0], world_to_camera=viewmats[0], width=width, height=height, near=near_plane)
    features: dict[str, Any] = {"colours": colors} if sh_degree is None else {"sh": colors}
    out = rasterizer.rasterize(
        view, means, quats, scales, opacities, mode=rasterize_mode, **features,
        background=None if backgrounds is None else backgrounds[0],
    )  # fmt: skip
    shifts: Any = torch.zeros(1, len(means), 2, requires_grad=True) * 1
    shifts.absgrad = torch.full((1, len(means), 2), 7.0)
    image = torch.cat([out.colour, out.depth[:, :, None]], dim=2) + shifts.sum()
    radii = out.radii.ceil().int()[None, :, None].repeat(1, 1, 2)
    return image[None], out.alpha[None, :, :, None], {"means2d": shifts, "radii": radii}


@pytest.fixture(autouse=True)
def stand_in(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    monkeypatch.setattr(cuda_gsplat, "gpu", lambda: torch.device("cpu"))


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("background", [None, torch.tensor([0.2, 0.5, 0.9])])
@pytest.mark.parametrize("lit", [15, 0, 6])
def test_arguments_and_results_are_translated(mode, background, lit):
    g = random_gaussians(15, degree=2)
    what: dict[str, Any] = {}
    if lit:
        what["sh"] = g.sh[:lit]
    if lit < 15:
        what["colours"] = g.sh[lit:, 0]
    given = (camera(2), g.means, g.quaternions, g.scales, g.opacities)
    options: dict[str, Any] = {"mode": mode, "background": background, **what}
    want = rasterizer.rasterize(*given, **options)
    probe = ScreenProbe.zeros(15, g.means)
    got = cuda_gsplat.rasterize(*given, **options, probe=probe)
    for name in ("colour", "alpha", "depth"):
        # the camera is rounded to float32 (6e-8): 5e-7 of 4 units, over a sum of weights >= 1/255
        torch.testing.assert_close(getattr(got, name), getattr(want, name), atol=1e-4, rtol=0)
    assert torch.equal(got.radii > 0, want.radii > 0)
    got.colour.mean().backward()
    assert probe.signed.grad is not None
    assert probe.absolute.grad is not None
    torch.testing.assert_close(probe.signed.grad, torch.ones(15, 2))
    assert torch.allclose(probe.absolute.grad, torch.full((15, 2), 7.0))


def test_nothing_of_a_step_outlives_it(monkeypatch):
    """A hook on a tensor that its own closure holds is a circle that nobody collects: 20 GB in 2,500 steps."""
    alive = []

    def watched(*given, **options):
        image, alpha, meta = rasterization(*given, **options)
        alive.append(weakref.ref(meta["means2d"]))
        return image, alpha, meta

    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=watched))
    g = random_gaussians(3)
    probe = ScreenProbe.zeros(3, g.means)
    given = (camera(2), g.means, g.quaternions, g.scales, g.opacities)
    cuda_gsplat.rasterize(*given, sh=g.sh, probe=probe).colour.mean().backward()
    gc.collect()
    assert probe.signed.grad is not None
    assert [held() for held in alive] == [None]


def test_what_gsplat_does_not_give_is_refused():
    g = random_gaussians(2)
    given = (camera(2), g.means, g.quaternions, g.scales, g.opacities)
    unknown: list[dict[str, Any]] = [{"distance": True}, {"median": True}, {"contributors": 2}]
    for option in unknown:
        with pytest.raises(UsageError, match="use 'cpu'"):
            cuda_gsplat.rasterize(*given, sh=g.sh, **option)
    with pytest.raises(ValueError, match="colours, sh or both"):
        cuda_gsplat.rasterize(*given)
