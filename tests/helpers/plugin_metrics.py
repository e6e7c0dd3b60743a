"""Metrics as another package would offer them, and what such a package may get wrong."""

from splatproof.metrics.registry import Metric


def _brightness_error(image, target, mask):
    counted = (image - target).mean(dim=2).abs()
    return float((counted if mask is None else counted[mask]).mean())


def _metric(name: str) -> Metric:
    return Metric(
        name=name, function=_brightness_error, unit="lx", higher_is_better=False,
        range=(0.0, 1.0), source="another package's own",
    )  # fmt: skip


BRIGHTNESS = _metric("brightness")
TAKEN_BY_A_SCENE = _metric("nbgj")
