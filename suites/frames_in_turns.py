"""Milliseconds a frame of a suite's saved models, drawn in turns: what else the machine does meets all of them."""

import hashlib
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TypeVar

import torch

from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.loading import load_reconstruction
from splatproof.reference.types.result import Result
from splatproof.suites.held_out import render_milliseconds, scored_views
from splatproof.suites.records import RECORD_NAME, read_record, write_record
from splatproof.suites.suite_files import Case, Suite

LEAST_ROUNDS = 3
"""Median of fewer: their mean, or one of them."""
Key = TypeVar("Key")


@dataclass(frozen=True, kw_only=True)
class Finished:
    """A case that has a saved model."""

    case: Case
    folder: Path
    """The case's own folder."""
    result: Result
    """What its record says."""

    @property
    def place(self) -> tuple[str, str]:
        """Scene and protocol: whose views are drawn."""
        return self.case.scene, self.case.protocol.name


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """A case whose model has had its turns."""

    before: Finished
    result: Result
    """What its record says now."""
    rounds: tuple[float, ...]
    """Milliseconds a frame in each round; `render_ms` of the result is their median."""


def finished_cases(suite: Suite, out: Path) -> list[Finished]:
    """The cases that have a model to draw, in the suite's order.

    Args:
        suite: What was run, or a choice of it.
        out: Folder that the suite was run to.
    Raises: DataError where there are fewer than two, or a record is damaged.
    """
    found = []
    for case in suite.cases:
        folder = out / suite.name / case.folder
        if (folder / RECORD_NAME).exists() and not (result := read_record(folder)).error:
            found.append(Finished(case=case, folder=folder, result=result))
    if len(found) < 2:
        raise DataError(
            f"{out / suite.name}: {len(found)} of {len(suite.cases)} cases have a result here, and turns take "
            f"two; `bench run {suite.name}` makes them"
        )
    return found


def draw_in_turns(
    found: Sequence[Finished],
    rounds: int,
    on_round: Callable[[str, int], None] = lambda *_: None,
) -> list[Drawn]:
    """Time the models of each scene and protocol in turns, and write what a frame takes into their records.

    All models of a scene and protocol are in memory at once. Nothing is written before all have had
    their turns.

    Args:
        found: Cases with their folders and records.
        rounds: Turns of each model, at least LEAST_ROUNDS.
        on_round: Hears of each round that begins: whose, and its number from 0.
    Returns: The cases in the order they were given.
    Raises: DataError for a model or a scene that cannot be read.
    """
    times: dict[Path, tuple[float, ...]] = {}
    by_place = sorted(found, key=lambda one: one.place)
    for (scene, protocol), group in groupby(by_place, key=lambda one: one.place):
        cases = list(group)
        times |= _of_one_place(cases, rounds, partial(on_round, f"{scene}, {protocol}"))
    session = _session(times)
    drawn = []
    for one in found:
        own = times[one.folder]
        now = replace(one.result, render_ms=statistics.median(own), turns=session)
        drawn.append(Drawn(before=one, result=now, rounds=own))
    for one in drawn:
        write_record(one.before.folder, one.result)
    return drawn


def _of_one_place(
    cases: Sequence[Finished], rounds: int, on_round: Callable[[int], None]
) -> dict[Path, tuple[float, ...]]:
    """Milliseconds a frame in each round, by the case's folder."""
    first = cases[0].case
    views = scored_views(open_scene(first.scene, first.protocol), first.protocol)
    background = torch.tensor(first.protocol.background)
    draws = {}
    for one in cases:
        backend = one.result.environment.get("backend", "cpu")  # where it was scored
        model = load_reconstruction(one.folder / "model", backend=backend)
        draws[one.folder] = partial(render_milliseconds, views, model, background)
    return in_turns(draws, rounds, on_round)


def in_turns(
    draws: Mapping[Key, Callable[[], float]],
    rounds: int,
    on_round: Callable[[int], None] = lambda _: None,
) -> dict[Key, tuple[float, ...]]:
    """What each measures in each round; every round begins with another one.

    Args:
        draws: Each measures once when it is called.
        rounds: How often each is called.
        on_round: Hears the number of each round that begins, from 0.
    """
    keys = list(draws)
    found: dict[Key, list[float]] = {key: [] for key in keys}
    for number in range(rounds):
        on_round(number)
        start = number % max(len(keys), 1)
        for key in keys[start:] + keys[:start]:
            found[key].append(draws[key]())
    return {key: tuple(values) for key, values in found.items()}


def _session(times: Mapping[Path, Sequence[float]]) -> str:
    """A name by which those that were drawn in turns with one another are known."""
    what = [time.time_ns(), *(f"{folder} {own}" for folder, own in times.items())]
    return hashlib.sha256(repr(what).encode()).hexdigest()[:12]
