"""The time that dynamic models count in: frames of a drive, its middle at 0."""

import itertools
from collections import defaultdict
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from splatproof.base.errors import DataError, UsageError
from splatproof.reference.types.scene import Scene, View

FRAME = 0.02
"""Units of model time between two frames (Chen et al. 2023, PVG, release: frame_interval)."""
ONE_MOMENT = 0.1
"""Seconds between frames where all views show one moment."""
SAME = 1e-6
"""Seconds up to which two views show one moment."""


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Turns seconds into model time: 0 in the middle of the drive, 0.02 a frame.

    Source: the release of PVG, which counts frames; seconds: ours, so that frames may be missing.
    """

    middle: float
    """Seconds at model time 0."""
    second: float
    """Units of model time a second."""
    duration: float
    """Model time from the first moment to the last; at least one frame."""

    def of(self, view: View) -> float:
        """Model time of a view.

        Args:
            view: Its time counts.

        Raises: UsageError if it has none.
        """
        if view.time is None:
            raise UsageError(
                f"view {view.name!r}: has no time, and the model moves; give it one in seconds"
            )
        return self.at(view.time)

    def at(self, seconds: float) -> float:
        """Model time of a moment.

        Args:
            seconds: Since the scene's first view.
        """
        return (seconds - self.middle) * self.second

    def facts(self) -> dict[str, float]:
        """What `Clock.read` needs, JSON-ready."""
        return asdict(self)

    @staticmethod
    def read(facts: Mapping[str, Any]) -> "Clock":
        """The clock that `facts` came from.

        Raises: KeyError, TypeError or ValueError for what is missing or wrong.
        """
        return Clock(**{name: float(facts[name]) for name in ("middle", "second", "duration")})


def clock_of(scene: Scene) -> Clock:
    """The clock of a scene: its frames are as far apart as photos of one sensor most often are.

    So cameras that are triggered one after the other are of one frame.

    Args:
        scene: Times and sensors of all views count, those of held-out ones too: they say when, not what.

    Raises: DataError if a view has no time.
    """
    for view in scene.views:
        if view.time is None:
            raise DataError(
                f"scene {scene.name!r}: view {view.name!r} has no time, which a moving model needs; "
                "add views.json, or use a static method such as 3dgs"
            )
    by_sensor: dict[str, set[float]] = defaultdict(set)
    for view in scene.views:
        by_sensor[view.sensor].add(view.time or 0.0)
    moments = sorted(set().union(*by_sensor.values()))
    gaps = sorted(gap for own in by_sensor.values() for gap in _gaps(own)) or _gaps(moments)
    second = FRAME / (gaps[len(gaps) // 2] if gaps else ONE_MOMENT)
    first, last = (moments[0], moments[-1]) if moments else (0.0, 0.0)
    return Clock(
        middle=(first + last) / 2, second=second, duration=max((last - first) * second, FRAME)
    )


def _gaps(times: Collection[float]) -> list[float]:
    """Seconds between moments that follow each other, short to long."""
    found = (b - a for a, b in itertools.pairwise(sorted(times)))
    return sorted(gap for gap in found if gap > SAME)
