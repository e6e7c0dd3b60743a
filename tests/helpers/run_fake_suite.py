"""A program for the kill tests: run the fake suite in the folder named on the command line.

With the word "alone" before the folder, its first case alone runs in that very folder.
"""

import sys
from functools import partial
from pathlib import Path

from helpers.fake_methods import FakeSettings, run_fake_case
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.run_case import Job
from splatproof.suites.runner import run_alone, run_suite
from splatproof.suites.suite_files import Case, Suite
from splatproof.suites.workers import in_worker


def fake_suite() -> Suite:
    """Two cases of a second each, with a checkpoint every tenth of it."""
    settings = FakeSettings(iterations=50, seconds_a_step=0.02)
    protocol = load_protocol("default")
    cases = tuple(
        Case(scene="town", method="fake", settings=settings, seed=seed, protocol=protocol)
        for seed in (0, 1)
    )
    return Suite(name="tiny", description="For kills", cases=cases, scenes=("town",))


if __name__ == "__main__":
    launch = partial(in_worker, target=run_fake_case)
    folder, suite = Path(sys.argv[-1]), fake_suite()
    if sys.argv[1] == "alone":
        case = suite.cases[0]
        run_alone(
            Job(case=case, suite="fit", suite_scenes=(), folder=folder, backend="reference"),
            launch=launch,
        )
    else:
        run_suite(suite, folder, backend="reference", launch=launch)
