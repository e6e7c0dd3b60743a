"""One case as both sides of a comparison hold it: numbers, what it was made of, the way to its pictures."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from splatproof.reference.types.result import Result
from splatproof.reports.measured import Measured, measured
from splatproof.reports.run_data import flatten
from splatproof.reports.store import Picture

HASH_DIGITS = 16
"""Hexadecimal digits that are kept of a hash: of a million, two agree by chance once in 10^7 times."""
DATA_ENDS = "_sha256"
"""End of the names of facts of a scene that name its files."""


@runtime_checkable
class Pictures(Protocol):
    """The way to a case's pictures."""

    def __call__(self, kind: Picture, image: str, /) -> bytes | None:
        """The PNG of a test image; None where the case has no such picture.

        Args:
            kind: Its render, its truth or its error map.
            image: Name of the view.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class CaseRecord:
    """One case: everything that a comparison needs of it, as plain data."""

    suite: str
    measured: Measured
    settings: dict[str, object] = field(default_factory=dict)
    """Settings of the method by dotted name."""
    rules: dict[str, object] = field(default_factory=dict)
    """Rules of the protocol by name."""
    environment: dict[str, str] = field(default_factory=dict)
    """Versions, commit, machine, threads, SIMD level, backend, moments of the training."""
    data: dict[str, str] = field(default_factory=dict)
    """Hashes of the scene's files by name."""
    split: str = ""
    """Hash of the names of training and test views."""
    truth: dict[str, str] = field(default_factory=dict)
    """Hash of the truth's pixels of each scored image."""
    model: str = ""
    """Hash of the trained model; empty where the case failed."""
    not_finite: dict[str, dict[str, str]] = field(default_factory=dict)
    """Scores that are no finite number ("nan", "inf", "-inf"), by image and metric; "" for the case's."""
    pictures: Pictures | None = field(default=None, compare=False, repr=False)
    """The way to its pictures; None where it has none."""

    @property
    def group(self) -> tuple[str, str, str, str]:
        """Suite, scene, protocol and row: its seeds are compared together."""
        return self.suite, self.measured.scene, self.measured.protocol, self.measured.row

    @property
    def name(self) -> str:
        """The case as people call it: suite/scene/row/protocol/seed0."""
        suite, scene, protocol, row = self.group
        return f"{suite}/{scene}/{row}/{protocol}/seed{self.measured.seed}"

    @property
    def commit(self) -> str:
        """Commit that it was measured at, with -dirty where files differed; empty where unknown."""
        return self.environment.get("commit", "")


def case_record(result: Result, pictures: Pictures | None = None) -> CaseRecord:
    """What a comparison needs of a result.

    Args:
        result: A finished or failed case.
        pictures: The way to its pictures.
    """
    not_finite = {image.name: _not_finite(image.metrics) for image in result.images}
    not_finite[""] = _not_finite(result.metrics)
    return CaseRecord(
        suite=result.suite,
        measured=measured(result),
        settings={name: plain(value) for name, value in flatten(result.settings)},
        rules={name: plain(value) for name, value in flatten(result.protocol_rules)},
        environment=dict(result.environment),
        data={k: _short(v) for k, v in result.scene_facts.items() if k.endswith(DATA_ENDS)},
        split=_short(result.split_sha256),
        truth={image.name: _short(image.truth_sha256) for image in result.images},
        model=_short(result.model_sha256),
        not_finite={name: found for name, found in not_finite.items() if found},
        pictures=pictures,
    )


def _not_finite(metrics: Mapping[str, float]) -> dict[str, str]:
    return {name: str(value) for name, value in metrics.items() if not math.isfinite(value)}


def plain(value: object) -> object:
    """A value as JSON gives it back: lists for tuples.

    Args:
        value: Anything that JSON holds, or tuples of it.
    """
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def _short(sha: str) -> str:
    return sha[:HASH_DIGITS]
