"""Degenerate and extreme Gaussians: finite everywhere, and the reference's image and gradients."""

from typing import Any

import pytest
import torch

from helpers.gaussian_scenes import GaussianScene, camera_at, random_scene
from splatbench.methods.kernels import rasterizer as native
from splatbench.reference import rasterizer as reference
from splatbench.reference.agreement import compare_gradients, largest_error
from splatbench.reference.steps import step_pixels


def facing(count: int, *, width: int = 17, height: int = 33) -> GaussianScene:
    """Gaussians straight before a camera at the origin that is not turned, in one line of sight."""
    g = torch.Generator().manual_seed(count)
    camera = camera_at(width, height, turn=0.0)
    means = torch.zeros(count, 3)
    means[:, 2] = 2 + torch.arange(count) / max(count, 1)
    return GaussianScene(
        camera=camera, means=means, quaternions=torch.randn(count, 4, generator=g),
        scales=torch.full((count, 3), 0.2), opacities=torch.full((count,), 0.5),
        sh=torch.randn(count, 4, 3, generator=g) * 0.2,
    )  # fmt: skip


def needle(scene: GaussianScene) -> GaussianScene:
    scales = scene.scales.clone()
    scales[:, 0], scales[:, 1:] = 1.0, 1e-4
    return scene.but(scales=scales)


def put(scene: GaussianScene, name: str, rows, values) -> GaussianScene:
    changed = getattr(scene, name).clone()
    changed[rows] = torch.as_tensor(values)
    return scene.but(**{name: changed})


def behind_the_near_plane() -> GaussianScene:
    scene = facing(6)
    near = scene.camera.near
    z = torch.tensor([near * 1.001, near * 1.5, near * 0.999, 0.0, -1.0, 1.0])
    return scene.but(means=torch.stack([0.001 * z, -0.001 * z, z], dim=1))


def ties(count: int, gap: float) -> GaussianScene:
    scene = facing(count, width=9, height=9)
    xy = (torch.rand(count, 2, generator=torch.Generator().manual_seed(1)) - 0.5) * 2
    z = torch.full((count, 1), 2.0)
    z[::2] += gap
    return scene.but(
        means=torch.cat([xy, z], dim=1), opacities=torch.full((count,), 0.03),
        scales=torch.full((count, 3), 0.3),
    )  # fmt: skip


ULP = float(torch.finfo(torch.float32).eps) * 2
CASES = {
    "needle": lambda: needle(random_scene(40, 1)),
    "disc": lambda: put(random_scene(40, 2), "scales", (slice(None), 2), 1e-7),
    "point": lambda: put(random_scene(40, 3), "scales", slice(None), 1e-7),
    "scale zero": lambda: put(random_scene(40, 3), "scales", slice(None), 0.0),
    "huge": lambda: put(random_scene(40, 4), "scales", 1, 500.0),
    "quaternion small": lambda: put(random_scene(40, 5), "quaternions", 1, [1e-6, 2e-6, 0, 1e-6]),
    "quaternion large": lambda: put(random_scene(40, 5), "quaternions", 1, [1e6, 2e6, 0, 1e6]),
    "quaternion zero": lambda: put(random_scene(40, 5), "quaternions", slice(None), 0.0),
    "near plane": behind_the_near_plane,
    "behind": lambda: put(random_scene(40, 6), "means", (slice(None), 2), -5.0),
    "camera centre": lambda: put(facing(5), "means", 2, 0.0),
    "far to the side": lambda: put(random_scene(40, 7), "means", (slice(0, 20), 0), 1e6),
    "image 1x1": lambda: random_scene(40, 8, width=1, height=1),
    "image 17x33": lambda: random_scene(40, 8, width=17, height=33),
    "image 65x16": lambda: random_scene(40, 8, width=65, height=16),
    "opacity nearly 1": lambda: put(random_scene(40, 9), "opacities", slice(None), 1 - 1e-7),
    "opacity 1": lambda: put(random_scene(40, 9), "opacities", slice(None), 1.0),
    "opacity 0": lambda: put(random_scene(40, 9), "opacities", slice(None), 0.0),
    "opacity tiny": lambda: put(random_scene(40, 9), "opacities", slice(None), 1e-12),
    "opacity 1/255": lambda: put(random_scene(40, 9), "opacities", slice(None), 1 / 255),
    "10,000 faint": lambda: put(facing(10_000, width=3, height=3), "opacities", slice(None), 0.005),
    "10,000 opaque": lambda: put(facing(10_000, width=3, height=3), "opacities", slice(None), 1.0),
    "opaque one first": lambda: put(facing(50), "opacities", 0, 1.0),
    "1,000 ties": lambda: ties(1000, 0.0),
    "depths one ulp apart": lambda: ties(1000, ULP),
    "no Gaussian": lambda: random_scene(0, 10),
    "one Gaussian": lambda: facing(1),
    "all culled": lambda: put(random_scene(10, 11), "means", (slice(None), 2), -50.0),
    "large harmonics": lambda: put(random_scene(40, 12), "sh", slice(None), random_scene(40, 3).sh * 50),
}  # fmt: skip
# A needle 100 px long has its direction rounded to float32 when blended: 1e-7 * 100 px / 0.5 px.
TOLERANCE = {"needle": 5e-5}


def render(rasterize, scene: GaussianScene, dtype: torch.dtype, weights, mode: str):
    leaves = scene.arguments(dtype)
    out = rasterize(scene.camera, *leaves[:4], sh=leaves[4], mode=mode)
    loss = (out.colour * weights.to(dtype)).sum() + (out.alpha * weights[..., 0].to(dtype)).sum()
    loss = loss + (out.depth * weights[..., 1].to(dtype)).sum()
    if loss.requires_grad:
        loss.backward()
    return out, [torch.zeros_like(p) if p.grad is None else p.grad for p in leaves]


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("case", CASES)
def test_case(case, mode):
    scene = CASES[case]()
    steps = step_pixels(
        scene.camera, *(v.double() for v in scene.arguments(torch.float32)[:4]), mode=mode
    )
    g = torch.Generator().manual_seed(3)
    weights = torch.randn(scene.camera.height, scene.camera.width, 3, generator=g)
    weights[steps] = 0
    out, gradients = render(native.rasterize, scene, torch.float32, weights, mode)
    truth, true_gradients = render(reference.rasterize, scene, torch.float64, weights, mode)
    tolerance = TOLERANCE.get(case, 2e-5)
    for name in ("colour", "alpha", "depth"):
        value, wanted = getattr(out, name).detach(), getattr(truth, name).detach()
        relative = tolerance * max(1.0, float(wanted.abs().max()) if wanted.numel() else 0)
        assert largest_error(value, wanted, ignore=steps) <= relative, name
    scale = max(float(t.norm()) for t in true_gradients)
    for value, wanted in zip(gradients, true_gradients, strict=True):
        assert torch.isfinite(value).all()
        assert compare_gradients(value, wanted, floor=1e-6 * scale).good(), compare_gradients(
            value, wanted
        )


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
