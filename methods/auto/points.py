"""Points enough to start from: where a scene has hardly any, others are drawn beside them."""

from dataclasses import replace

import torch

from splatproof.methods.auto import measured
from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.usual import RANDOM_POINTS
from splatproof.methods.training.initialise import with_random_points
from splatproof.reference.types.scene import Scene, SparsePoints

LEAST_POINTS = 12
"""Points, matched ones included, with fewer of which others are drawn beside them. Held-out training photos, one seed, with 300
drawn ones less without, in as many processor seconds (so fewer steps): courtyard from 4 points +0.3 dB, from 12 +0.1, from 30 -0.5;
aerial-sparse/town from 8 points +0.1, from 20 -0.3. In as many steps, 1,500, town from 8 points has +1.2."""
BESIDE = 300
"""Points that are drawn beside a few. The same photos of courtyard with 300, 1,000 and 3,000, 9 processor seconds, from 4
points 21.8, 21.7 and 20.9 dB, from 12 22.0, 21.8 and 20.9; of town, 14, from 8 21.1, 21.0 and 19.6."""


def lacking_points(there: int) -> Choice:
    """Why points are drawn.

    Args:
        there: Number of points that the scene has, matched ones included.
    """
    return Choice(
        component="start",
        value=f"{BESIDE if there else RANDOM_POINTS:,} points drawn in sight of the cameras"
        + (f", beside the {there} that are there" if there else ""),
        because=f"the scene has only {there}; --points triangulated may find more" if there
        else "the scene has none; --points triangulated may find some",
        expects=measured.BESIDE if there else NOT_MEASURED,
    )  # fmt: skip


def with_enough(scene: Scene, seed: int) -> Scene:
    """The scene with points drawn in sight of its cameras beside its own, where these are too few; else as it is.

    Args:
        scene: With any number of points.
        seed: Seed of the draw.

    Source: ours; where they are drawn: `with_random_points`.
    """
    own = scene.points
    if len(own) >= LEAST_POINTS or not scene.train:
        return scene
    none = SparsePoints(
        positions=own.positions[:0], colours=own.colours[:0], track_starts=own.track_starts[:1],
        track_views=own.track_views[:0],
    )  # fmt: skip
    count = BESIDE if len(own) else RANDOM_POINTS
    drawn = with_random_points(replace(scene, points=none), count, seed).points
    return replace(scene, points=SparsePoints(
        positions=torch.cat([own.positions, drawn.positions]),
        colours=torch.cat([own.colours, drawn.colours]),
        track_starts=torch.cat([own.track_starts, drawn.track_starts[1:] + own.track_starts[-1]]),
        track_views=torch.cat([own.track_views, drawn.track_views]),
    ))  # fmt: skip
