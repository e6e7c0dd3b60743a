"""Suites that tests run: each once a session, in whatever process asks first."""

import glob
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from splatproof.base.errors import MissingError, SplatproofError
from splatproof.base.locks import locked
from splatproof.reference.types.result import Result
from splatproof.reports.comparing import baselines
from splatproof.reports.comparing.cases import CaseRecord, case_record
from splatproof.reports.comparing.compare import Comparison, compare
from splatproof.reports.comparing.matching import match
from splatproof.reports.comparing.sides import PicturesOnDisk, Side, newest
from splatproof.suites.runner import Outcome, run_suite, select
from splatproof.suites.scenes import check_scene, without_absent
from splatproof.suites.suite_files import Suite, load_suite
from splatproof.suites.workers import in_worker
from splatproof.testing.code_key import code_key
from splatproof.testing.words import faults, told


class CaseFailed(Exception):
    """A case of a suite ended with an error."""


@dataclass(kw_only=True)
class Runs:
    """Runs suites for tests: `splatproof_run("mine.splat.toml").not_worse(than="baselines/mine.json")`.

    Results lie in OUT/<name of the code>/<suite>/..., so they are kept and continued while the code
    of splatproof, of the methods' packages and torch are the same. A process waits for another one that
    is at work on a suite, and finds its results.
    """

    root: Path
    """Folder that relative paths of suites and baselines begin at."""
    out: Path
    baseline: str | None = None
    """Baseline of checks that name none."""
    save: bool = False
    """Whether checks freeze results instead of comparing them."""
    strict: bool = False
    """Whether an undecided comparison fails a check."""
    say: Callable[[str], None] = print
    """Hears what a check found that did not fail."""
    _finished: "dict[tuple[str, str | None], Ran]" = field(default_factory=dict)

    def __call__(self, suite: str | Path, *, only: str | None = None) -> "Ran":
        """Run a suite, or take what an earlier call, process or session has run of it.

        Args:
            suite: Name of a suite that ships with the package, or path of a .toml file.
            only: Pattern on scene/method/protocol/seed<k>; None: all cases.
        Returns: What came out.
        Raises: CaseFailed naming the case; Skipped where a scene is not on this machine.
        """
        key = (str(suite), only)
        if key not in self._finished:
            self._finished[key] = self._run(self.load(suite), only)
        return self._finished[key]

    def load(self, suite: str | Path) -> Suite:
        """Read a suite file.

        Args:
            suite: Name, or path of a .toml file.
        Raises: UsageError naming file and key.
        """
        text = str(suite)
        return load_suite(self.root / text if text.endswith(".toml") else text)

    def case(self, suite: Suite, label: str) -> "Ran":
        """Run one case of a suite.

        Args:
            suite: The suite.
            label: Name of the case: scene/method/protocol/seed<k>.
        Raises: CaseFailed; Skipped where its scene is not on this machine.
        """
        return self._run(suite, glob.escape(label))

    def _run(self, suite: Suite, only: str | None) -> "Ran":
        chosen = select(suite, only=only)
        try:
            chosen, absent = without_absent(chosen)
        except MissingError as error:
            pytest.skip(str(error))
        for reason in absent:
            self.say(f"left out: {reason}")
        metrics = {name for case in suite.cases for name in case.protocol.metrics}
        folder = self.out / code_key({case.method for case in suite.cases}, metrics)
        with locked(folder / f".{suite.name}.lock"):
            outcomes = run_suite(chosen, folder, launch=in_worker)
        for outcome in outcomes:
            if outcome.result.error:
                raise CaseFailed(f"{outcome.case.label}: {outcome.result.error} ({outcome.folder})")
        return Ran(
            suite=suite.name, folder=folder / suite.name, outcomes=outcomes, runs=self, only=only
        )


@dataclass(frozen=True, kw_only=True)
class Ran:
    """The finished cases of a suite."""

    suite: str
    folder: Path
    """Folder of the suite's cases."""
    outcomes: tuple[Outcome, ...]
    runs: Runs = field(repr=False)
    only: str | None = None
    """Pattern that chose them; None: they are all of the suite's."""

    @property
    def results(self) -> tuple[Result, ...]:
        """One result a case, in the suite's order."""
        return tuple(outcome.result for outcome in self.outcomes)

    def not_worse(
        self, than: str | Path | None = None, metrics: Sequence[str] = ()
    ) -> Comparison | None:
        """Fail the test if any metric of any row got worse than a baseline, by `bench compare`'s rules.

        Args:
            than: File of the baseline, relative to pytest's root folder; None: --splatproof-baseline.
            metrics: Metrics that are judged; empty: the protocols' and those with a declared band.
        Returns: All verdicts; None where the results were frozen, with --splatproof-save.
        Raises: AssertionError with what got worse, by how much, and the worst views; also where a case
            that the baseline has cannot be compared with it, or nothing can.
        """
        __tracebackhide__ = True
        named = than if than is not None else self.runs.baseline
        if named is None:
            pytest.fail("not_worse: name a baseline with than= or --splatproof-baseline", False)
        path = self.runs.root / named
        try:
            if self.runs.save:
                kept = baselines.read(path, str(named)).cases if path.exists() else ()
                baselines.write(path, [*self._others(kept), *self.side.cases])
                self.runs.say(f"frozen: {len(self.side.cases)} cases in {path}")
                return None
            if not path.exists():
                pytest.fail(f"{path}: no such baseline; run pytest with --splatproof-save", False)
            base = baselines.read(path, str(named))
            own = tuple(case for case in base.cases if self._asked(case))
            found = _compared(replace(base, cases=own), self.side, metrics)
        except SplatproofError as error:
            pytest.fail(str(error), False)
        text = told(found, self.folder.parent, metrics)
        if faults(found, strict=self.runs.strict):
            raise AssertionError(text)
        if text:
            self.runs.say(text)
        return found

    def _others(self, kept: Sequence[CaseRecord]) -> list[CaseRecord]:
        """Cases of a baseline that saving leaves there: of other suites, and those that `only` left out."""
        new = {case.name for case in self.side.cases}
        return [
            case for case in kept
            if case.suite != self.suite or (self.only is not None and case.name not in new)
        ]  # fmt: skip

    def _asked(self, case: CaseRecord) -> bool:
        """Whether a case of a baseline is compared: of this suite, and of a row that `only` chose."""
        chosen = self.only is None or case.group in {one.group for one in self.side.cases}
        return case.suite == self.suite and chosen

    @property
    def side(self) -> Side:
        """The results as `bench compare` takes them."""
        records = [
            case_record(one.result, PicturesOnDisk(one.folder)) for one in self.outcomes
        ]  # fmt: skip
        return newest("this run", records)


def _compared(base: Side, new: Side, metrics: Sequence[str]) -> Comparison:
    """All verdicts; where no case can be compared no metric is known, and the reasons are wanted."""
    known = match(base.cases, new.cases).groups
    return compare(base, new, metrics=metrics if known else ())


def skip_without(scene: str) -> None:
    """Skip the test that is running if a registered scene is not on this machine and cannot be made.

    Args:
        scene: Name, as `bench scenes list` prints it.
    Raises: UsageError for an unknown name; Skipped with where it was looked for and how to get it.
    """
    try:
        check_scene(scene)
    except MissingError as error:
        pytest.skip(str(error))
