"""Our records of a suite as rows like the published ones."""

import math
import statistics
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from splatproof.reference.types.result import Result
from splatproof.suites.records import read_finished

MB = 2**20


@dataclass(frozen=True, kw_only=True)
class OurRow:
    """A method of ours on a scene, the mean over its seeds."""

    scene: str
    method: str
    protocol: str
    seeds: int
    values: dict[str, float]
    """Means by the names of the published metrics."""


def our_rows(folder: Path) -> list[OurRow]:
    """One row a scene, method and protocol of the finished records below a suite's folder.

    Damaged and failed records are left out.
    """
    groups: dict[tuple[str, str, str], list[Result]] = defaultdict(list)
    for result in read_finished(folder):
        groups[result.scene, result.row, result.protocol].append(result)
    return [
        OurRow(scene=scene, method=row, protocol=protocol, seeds=len(group), values=_means(group))
        for (scene, row, protocol), group in groups.items()
    ]


def _means(results: list[Result]) -> dict[str, float]:
    values = [_values(result) for result in results]
    names = {name: None for one in values for name in one}
    return {name: statistics.fmean(one[name] for one in values if name in one) for name in names}


def _values(result: Result) -> dict[str, float]:
    """What the papers print, of one record. SSIM and LPIPS are the first variant that it has."""
    found = {"storage_mb": result.bytes_on_disk / MB, "points_millions": result.primitives / 1e6}
    if result.render_ms > 0:
        found["fps"] = 1000 / result.render_ms
    for name, value in result.metrics.items():
        plain = name.split("_")[0]
        if plain in ("psnr", "ssim", "lpips") and not name.endswith("_of_mean_mse"):
            found.setdefault(plain, value)
    return {name: value for name, value in found.items() if math.isfinite(value)}
