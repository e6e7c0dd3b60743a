"""A suite file as tests: one a case, and one against the baseline where it is named."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pytest_splatproof import runs_of
from splatproof.base.errors import SplatproofError
from splatproof.suites.suite_files import Suite
from splatproof.testing.runs import CaseFailed, Runs

CHECK = "not_worse"
"""Name of the test against the baseline."""


class SuiteCollector(pytest.File):
    """A suite file."""

    def collect(self) -> Iterator[pytest.Item]:
        """Every case; then, with --splatproof-baseline, the check of all of them."""
        runs = runs_of(self.config)
        try:
            suite = runs.load(self.path)
        except SplatproofError as error:
            raise self.CollectError(str(error)) from None
        for case in suite.cases:
            yield CaseItem.from_parent(self, name=case.label, runs=runs, suite=suite)
        if runs.baseline is not None:
            yield CheckItem.from_parent(self, name=CHECK, runs=runs, suite=suite)


class SuiteItem(pytest.Item):
    """A test of a suite."""

    def __init__(self, *, runs: Runs, suite: Suite, **named: Any) -> None:
        """Remember what is tested."""
        super().__init__(**named)
        self.runs, self.suite = runs, suite

    def reportinfo(self) -> tuple[Path, None, str]:
        """Where pytest says that the test is."""
        return self.path, None, self.name

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """A case's error and a check's table without a traceback, which would be of ours.

        Args:
            excinfo: What was raised.
            style: How pytest shows tracebacks.
        """
        if isinstance(excinfo.value, CaseFailed | AssertionError | SplatproofError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)


class CaseItem(SuiteItem):
    """A case: it passes where it finishes."""

    def runtest(self) -> None:
        """Run it, or find that it is finished."""
        self.runs.case(self.suite, self.name)


class CheckItem(SuiteItem):
    """All cases against the baseline."""

    def runtest(self) -> None:
        """Compare what the other tests have run."""
        self.runs(self.path).not_worse()
