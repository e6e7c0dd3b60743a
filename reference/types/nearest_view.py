"""Which training view has the light of a view: the rule of every test protocol that asks."""

from collections.abc import Sequence

from splatproof.reference.types.scene import View

ALIKE = 0.866
"""Least cosine between the directions of two views that look alike: 30 degrees."""


def nearest_view(view: View, training: Sequence[View]) -> View:
    """The training view whose light a view most probably has.

    Views of the same sensor come before others, then those that look in nearly the same direction
    (within 30 degrees, as long as there are any), and of these the one whose centre is nearest. Where no
    training view has its sensor, those of all sensors count; the record of a run says so.

    Args:
        view: Any view.
        training: Training views, at least one.

    Source: spec of DLG-GS's test protocol: same sensor and direction before nearest centre.
    """
    same = [other for other in training if other.sensor == view.sensor] or list(training)
    towards = [float(other.camera.rotation[2] @ view.camera.rotation[2]) for other in same]
    alike = [other for other, cosine in zip(same, towards, strict=True) if cosine >= ALIKE] or [
        max(zip(towards, range(len(same)), same, strict=True))[2]
    ]
    return min(alike, key=lambda other: float((other.camera.centre - view.camera.centre).norm()))
