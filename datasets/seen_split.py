"""The split that leaves a survey's rim to training: held-out views that training photos show."""

from collections.abc import Sequence

from splatproof.base.errors import DataError
from splatproof.datasets.image_cache import TensorCache
from splatproof.datasets.seen import KEPT, seen_pixels
from splatproof.datasets.splits import Split, chosen_views
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import SparsePoints, View

RAYS = 10_000
"""Pixels of a view that are asked: every row and column of 100 x 100."""


def seen_split(views: Sequence[View], points: SparsePoints, protocol: Protocol) -> Split:
    """Indices of training and test views: as `hold` counts, or the next view that is seen enough.

    Of each run of `hold` views the first one is held out of which the others, without those that are
    held out before it, show at least `least_seen` of the pixels; a run that has none holds none out.
    At the end every held-out view is asked again without all the others that are held out, and goes
    back to training where too little of it is left. What is seen is what `seen_share` counts
    (docs/seen.md), by true depth where all views have it and else by sparse points.

    Args:
        views: All views, sorted by name.
        points: Sparse points in the views' frame, with their tracks.
        protocol: Its `hold`, `hold_first` and `least_seen`; `train_views` and `scored` are applied then.
    Returns: (train, test), each increasing.
    Raises: DataError where no view is seen enough.
    Source: ours.
    """
    kept = TensorCache(KEPT)

    def share(number: int, held: set[int]) -> float:
        training = [view for i, view in enumerate(views) if i not in held | {number}]
        mask = seen_pixels(views[number], training, points, number, kept, most_rays=RAYS)
        return 0.0 if mask is None else float(mask.double().mean())

    held: set[int] = set()
    best = 0.0
    for start in range(protocol.hold_first, len(views), protocol.hold):
        for number in range(start, min(start + protocol.hold, len(views))):
            found = share(number, held)
            best = max(best, found)
            if found >= protocol.least_seen:
                held.add(number)
                break
    for number in sorted(held):
        if share(number, held - {number}) < protocol.least_seen:
            held.remove(number)
    if not held:
        raise DataError(
            f"protocol {protocol.name}: training photos show at least {protocol.least_seen:g} of no "
            f"view ({best:.3f} of the best); lower least_seen, or take a protocol without it"
        )
    train = tuple(i for i in range(len(views)) if i not in held)
    return chosen_views(train, tuple(sorted(held)), protocol)
