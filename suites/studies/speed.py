"""`bench run speed`: time and error of everything that has a twin."""

import os
import resource
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatbench import _ext
from splatbench.methods.kernels import adam as native_adam
from splatbench.methods.kernels import loss as native_loss
from splatbench.methods.kernels import rasterizer as native
from splatbench.reference import losses as reference_losses
from splatbench.reference import rasterizer as reference
from splatbench.reference.agreement import compare_gradients, largest_error
from splatbench.reference.steps import step_pixels
from splatbench.suites.studies.speed_scenes import speed_scene

DISTURBED = 5.0
"""Percent of a core that other processes may use before a row is marked."""
SMALL = (300, 64, 48)
"""Count, width and height of the scene that the dense float64 reference judges rasterizers on."""
Call = Callable[[], Any]


@dataclass(frozen=True, kw_only=True)
class Twin:
    """One implementation on one case."""

    component: str
    twin: str
    case: str
    forward: Call
    backward: Callable[[Any], Any] | None
    """Called with what `forward` returned."""
    error: dict[str, Any]
    """max_abs_error, grad_rel_l2, step_pixels, error_case."""
    level: str | None = None
    """SIMD level to run at; None: the one in use."""


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """A row a twin and case; medians of interleaved runs on the threads that torch has.

    Keys: component, twin, case, forward_ms, backward_ms, max_abs_error, grad_rel_l2, step_pixels,
    peak_mb (of the process so far), disturbed_percent (share of a core that other processes used
    while the case was timed, nan where the system does not tell), error_case (what the errors were
    measured on), ok (the errors are within 2e-5 and 1e-3), note.

    Args:
        quick: 2,000 and 20,000 Gaussians at 320x240 only, fewer repetitions.
    """
    small = ((2_000, 320, 240), (20_000, 320, 240))
    cases = small if quick else (small[1], (100_000, 320, 240), (100_000, 800, 600))
    repeats = 5 if quick else 15
    for case in cases:
        yield from timed(rasterizers(*case), repeats)
    yield from timed(losses(320, 240), repeats)
    yield from timed(optimizers(10_000), repeats)


def rasterizers(count: int, width: int, height: int) -> list[Twin]:
    """The native rasterizer at each SIMD level, from activated parameters."""
    scene, gradient = speed_scene(count, width, height)

    def forward() -> Tensor:
        leaves = scene.arguments(torch.float32)
        return native.rasterize(scene.camera, *leaves[:4], sh=leaves[4]).colour

    return [
        Twin(component="rasterizer", twin=f"cpu {level}", case=f"{count} {width}x{height}",
             forward=forward, backward=lambda image: image.backward(gradient), level=level,
             error=rasterizer_error(level))
        for level in _ext.simd_levels()
    ]  # fmt: skip


def rasterizer_error(level: str) -> dict[str, Any]:
    """Error of the native rasterizer against the float64 reference on the small scene."""
    scene, gradient = speed_scene(*SMALL)
    steps = step_pixels(
        scene.camera, *(v.double() for v in scene.arguments(torch.float32)[:4]), mode="classic"
    )
    gradient[steps] = 0
    results = []
    for rasterize, dtype in (
        (reference.rasterize, torch.float64),
        (native.rasterize, torch.float32),
    ):
        leaves = scene.arguments(dtype)
        with simd_level(level):
            image = rasterize(scene.camera, *leaves[:4], sh=leaves[4]).colour
            image.backward(gradient.to(dtype))
        results.append((image.detach(), [leaf.grad for leaf in leaves]))
    (truth, true_gradients), (value, gradients) = results
    return {
        "max_abs_error": largest_error(value, truth, ignore=steps),
        "grad_rel_l2": max(compare_gradients(a, b).relative_l2
                           for a, b in zip(gradients, true_gradients, strict=True)),
        "step_pixels": int(steps.sum()),
        "error_case": "{} Gaussians {}x{}".format(*SMALL),
    }  # fmt: skip


class simd_level:
    """Run at another SIMD level inside; None changes nothing."""

    def __init__(self, name: str | None) -> None:
        """Remember the level to use."""
        self.name, self.before = name, _ext.simd_level()

    def __enter__(self) -> None:
        """Switch to the level."""
        _ext.set_simd_level(self.name or self.before)

    def __exit__(self, *error: object) -> None:
        """Switch back."""
        _ext.set_simd_level(self.before)


def losses(width: int, height: int) -> list[Twin]:
    """L1 + SSIM in torch float32 and native."""
    generator = torch.Generator().manual_seed(0)
    image, truth = (torch.rand(height, width, 3, generator=generator) for _ in range(2))

    def run(function: Callable[..., Tensor], dtype: torch.dtype) -> tuple[Tensor, Tensor | None]:
        leaf = image.to(dtype, copy=True).requires_grad_()  # a leaf of its own
        value = function(leaf, truth.to(dtype))
        value.backward()
        return value.detach(), leaf.grad

    true_value, true_gradient = run(reference_losses.photometric, torch.float64)
    assert true_gradient is not None
    twins = []
    functions = {"torch": reference_losses.photometric, "native": native_loss.photometric}
    for name, function in functions.items():
        value, gradient = run(function, torch.float32)
        assert gradient is not None
        error = {
            "max_abs_error": float((value.double() - true_value).abs()), "step_pixels": 0,
            "grad_rel_l2": compare_gradients(gradient, true_gradient).relative_l2,
            "error_case": "the same",
        }  # fmt: skip
        twins.append(
            Twin(component="loss", twin=name, case=f"{width}x{height}", error=error,
                 forward=lambda f=function: f(image.clone().requires_grad_(), truth),
                 backward=lambda value: value.backward())
        )  # fmt: skip
    return twins


def optimizers(count: int) -> list[Twin]:
    """Adam's update of 59 numbers a Gaussian in torch and native, float32."""
    generator = torch.Generator().manual_seed(0)
    start, gradient = (torch.randn(count, 59, generator=generator) for _ in range(2))

    def torchs(dtype: torch.dtype) -> tuple[Tensor, Call]:
        value = torch.nn.Parameter(start.to(dtype, copy=True))
        value.grad = gradient.to(dtype)
        return value, torch.optim.Adam([value], lr=1e-2, eps=native_adam.EPSILON).step

    def natives() -> tuple[Tensor, Call]:
        value, first, second = start.clone(), torch.zeros_like(start), torch.zeros_like(start)
        return value, lambda: native_adam.step([value], [gradient], [first], [second], [1e-2], 1)

    truth, update = torchs(torch.float64)
    update()
    twins = []
    for name, (value, step) in {"torch": torchs(torch.float32), "native": natives()}.items():
        step()
        error = float((value.detach().double() - truth.detach()).abs().max())
        twins.append(
            Twin(component="adam", twin=name, case=f"{count} x 59", forward=step, backward=None,
                 error={"max_abs_error": error, "grad_rel_l2": 0.0, "step_pixels": 0,
                        "error_case": "the first update"})
        )  # fmt: skip
    return twins


def timed(twins: list[Twin], repeats: int) -> Iterator[dict[str, Any]]:
    """Rows of twins that take turns; the first round is not counted."""
    forward: list[list[float]] = [[] for _ in twins]
    backward: list[list[float]] = [[] for _ in twins]
    busy, own, wall = busy_seconds(), time.process_time(), time.perf_counter()
    for _ in range(repeats + 1):
        for i, twin in enumerate(twins):
            with simd_level(twin.level):
                start = time.perf_counter()
                made = twin.forward()
                middle = time.perf_counter()
                if twin.backward is not None:
                    twin.backward(made)
                end = time.perf_counter()
            forward[i].append(1e3 * (middle - start))
            backward[i].append(1e3 * (end - middle) if twin.backward else 0.0)
    others = busy_seconds() - busy - (time.process_time() - own)
    percent = max(0.0, 100 * others / (time.perf_counter() - wall))
    note = f"disturbed by other processes: {percent:.0f} % of a core" if percent > DISTURBED else ""
    for i, twin in enumerate(twins):
        error = twin.error
        yield {
            "component": twin.component, "twin": twin.twin, "case": twin.case,
            "forward_ms": statistics.median(forward[i][1:]),
            "backward_ms": statistics.median(backward[i][1:]), **error,
            "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            "disturbed_percent": percent,
            "ok": error["max_abs_error"] <= 2e-5 and error["grad_rel_l2"] <= 1e-3, "note": note,
        }  # fmt: skip


def busy_seconds() -> float:
    """CPU seconds that all processes have used since the machine started; nan if not told."""
    path = Path("/proc/stat")
    if not path.exists():
        return float("nan")
    ticks = [int(x) for x in path.read_text().split("\n", 1)[0].split()[1:9]]
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK")
