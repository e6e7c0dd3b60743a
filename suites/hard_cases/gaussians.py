"""Hard cases of projection and rasterizer, and every backend's error on them."""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.contracts.backends import get_backend
from splatproof.reference.checks.agreement import compare_gradients, largest_error
from splatproof.reference.checks.discontinuities import discontinuity_pixels
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene, camera_at, random_scene


def facing(count: int, *, width: int = 17, height: int = 33) -> GaussianScene:
    """Gaussians straight before a camera at the origin that is not turned, in one line of sight.

    Args:
        count: Number of Gaussians, >= 0; also the seed of their colours.
        width: Pixels of a row.
        height: Rows of pixels.
    """
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
    """Scale ratio 1e4 : 1."""
    scales = scene.scales.clone()
    scales[:, 0], scales[:, 1:] = 1.0, 1e-4
    return scene.but(scales=scales)


def put(scene: GaussianScene, name: str, rows: Any, values: Any) -> GaussianScene:
    """The scene with some rows of one parameter set.

    Args:
        scene: Scene that is left as it is.
        name: Name of the parameter.
        rows: Indices or mask of the Gaussians.
        values: What they get.
    """
    changed = getattr(scene, name).clone()
    changed[rows] = torch.as_tensor(values)
    return scene.but(**{name: changed})


def behind_the_near_plane() -> GaussianScene:
    """Means just before and just behind the near plane, at and behind the camera."""
    scene = facing(6)
    near = scene.camera.near
    z = torch.tensor([near * 1.001, near * 1.5, near * 0.999, 0.0, -1.0, 1.0])
    return scene.but(means=torch.stack([0.001 * z, -0.001 * z, z], dim=1))


def cropped(scene: GaussianScene) -> GaussianScene:
    """The same photo's part that begins one and a quarter widths right of the principal point.

    Args:
        scene: Scene that is left as it is.
    """
    camera, K = scene.camera, scene.camera.K.clone()
    beside = 1.25 * camera.width
    K[0, 2] = -beside
    means = (scene.means.double() @ camera.rotation.T) + camera.translation
    means[:, 0] += (beside + 0.5 * camera.width) / K[0, 0] * means[:, 2]
    means = (means - camera.translation) @ camera.rotation
    return scene.but(camera=replace(camera, K=K), means=means.float())


def ties(count: int, gap: float) -> GaussianScene:
    """Faint coplanar Gaussians; every other one lies `gap` behind.

    Args:
        count: Number of Gaussians.
        gap: Distance in depth between the two planes, scene units; 0: one plane.
    """
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
    "cropped far from the axis": lambda: cropped(random_scene(40, 7)),
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
BUDGET = {"needle": 5e-5}
"""Where not 2e-5 relative: a needle 100 px long has its direction rounded to float32 when blended,
1e-7 * 100 px / 0.5 px."""
LONG = ("10,000 faint", "10,000 opaque", "1,000 ties", "depths one ulp apart")
"""Left out by --quick."""


def render(
    rasterize: Callable[..., Any],
    scene: GaussianScene,
    dtype: torch.dtype,
    weights: Tensor,
    mode: Mode,
) -> tuple[Any, list[Tensor]]:
    """Image, and gradients of a random weighting of colour, alpha and depth.

    Args:
        rasterize: Function with the signature of the reference's rasterizer.
        scene: Gaussians and the camera that looks at them.
        dtype: Precision of the parameters.
        weights: Weight of each value of the image, height x width x 3.
        mode: How opacities are filtered, as for the rasterizer.
    """
    leaves = scene.arguments(dtype)
    out = rasterize(scene.camera, *leaves[:4], sh=leaves[4], mode=mode)
    loss = (out.colour * weights.to(dtype)).sum() + (out.alpha * weights[..., 0].to(dtype)).sum()
    loss = loss + (out.depth * weights[..., 1].to(dtype)).sum()
    if loss.requires_grad:
        loss.backward()
    return out, [torch.zeros_like(p) if p.grad is None else p.grad for p in leaves]


def judge(case: str, implementation: str, mode: Mode = "classic") -> dict[str, Any]:
    """One implementation on one case against the float64 reference.

    Pixels at a discontinuity of the definition are counted and left out of errors and gradients.

    Args:
        case: Key of CASES.
        implementation: Name of a backend.
        mode: As for the rasterizer.
    """
    scene = CASES[case]()
    ignored = discontinuity_pixels(scene.camera, *(v.double() for v in scene.arguments(torch.float32)[:4]),
                        mode=mode)  # fmt: skip
    generator = torch.Generator().manual_seed(3)
    weights = torch.randn(scene.camera.height, scene.camera.width, 3, generator=generator)
    weights[ignored] = 0
    start = time.perf_counter()
    out, gradients = render(
        get_backend(implementation).rasterize, scene, torch.float32, weights, mode
    )
    ms = 1e3 * (time.perf_counter() - start)
    truth, true_gradients = render(reference.rasterize, scene, torch.float64, weights, mode)
    error = 0.0
    for name in ("colour", "alpha", "depth"):
        value, wanted = getattr(out, name).detach(), getattr(truth, name).detach()
        scale = max(1.0, float(wanted.abs().max()) if wanted.numel() else 0)
        error = max(error, largest_error(value, wanted, ignore=ignored) / scale)
    floor = 1e-6 * max(float(t.norm()) for t in true_gradients)
    agreements = [
        compare_gradients(value, wanted, floor=floor)
        for value, wanted in zip(gradients, true_gradients, strict=True)
    ]
    finite = all(bool(torch.isfinite(g).all()) for g in gradients)
    budget = BUDGET.get(case, 2e-5)
    good = finite and error <= budget and all(agreement.good() for agreement in agreements)
    return {
        "component": "rasterizer", "case": case, "implementation": f"{implementation} float32 {mode}",
        "expect": "finite", "budget": budget, "discontinuity_pixels": int(ignored.sum()), "finite": finite,
        "max_abs_error": error, "grad_rel_l2": max(a.relative_l2 for a in agreements), "ms": ms,
        "ok": good, "note": "",
    }  # fmt: skip


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """Every case through the reference in float32 and the native backend, both modes."""
    for case in CASES:
        if quick and case in LONG:
            continue
        for mode in ("classic", "antialiased"):
            for implementation in ("reference", "cpu"):
                yield judge(case, implementation, mode)
