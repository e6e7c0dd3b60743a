"""How many steps a training pays for, and how many fit into so many seconds."""

import math

from splatproof.methods.auto.base import Base
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.speed import Speed
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density_control import shrunk
from splatproof.methods.training.schedules import restarts

GROWTH_A_PASS = 1.25
"""Largest factor by which a densification is taken to raise the number of Gaussians."""
COMPLETED_STEPS = 1000
"""Steps from completed depths after which nothing more is gained: from six photos of caliterra and of brighton_beach 24.7
and 17.5 dB after 400 steps as after 800."""
FEW_STEPS = 3000
"""Steps that a run may have however few its photos: Gaussians are not there yet when six photos have been looked at
`MOST_VISITS` times. Held-out photos, one seed, 1,500, 3,000 and 6,000 steps from six photos: caliterra 22.9, 24.7 and
24.5 dB, brighton_beach 17.7, 18.1 and 17.8, courtyard (1,500 and 3,000) 22.8 and 22.8; from three of aerial-sparse/town
21.7 and 21.9."""
LEAST_STEPS, MOST_STEPS = 100, 30_000
"""Steps of the shortest run that is planned, and of the longest."""
MOST_VISITS = 250
"""How often a training photo is looked at, at most: what is learnt after that is these photos by heart. Held-out
training photos of brighton_beach at 250 px, one seed: 20.2 dB after 80 visits, 20.0 dB after 400; photos of
aerial-sparse/town: 27.5 dB after 200, 27.6 dB after 425."""


def most_steps(settings: Settings, views: int, base: Base = "3dgs") -> tuple[int, str]:
    """Most steps that pay, and why: each photo looked at `MOST_VISITS` times, all together `FEW_STEPS` times.

    Args:
        settings: Views a step.
        views: Number of training photos.
        base: What is trained.
    """
    if base == "stratosplat":
        looks, why = COMPLETED_STEPS, "more gain nothing from completed depths"
    else:
        looks = max(MOST_VISITS * views, FEW_STEPS)
        why = "in more these photos would be learnt by heart"
    return min(MOST_STEPS, max(LEAST_STEPS, looks // settings.views_per_step)), why


def steps_in(
    seconds: float, settings: Settings, facts: SceneFacts, speed: Speed, least: int = LEAST_STEPS
) -> int:
    """Most steps whose training takes no longer than so many seconds.

    Args:
        seconds: Wall seconds.
        settings: What is trained.
        facts: Start points and photos.
        speed: How fast steps are.
        least: What is returned where fewer would fit.
    """
    low, high = least, MOST_STEPS
    while low < high:
        middle = (low + high + 1) // 2
        if training_seconds(settings, facts, speed, middle) <= seconds:
            low = middle
        else:
            high = middle - 1
    return low


def training_seconds(settings: Settings, facts: SceneFacts, speed: Speed, count: int) -> float:
    """Wall seconds of a training of so many steps, photos read before.

    The number of Gaussians is taken to grow evenly from the points to the cap, or as far as
    `GROWTH_A_PASS` in each densification gets it, between the first and the last densification of each round.

    Args:
        settings: Schedules, cap and sizes.
        facts: Start points and photos.
        speed: How fast steps are.
        count: Number of steps.
    """
    after = (0, *restarts(count, settings.rounds))
    density = shrunk(settings.density, math.ceil(count / settings.rounds))
    start, stop = density.start, density.stop
    points = min(facts.points, settings.most_points or facts.points)
    most = max(density.most or points, points)
    passes = len(after) * max(0.0, (stop - start) / density.interval)
    reached = float(min(most, points * GROWTH_A_PASS ** min(passes, 40.0)))
    if math.isinf(density.gradient) and not density.split_gradient:
        reached = float(points)
    parts = 60
    total = 0.0
    for part in range(parts):
        step = (part + 0.5) / parts * count
        rounds = (step - begun for begun in after if begun <= step)
        grown = sum(min(1.0, max(0.0, (s - start) / max(stop - start, 1))) for s in rounds)
        gaussians = points + grown / len(after) * (reached - points)
        factor = settings.resolution.factor(int(step) + 1, count)
        total += speed.step(gaussians, factor) * count / parts
    return total * settings.views_per_step
