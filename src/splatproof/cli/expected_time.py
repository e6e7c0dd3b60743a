"""What is said before a fit: how long it will probably take, and how a first look is had where that is long."""

from dataclasses import replace
from typing import TYPE_CHECKING

from splatproof.viewing.poses import resized

if TYPE_CHECKING:
    from splatproof.reference.types.scene import Scene
    from splatproof.suites.suite_files import Case

LONG = 600.0
"""Seconds from which somebody who waits should know that there is a shorter way."""
SPREAD = 3.0
"""Factor between the shortest and the longest time that is told: how fast Gaussians multiply is not known
before. A first look at 24 photos of a yard took 2.3 times what was estimated (112 CPU seconds)."""
FIRST_STEPS, FIRST_WIDTH = 2_000, 320
"""Steps and pixels across of a first look: minutes on a laptop, and enough to see whether photos and
poses are good."""


def expected_time(case: "Case", scene: "Scene", backend: str) -> str:
    """One line: steps, photos, probable time, and what would be quicker where that is long.

    Args:
        case: What is about to be trained.
        scene: Opened under the case's protocol.
        backend: Name of the rasterizer.
    """
    from splatproof.suites.environment import usable_cores
    from splatproof.suites.estimate import estimate

    widest = max((scene.views[index].camera for index in scene.train), key=lambda one: one.width)
    steps = getattr(case.settings, "iterations", None)
    seconds = estimate(case, scene, backend).seconds
    line = (
        f"{f'{steps} steps over ' if steps else ''}{len(scene.train)} photos of {widest.width} x "
        f"{widest.height} pixels: {_between(seconds)} on {usable_cores()} idle cores"
    )
    return line + _quicker(case, scene, backend, seconds)


def _quicker(case: "Case", scene: "Scene", backend: str, seconds: float) -> str:
    """How a first look is had, and how long that takes; empty where it would save little."""
    from splatproof.suites.estimate import estimate

    settings = case.settings
    if seconds < LONG or not hasattr(settings, "iterations"):
        return ""
    few = replace(settings, iterations=min(FIRST_STEPS, settings.iterations))
    views = tuple(
        replace(view, camera=resized(view.camera, min(FIRST_WIDTH, view.camera.width)))
        for view in scene.views
    )
    quick = estimate(replace(case, settings=few), replace(scene, views=views), backend).seconds
    if quick > seconds / 2:
        return ""
    return f"; a first look in {_between(quick)}: --width {FIRST_WIDTH} --iterations {FIRST_STEPS}"


def _between(seconds: float) -> str:
    return f"{in_words(seconds)} to {in_words(SPREAD * seconds)}"


def in_words(seconds: float) -> str:
    """A time as people say it, for what is known roughly.

    >>> [in_words(value) for value in (4.2, 88.0, 5700.0, 108e3)]
    ['4 seconds', '88 seconds', '95 minutes', '30 hours']
    """
    for unit, size in (("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} seconds"
