"""This project's check on itself: a small suite against the committed baseline, and faults that it must call.

`make baseline` renews the baseline; CONTRIBUTING.md says when that is allowed. Scores are judged by statistics,
so the check holds on any machine (a run with AVX2 against this baseline of AVX-512: -0.08 dB, undecided);
counters are compared exactly where kernels, versions and backend give the same bits, and are told to be "not
compared" elsewhere.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from splatproof.methods.threedgs import fit
from splatproof.methods.training import density
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.terms import Photometric
from splatproof.reports.comparing.compare import Comparison, compare
from splatproof.reports.comparing.opening import open_side
from splatproof.reports.comparing.sides import Side, side_of
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import load_suite
from splatproof.suites.workers import in_process

HERE = Path(__file__).parent
SUITE = load_suite(HERE / "regression.toml")
BASELINES = HERE.parents[1] / "baselines"
SEEDS = (0, 1, 2)
MORE_SEEDS = (0, 1, 2, 3, 4, 5)
TWELVE_SEEDS_SAW = {"psnr": 0.054, "ssim_3dgs": 0.0013}
"""Sizes of the mean differences that twelve seeds found where all rates are 1 % lower."""


def run(folder: Path, seeds: tuple[int, ...] = SEEDS, label: str = "NEW") -> Side:
    """The suite with some seeds, run by the code as it is at this moment."""
    cases = tuple(replace(SUITE.cases[0], seed=seed) for seed in seeds)
    suite = replace(SUITE, cases=cases)
    outcomes = run_suite(suite, folder, threads=1, launch=in_process)
    return side_of(label, [outcome.result for outcome in outcomes])


@pytest.fixture(scope="module")
def baseline() -> Side:
    return open_side("regression", folder=BASELINES)


@pytest.fixture(scope="module")
def now(tmp_path_factory: pytest.TempPathFactory) -> Side:
    return run(tmp_path_factory.mktemp("now"))


def told(found: Comparison) -> str:
    """Every verdict in a line, for who reads a failed test."""
    lines = [
        f"{one.measure.metric}: {one.base_mean:.4f} -> {one.new_mean:.4f} {one.verdict} ({one.reason})"
        for one in found.compared
    ]
    lines += [
        f"{one.counter}: {one.base} -> {one.new} {one.verdict} ({one.reason})"
        for one in found.counters
    ]
    return "\n".join(lines + [f"{one.what}: {one.why}" for one in found.not_comparable])


def verdicts(found: Comparison) -> dict[str, str]:
    """Verdict of each metric that the protocol names."""
    names = SUITE.cases[0].protocol.metrics
    return {
        one.measure.metric: one.verdict for one in found.compared if one.measure.metric in names
    }


def test_this_code_is_not_worse_than_the_baseline(baseline: Side, now: Side):
    found = compare(baseline, now)
    assert set(verdicts(found)) == {"psnr", "ssim_3dgs"}, told(found)
    assert not found.not_comparable, told(found)
    assert not found.regressions, told(found)


def test_the_suite_does_what_density_control_can_do(now: Side):
    for case in now.cases:
        counters = case.measured.counters
        assert counters["steps"] == 300
        assert min(counters.values()) > 0, counters
        assert counters["densifications"] >= 5
        assert counters["rows_added"] > counters["rows_removed"]


def test_the_same_code_is_identical(now: Side, tmp_path: Path):
    first = replace(now, cases=now.cases[:1])
    found = compare(first, run(tmp_path, SEEDS[:1]))
    judged = [one for one in found.compared if one.measure.metric in verdicts(found)]
    assert {(one.verdict, one.reason) for one in judged} == {
        ("equal", "identical: the same models and scores")
    }, told(found)
    assert {one.verdict for one in found.counters} == {"same"}


@pytest.mark.slow  # as long as a planted fault, and rarer news
def test_other_seeds_are_not_called_worse(baseline: Side, tmp_path: Path):
    found = compare(baseline, run(tmp_path, (3, 4, 5)))
    assert not found.regressions, told(found)
    assert {one.verdict for one in found.counters} == {"not compared"}


@pytest.mark.slow  # the next is a fault that is called in the same way
def test_a_dropped_ssim_term_is_called_worse(baseline, tmp_path, monkeypatch):
    """Measured, three seeds: -0.8 dB, -0.096 SSIM."""
    monkeypatch.setattr(fit, "terms", lambda settings: (Photometric(dssim=0.0),))
    found = compare(baseline, run(tmp_path))
    assert verdicts(found)["ssim_3dgs"] == "worse", told(found)
    assert found.regressions


@pytest.mark.slow  # a planted fault, and a training
def test_a_wrong_split_scale_is_called_worse(baseline, tmp_path, monkeypatch):
    """Children at 1 / 3.2 of their parent, as where 0.8 N of the release is read as 1.6 N.

    Measured, three seeds: -2.7 dB, -0.10 SSIM.
    """
    monkeypatch.setattr(density, "SPLIT_SHRINK", 3.2)
    found = compare(baseline, run(tmp_path))
    assert set(verdicts(found).values()) == {"worse"}, told(found)


@pytest.mark.slow
def test_children_as_large_as_their_parent_are_called_worse(tmp_path, monkeypatch):
    """The smaller fault of the two in so short a run, which has no time to need small Gaussians.

    Twelve seeds: -0.026 SSIM [-0.037, -0.017], and -0.5 dB [-1.2, +0.1], which is not told from 0. Three
    seeds would show 0.021 SSIM; so six are taken here.
    """
    right = run(tmp_path / "right", MORE_SEEDS, "BASE")
    monkeypatch.setattr(density, "SPLIT_SHRINK", 1.0)
    found = compare(right, run(tmp_path / "wrong", MORE_SEEDS))
    assert verdicts(found)["ssim_3dgs"] == "worse", told(found)


@pytest.mark.slow
def test_one_percent_of_the_rates_is_seen_and_not_called_worse(now, tmp_path, monkeypatch):
    """Real, and far below what three seeds can tell from chance.

    Twelve seeds on either side (this suite with `--seeds 12`): -0.05 dB [-0.34, +0.22] and -0.0013 SSIM
    [-0.0073, +0.0043], and would have shown 0.40 dB and 0.008. So "undecided" is the honest verdict; that the
    numbers changed at all is seen by the counters.
    """
    right = Trainer.rates
    monkeypatch.setattr(
        Trainer, "rates", lambda self: {name: 0.99 * rate for name, rate in right(self).items()}
    )
    found = compare(now, run(tmp_path))
    assert set(verdicts(found).values()) <= {"equal", "undecided"}, told(found)
    assert not found.regressions
    assert "changed" in {one.verdict for one in found.counters}, told(found)
    for one in found.compared:
        if one.measure.metric in verdicts(found):
            assert "identical" not in one.reason
            assert one.detectable is not None
            assert one.detectable > TWELVE_SEEDS_SAW[one.measure.metric]
