"""Degenerate and extreme Gaussians: finite everywhere, and the reference's image and gradients."""

from typing import Any

import pytest
import torch

from splatproof import _ext
from splatproof.methods.kernels import rasterizer as native
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.suites.hard_cases.gaussian_scenes import camera_at, random_scene
from splatproof.suites.hard_cases.gaussians import CASES, LONG, judge, put, render


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("case", CASES)
def test_case(case, mode):
    row = judge(case, "cpu", mode)
    assert row["ok"], row


@pytest.mark.parametrize("level", _ext.simd_levels()[:-1])
@pytest.mark.parametrize("case", [name for name in CASES if name not in LONG])
def test_case_at_every_simd_level(case, level):
    before = _ext.simd_level()
    _ext.set_simd_level(level)
    try:
        row = judge(case, "cpu", "classic")
    finally:
        _ext.set_simd_level(before)
    assert row["ok"], row


def test_a_zero_quaternion_is_the_identity_with_zero_gradient():
    scene = put(random_scene(30, 5), "quaternions", slice(None), 0.0)
    weights = torch.ones(scene.camera.height, scene.camera.width, 3)
    out, gradients = render(native.rasterize, scene, torch.float32, weights, "classic")
    same = put(scene, "quaternions", slice(None), [2.0, 0, 0, 0])
    assert torch.equal(gradients[1], torch.zeros(30, 4))
    assert torch.equal(out.colour, render(native.rasterize, same, torch.float32, weights, "classic")[0].colour)  # fmt: skip


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["means", "quaternions", "scales", "opacities"])
def test_a_gaussian_with_a_bad_number_is_not_drawn_and_spoils_nothing(name, bad):
    scene = random_scene(30, 13)
    without = put(scene, "opacities", 4, 0.0)
    weights = torch.ones(scene.camera.height, scene.camera.width, 3)
    spoilt = put(scene, name, 4, bad)
    if name == "opacities" and bad < 0:
        pytest.skip("an opacity below 1/255 is not drawn anyway")
    out, gradients = render(native.rasterize, spoilt, torch.float32, weights, "classic")
    clean, _ = render(native.rasterize, without, torch.float32, weights, "classic")
    assert torch.equal(out.colour, clean.colour)
    assert all(torch.isfinite(g).all() for g in gradients)
    assert all(float(g[4].abs().max()) == 0 for g in gradients)


GOOD = {
    "means": (4, 3),
    "quaternions": (4, 4),
    "scales": (4, 3),
    "opacities": (4,),
    "sh": (4, 1, 3),
}
BAD = {
    "dtype": ("means", torch.zeros(4, 3, dtype=torch.float64)),
    "integers": ("scales", torch.zeros(4, 3, dtype=torch.int64)),
    "rows": ("scales", torch.zeros(5, 3)),
    "columns": ("quaternions", torch.zeros(4, 3)),
    "dimensions": ("opacities", torch.zeros(4, 1)),
    "harmonics": ("sh", torch.zeros(4, 5, 3)),
    "harmonics' channels": ("sh", torch.zeros(4, 4, 2)),
    "device": ("means", torch.zeros(4, 3, device="meta")),
    "background": ("background", torch.zeros(4)),
    "mode": ("mode", "sharp"),
    "contributors": ("contributors", -1),
    "both": ("colours", torch.zeros(4, 3)),
    "neither": ("sh", None),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_arguments_are_refused_with_their_name(case):
    name, value = BAD[case]
    arguments: dict[str, Any] = {key: torch.zeros(shape) for key, shape in GOOD.items()} | {
        name: value
    }
    # the undecorated function: users run without the shape checks that tests add
    function = getattr(native.rasterize, "__wrapped__", native.rasterize)
    with pytest.raises((ValueError, TypeError), match=name if name != "neither" else "sh"):
        function(camera_at(8, 8), **arguments)


def test_strides_do_not_matter():
    scene = random_scene(30, 14)
    plain = native.rasterize(scene.camera, *scene.arguments(torch.float32)[:4], sh=scene.sh)
    strided = [torch.stack([v, v], dim=-1)[..., 0] for v in scene.arguments(torch.float32)]
    assert not strided[0].is_contiguous()
    again = native.rasterize(scene.camera, *strided[:4], sh=strided[4])
    assert torch.equal(plain.colour, again.colour)


EXTREMES = {"scales": (1e10, 1e20, 1e30, 3e38), "sh": (1e10, 1e30)}
LARGEST = torch.finfo(torch.float32).max


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in EXTREMES.items() for value in values]
)
def test_numbers_near_the_end_of_float32(name, value, mode):
    scene = put(random_scene(30, 13), name, 4, value)
    weights = torch.ones(scene.camera.height, scene.camera.width, 3)
    want, slopes = render(reference.rasterize, scene, torch.float64, weights, mode)
    got, found = render(native.rasterize, scene, torch.float32, weights, mode)
    pairs = [(got.colour.detach(), want.colour.detach()), *zip(found, slopes, strict=True)]
    for one, other in pairs:
        # seen here: 8e-7 of the largest; 30 contributions of float32 at 1.2e-7 each
        budget = 30 * torch.finfo(torch.float32).eps * float(other.abs().max())
        assert float((one.double() - other).abs().max()) <= budget


def test_what_float32_cannot_hold_is_not_finite_rather_than_wrong():
    scene = put(random_scene(30, 13), "sh", 4, 3e38)
    weights = torch.ones(scene.camera.height, scene.camera.width, 3)
    want, slopes = render(reference.rasterize, scene, torch.float64, weights, "classic")
    got, found = render(native.rasterize, scene, torch.float32, weights, "classic")
    assert any(float(slope.abs().max()) > LARGEST for slope in slopes)
    pairs = [(got.colour.detach(), want.colour.detach()), *zip(found, slopes, strict=True)]
    for one, true in pairs:
        finite = one.isfinite()
        assert finite[true.abs() > LARGEST].sum() == 0
        off = (one.double() - true)[finite].abs()
        assert float(off.max()) < 1e-5 * float(true[finite].abs().max())
