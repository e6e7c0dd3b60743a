"""Ladders: one difficulty of a component raised rung by rung, to see how its twins' errors grow."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import torch

from splatproof.reference.types.camera import Camera
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene
from splatproof.suites.studies.speed.judge import judge
from splatproof.suites.twins.random_scenes import speed_scene
from splatproof.suites.twins.ranks import TEMPERATURE
from splatproof.suites.twins.rasterizers import activated_scene
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.stored import harmonics
from splatproof.suites.twins.twin import Problem


def decades(first: int, last: int, step: int = 1) -> tuple[float, ...]:
    """Powers of ten from 10^first to 10^last.

    Args:
        first: Exponent of the first.
        last: Exponent of the last, a rung itself if the step hits it.
        step: Decades between two rungs.
    """
    return tuple(10.0**power for power in range(first, last + 1, step))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ladder:
    """A difficulty of a component that a number says, and what the twins may be off at each."""

    component: str
    """Name in splatproof.suites.twins.registry."""
    name: str
    """What the number is, for people."""
    rungs: tuple[float, ...]
    """The numbers, hardest last."""
    problem: Callable[[float], Problem]
    """The component's input at a rung."""
    plain: Callable[[float], float] = lambda rung: 1.0
    """Times its budgets that the plain twin, the equations as they are written, may be off at a rung:
    it computes in float32 throughout."""
    reason: str = ""
    """Why that is so."""


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """A row a ladder, rung and twin that approximates nothing; keys as those of the other cases.

    Besides: `ladder`, its name, and `hardness`, the rung.

    Args:
        quick: The first, middle and last rung of each ladder alone.
    """
    for ladder in LADDERS:
        some = (ladder.rungs[0], ladder.rungs[len(ladder.rungs) // 2], ladder.rungs[-1])
        for rung in some if quick else ladder.rungs:
            yield from climbed(ladder, rung)


def climbed(ladder: Ladder, rung: float) -> Iterator[dict[str, Any]]:
    """The rows of one rung.

    Args:
        ladder: The difficulty.
        rung: How difficult.
    """
    component = COMPONENTS[ladder.component]
    found = judge(component, ladder.problem(rung))
    for twin in component.twins:
        if twin.approximates:
            continue
        more = ladder.plain(rung) if twin.name.startswith("torch") else 1.0
        errors, budget = found[twin.name], more * component.max_abs_error
        error, off = errors["max_abs_error"] / errors["scale"], errors["grad_rel_l2"] or 0.0
        finite = math.isfinite(error) and math.isfinite(off)
        yield {
            "component": ladder.component, "case": f"{ladder.name} {rung:g}",
            "implementation": twin.name, "ladder": ladder.name, "hardness": rung,
            "expect": "finite", "budget": budget, "finite": finite, "max_abs_error": error,
            "grad_rel_l2": off, "discontinuity_pixels": errors["discontinuity_pixels"],
            "ok": finite and error <= budget and off <= more * component.grad_rel_l2,
            "note": ladder.reason if more > 1 else "",
        }  # fmt: skip


def _scene(change: Callable[[GaussianScene, float], GaussianScene]) -> Callable[[float], Problem]:
    def problem(rung: float) -> Problem:
        scene, gradient = speed_scene(*COMPONENTS["rasterizer"].tiny)
        return activated_scene(change(scene, rung), gradient)

    return problem


def _leaf(component: str, name: str, change: Callable[[torch.Tensor, float], torch.Tensor]):
    def problem(rung: float) -> Problem:
        plain = COMPONENTS[component].problem(COMPONENTS[component].tiny)
        return replace(plain, leaves=plain.leaves | {name: change(plain.leaves[name], rung)})

    return problem


def _needles(scene: GaussianScene, ratio: float) -> GaussianScene:
    """The longest axis stays, the others are `ratio` times as short."""
    longest = scene.scales.amax(dim=1, keepdim=True)
    narrow = (longest / ratio).expand(-1, 2)
    return scene.but(scales=torch.cat([longest, narrow], dim=1).contiguous())


def _away(scene: GaussianScene, distance: float) -> GaussianScene:
    """Scene and camera moved together; both are rounded before any twin or the truth sees them."""
    shift = distance * torch.tensor([0.6, -0.48, 0.64], dtype=torch.float64)
    means = (scene.means.double() + shift).float()
    pose = scene.camera.world_to_camera.clone()
    pose[:3, 3] -= pose[:3, :3] @ shift
    return scene.but(means=means, camera=replace(scene.camera, world_to_camera=pose))


def _photo(rung: float) -> Problem:
    """Image and truth that differ by 1 part in `rung` of what they usually do."""
    plain = COMPONENTS["loss"].problem(COMPONENTS["loss"].tiny)
    truth = plain.given["truth"]
    close = truth + (plain.leaves["image"] - truth) / rung
    return replace(plain, leaves={"image": close})


def _apart(rung: float) -> Problem:
    """Anchors and camera that lie `rung` times as far apart; what is decoded is in their own units."""
    plain = COMPONENTS["anchors"].problem(COMPONENTS["anchors"].tiny)
    return replace(plain, given={name: rung * value for name, value in plain.given.items()})


def _close(rung: float) -> Problem:
    """As `_photo`, for SSIM as a metric."""
    plain = COMPONENTS["ssim"].problem(COMPONENTS["ssim"].tiny)
    truth = plain.given["truth"]
    return replace(plain, leaves={"image": truth + (plain.leaves["image"] - truth) / rung})


def _weak(rung: float) -> Problem:
    """An update by a gradient `rung` times as small: Adam's own size of a step does not follow it."""
    plain = COMPONENTS["adam"].problem(COMPONENTS["adam"].tiny)
    return replace(plain, given={"gradient": plain.given["gradient"] / rung})


def _stark(rung: float) -> Problem:
    """A photo with `rung` times the contrast: in the end no two pixels exchange anything."""
    plain = COMPONENTS["edge diffusion"].problem(COMPONENTS["edge diffusion"].tiny)
    return replace(plain, given={name: rung * value for name, value in plain.given.items()})


def _remote(rung: float) -> Problem:
    """A memory and a view that lie `rung` away from the origin."""
    plain = COMPONENTS["guide depth"].problem(COMPONENTS["guide depth"].tiny)
    shift = rung * torch.tensor([0.6, -0.48, 0.64], dtype=torch.float64)

    def moved(camera: Camera) -> Camera:
        pose = camera.world_to_camera.clone()
        pose[:3, 3] -= pose[:3, :3] @ shift
        return replace(camera, world_to_camera=pose)

    memory, view = plain.given["memory"], plain.given["camera"]
    away = replace(memory, camera=moved(memory.camera), positions=memory.positions + shift)
    return replace(plain, given={"memory": away, "camera": moved(view)})


def _fine(rung: float) -> Problem:
    """Colours of codes `rung` times as far apart: less and less room for their fractions in float32."""
    return harmonics(COMPONENTS["stored harmonics"].tiny, rung)


LADDERS = (
    Ladder(component="rasterizer", name="longest axis / shortest", rungs=decades(1, 6),
           problem=_scene(_needles)),
    Ladder(component="rasterizer", name="times as large", rungs=decades(0, 6),
           problem=_scene(lambda s, h: s.but(scales=s.scales * h))),
    Ladder(component="rasterizer", name="times as small", rungs=decades(0, 8, 2),
           problem=_scene(lambda s, h: s.but(scales=s.scales / h))),
    Ladder(component="rasterizer", name="1 / (1 - opacity)", rungs=decades(1, 7),
           problem=_scene(lambda s, h: s.but(opacities=torch.full_like(s.opacities, 1 - 1 / h)))),
    Ladder(component="rasterizer", name="distance from the origin", rungs=decades(0, 6),
           problem=_scene(_away), plain=lambda rung: max(1.0, rung / 5),
           reason="means less the camera's centre, both rounded to float32: off by 1e-7 of the distance"),
    Ladder(component="rasterizer", name="times the harmonics", rungs=decades(0, 6),
           problem=_scene(lambda s, h: s.but(sh=s.sh * h))),
    Ladder(component="fragments", name="times as large", rungs=decades(0, 6),
           problem=_leaf("fragments", "scales", torch.mul)),
    # at 16 the derivative of every float32 sigmoid is off by 5 %: 1 - opacity is rounded to 6e-8
    Ladder(component="pipeline", name="opacity logit", rungs=(1.0, 2.0, 4.0, 8.0),
           problem=_leaf("pipeline", "opacity_logits", torch.add)),
    Ladder(component="ssim", name="times as alike", rungs=decades(0, 6), problem=_close),
    Ladder(component="adam", name="times as weak a gradient", rungs=decades(0, 20, 5), problem=_weak),
    Ladder(component="stitching", name="opacity logit", rungs=(1.0, 4.0, 8.0, 16.0),
           problem=_leaf("stitching", "opacity_logits", torch.add)),
    Ladder(component="loss", name="times as alike", rungs=decades(0, 6), problem=_photo),
    Ladder(component="anchors", name="times as far apart", rungs=decades(0, 6), problem=_apart),
    Ladder(component="hierarchy", name="times as short a life", rungs=decades(0, 4),
           problem=_leaf("hierarchy", "log_spans", lambda v, h: v - math.log(h))),
    # from 10^4 on every float32 sine of where a child stands is off: the code has it times 8
    Ladder(component="hierarchy", name="times as large an anchor", rungs=decades(0, 3),
           problem=_leaf("hierarchy", "log_scales", lambda v, h: v + math.log(h))),
    Ladder(component="edge diffusion", name="times the contrast", rungs=decades(-3, 6), problem=_stark),
    Ladder(component="guide depth", name="distance of the memory", rungs=decades(0, 5), problem=_remote),
    Ladder(component="coordinate field", name="times the features", rungs=decades(0, 6),
           problem=_leaf("coordinate field", "grid_3", torch.mul)),
    Ladder(component="stored harmonics", name="times the codes", rungs=decades(0, 4), problem=_fine),
    Ladder(component="soft rank", name="spread / temperature", rungs=decades(0, 8, 2),
           problem=_leaf("soft rank", "values", lambda v, h: v * h * TEMPERATURE)),
)  # fmt: skip
