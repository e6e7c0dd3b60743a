"""How many Gaussians a plan allows: as many as photos, file and memory bear."""

import math
from dataclasses import replace

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.cost import training_memory_mb
from splatproof.methods.threedgs.settings import Settings

PIXELS_A_GAUSSIAN = 25
"""Pixels of all training photos together for each Gaussian, at least: with fewer it learns noise. Held-out training
photos of brighton_beach at 250 px, one seed: 25 pixels a Gaussian 19.2 dB after 3,000 steps, 3 pixels 18.3 dB
after as many, 7 pixels 18.8 dB after 1,500."""
LEAST_GAUSSIANS = 1000
"""Gaussians that a plan allows however few pixels there are."""
HEAD_BYTES, VIEW_BYTES = 4096, 64
"""Bytes of a saved model beside its Gaussians, and of each photo's exposure, at most."""
MEMORY_SHARE = 0.8
"""Share of the free memory that a plan takes: the estimate is right to a quarter."""


def most_gaussians(
    asked: AutoSettings,
    facts: SceneFacts,
    degree: int,
    free: float,
    image_bytes: int = Run.image_bytes,
) -> tuple[int, str]:
    """Cap on the number of Gaussians, and why.

    Args:
        asked: The budget.
        facts: What was measured.
        degree: Degree of the harmonics.
        free: Megabytes of this machine's memory that are free.
        image_bytes: Bytes for photos in memory.
    """
    pixels = facts.views * facts.width * facts.height
    shown = (
        pixels // PIXELS_A_GAUSSIAN,
        f"all photos together have {pixels:,} pixels, {PIXELS_A_GAUSSIAN} a Gaussian",
    )
    most, why = min([shown, *_room(asked, facts, degree, free, image_bytes)])
    return max(1 if asked.megabytes else LEAST_GAUSSIANS, most), why


def _room(
    asked: AutoSettings, facts: SceneFacts, degree: int, free: float, image_bytes: int
) -> list[tuple[int, str]]:
    """Gaussians that fit into the file and into memory, and why; nothing where neither has a bound."""
    bounds = []
    if asked.megabytes:
        room = asked.megabytes * MEBIBYTE - HEAD_BYTES - VIEW_BYTES * facts.views
        bounds.append((int(room / gaussian_bytes(degree)), f"what {asked.megabytes:g} MB hold"))
    if math.isfinite(free):
        none, one = (training_mb(facts, count, degree, image_bytes) for count in (0, 1))
        room = max(0.0, MEMORY_SHARE * free - none) / (one - none)
        bounds.append((int(room), f"what training may hold of {free:,.0f} MB of free memory"))
    return bounds


def bounded(
    asked: AutoSettings,
    settings: Settings,
    facts: SceneFacts,
    free: float,
    image_bytes: int = Run.image_bytes,
) -> Settings:
    """Settings whose start has no more points than file and memory hold Gaussians: nothing takes the others away later.

    A file that holds fewer Gaussians than there are points gets harmonics of the highest degree with which it holds as many,
    or none. 1,500 steps, one seed, degrees 3, 2, 1 and 0: caliterra at 400 px in 0.5 MB 26.3, 27.1, 28.2 and 29.1 dB, in 2 MB 29.5,
    30.3, 31.1 and 31.9; brighton_beach at 250 px in 0.5 MB 21.0, 21.2, 21.0 and 21.7, in 2 MB, which hold all points, 22.4, 22.4,
    21.9 and 21.3.

    Args:
        asked: The budget.
        settings: What has been chosen.
        facts: What was measured.
        free: Megabytes of this machine's memory that are free.
        image_bytes: Bytes for photos in memory.
    """
    points = min(facts.points, settings.most_points or facts.points)
    if asked.megabytes and asked.sh_degree is None:
        fitting = (
            degree for degree in range(settings.sh_degree, 0, -1)
            if _room(asked, facts, degree, math.inf, image_bytes)[0][0] >= points
        )  # fmt: skip
        settings = replace(settings, sh_degree=next(fitting, 0))
    fewest = 1 if asked.megabytes else LEAST_GAUSSIANS
    bounds = _room(asked, facts, settings.sh_degree, free, image_bytes)
    room = [max(fewest, most) for most, _ in bounds]
    allowed = [] if settings.most_points is None else [settings.most_points]
    return replace(settings, most_points=min([*allowed, *room], default=None))


def gaussian_bytes(degree: int) -> int:
    """Bytes of a Gaussian in a saved model.

    Args:
        degree: Degree of the harmonics.
    """
    return 4 * (11 + 3 * (degree + 1) ** 2)


def file_mb(gaussians: int, degree: int, views: int) -> float:
    """Size of a saved model, 2^20 bytes, at most.

    Args:
        gaussians: Number of Gaussians.
        degree: Degree of the harmonics.
        views: Number of training photos.
    """
    return (HEAD_BYTES + VIEW_BYTES * views + gaussian_bytes(degree) * gaussians) / MEBIBYTE


def training_mb(
    facts: SceneFacts, gaussians: int, degree: int, image_bytes: int = Run.image_bytes
) -> float:
    """Peak memory of a training process, 2^20 bytes.

    Args:
        facts: Number and size of the photos.
        gaussians: Number of Gaussians at the end.
        degree: Degree of the harmonics.
        image_bytes: Bytes for photos in memory.
    """
    return training_memory_mb(
        float(gaussians), image_bytes=float(min(facts.image_bytes, image_bytes)),
        pixels=float(facts.width * facts.height), sh_degree=degree,
    )  # fmt: skip
