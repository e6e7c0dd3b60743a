"""pytest plugin of splatproof: suites as tests, checks against a baseline, scenes that may be absent.

It lies outside the package so that pytest, which loads it before anything else in every environment it
is installed in, does not import splatproof: that is done where a suite, the fixture or the marker is used.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator

    from splatproof.testing.runs import Runs

SUFFIX = ".splat.toml"
"""End of the names of suite files that are collected."""
SAID = pytest.StashKey[list[str]]()
"""What checks found that did not fail; shown at the end."""
PROPERTY = "splatproof"
"""Name under which a report carries it, also between processes and into JUnit files."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add our options.

    Args:
        parser: pytest's parser.
    """
    group = parser.getgroup("splatproof", "Gaussian splatting suites")
    group.addoption(
        "--splatproof-out", metavar="DIR", default=".splatproof",
        help="folder for results of suites, kept while the code is the same (default: .splatproof)",
    )  # fmt: skip
    group.addoption(
        "--splatproof-baseline",
        metavar="FILE",
        help=f"baseline of not_worse() without `than`, and of collected *{SUFFIX} files",
    )
    group.addoption(
        "--splatproof-save", action="store_true",
        help="not_worse() freezes this run's results in its baseline instead of comparing",
    )  # fmt: skip
    group.addoption(
        "--splatproof-strict", action="store_true",
        help="not_worse() fails where a comparison is undecided or lacks its baseline, too",
    )  # fmt: skip


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker.

    Args:
        config: pytest's configuration.
    """
    config.addinivalue_line(
        "markers",
        "needs_scene(*names): skip with the reason where a registered scene is not on this machine",
    )
    config.stash[SAID] = []


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> pytest.Collector | None:
    """A suite file's cases as tests.

    Args:
        file_path: Any file.
        parent: What it is collected in.
    """
    if not file_path.name.endswith(SUFFIX):
        return None
    from splatproof.testing.items import SuiteCollector

    return SuiteCollector.from_parent(parent, path=file_path)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test whose scene is not here.

    Args:
        item: Any test.
    """
    for mark in item.iter_markers("needs_scene"):
        from splatproof.testing.runs import skip_without

        for name in mark.args:
            skip_without(name)


@pytest.fixture(scope="session")
def splatproof_run(pytestconfig: pytest.Config) -> "Runs":
    """splatproof_run(suite): runs a suite once a session; see `splatproof.testing.runs.Runs`."""
    return runs_of(pytestconfig)


def runs_of(config: pytest.Config) -> "Runs":
    """The suites of a session.

    Args:
        config: pytest's configuration.
    """
    from splatproof.testing.runs import Runs

    if (found := config.stash.get(RUNS, None)) is not None:
        return found
    option: Any = config.getoption
    made = config.stash[RUNS] = Runs(
        root=config.rootpath,
        out=config.rootpath / option("--splatproof-out"),
        baseline=option("--splatproof-baseline"),
        save=option("--splatproof-save"),
        strict=option("--splatproof-strict"),
        say=config.stash[SAID].append,
    )
    return made


RUNS: "pytest.StashKey[Runs]" = pytest.StashKey()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> "Generator[None, pytest.TestReport, pytest.TestReport]":
    """Hang what was said onto the report, which also crosses processes.

    Args:
        item: Any test.
    """
    report = yield
    said = item.config.stash[SAID]
    report.user_properties += [(PROPERTY, text) for text in said]
    said.clear()
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Show what checks found that did not fail.

    Args:
        terminalreporter: pytest's terminal.
    """
    reports = [one for own in terminalreporter.stats.values() for one in own]
    texts = [
        (one.nodeid, text)
        for one in reports
        for name, text in getattr(one, "user_properties", ())
        if name == PROPERTY
    ]
    if texts:
        terminalreporter.section("splatproof")
    for test, text in dict.fromkeys(texts):
        terminalreporter.write_line(f"{test}\n{text}")
