"""From facts, a machine's speed and a budget to settings, each with its reason."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from splatproof.methods.auto.base import Base
from splatproof.methods.auto.bounds import most_gaussians, training_mb
from splatproof.methods.auto.candidates import unopposed
from splatproof.methods.auto.choices import Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.rows import Made, blocks, rows
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed
from splatproof.methods.auto.steps import most_steps, steps_in
from splatproof.methods.auto.usual import PACE, by_larger_steps
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings


@dataclass(frozen=True, kw_only=True)
class AutoPlan:
    """Settings for one scene, machine and budget, and the reasons."""

    settings: Settings
    base: Base
    """Method whose model is trained: `splatproof.methods.auto.base` says what follows of the settings."""
    choices: tuple[Choice, ...]
    seconds: float
    """Wall seconds that training is expected to take."""


def plan(
    asked: AutoSettings,
    facts: SceneFacts,
    settings: Settings,
    choices: Sequence[Choice],
    speed: Speed,
    seconds: float,
    free: float = math.inf,
    base: Base = "3dgs",
    image_bytes: int = Run.image_bytes,
) -> AutoPlan:
    """Number of Gaussians and of steps for the seconds that are left.

    Args:
        asked: The budget, and what is fixed.
        facts: What was measured.
        settings: What has been chosen.
        choices: Why.
        speed: How fast this machine trains such photos.
        seconds: Wall seconds that training may take.
        free: Megabytes of this machine's memory that are free; inf: not known, memory bounds nothing.
        base: What is trained.
        image_bytes: Bytes for photos in memory.
    """
    most, cap = most_gaussians(asked, facts, settings.sh_degree, free, image_bytes)
    if base == "stratosplat" and facts.points > most:
        most, cap = facts.points, "one for each completed point"
    pace = asked.pace or PACE
    settings = replace(settings, density=replace(settings.density, most=most, pace=pace))
    if asked.steps is None:
        count, reason = _counted(facts, settings, speed, seconds, base)
    else:
        count, reason = asked.steps, "given"
    settings = replace(settings, iterations=count)
    made = Made(
        asked=asked, facts=facts, settings=settings, base=base, speed=speed, seconds=seconds,
        cap=cap, steps=reason,
    )  # fmt: skip
    if base == "3dgs" and not made.by_heart:
        settings = by_larger_steps(settings, asked, facts.exposure)
        made = replace(made, settings=settings)
    told = list(choices)
    components = {choice.component for choice in choices}
    if "exposure" not in components:
        told.append(unopposed(asked, settings, facts))
    if math.isfinite(free):
        wanted, _ = most_gaussians(asked, facts, settings.sh_degree, math.inf)
        needed = training_mb(facts, wanted, settings.sh_degree, image_bytes)
        told.append(blocks(needed, free))
    told.extend(rows(made, sized="resolution" in components))
    return AutoPlan(settings=settings, base=base, choices=tuple(told), seconds=made.takes())


def _counted(
    facts: SceneFacts, settings: Settings, speed: Speed, seconds: float, base: Base
) -> tuple[int, str]:
    """Number of steps that fit and pay, and why."""
    count = steps_in(seconds, settings, facts, speed)
    most, enough = most_steps(settings, facts.views, base)
    if count > most:
        return most, enough
    start = min(facts.points, settings.most_points or facts.points)
    return count, (
        f"{max(0.0, seconds):.0f} s are left; a step takes {1e3 * speed.step(float(start)):.1f} ms at full size "
        f"with {start:,} points"
    )
