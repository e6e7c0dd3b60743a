"""Versions of a row and their change points: called where one was planted, and rarely where none is."""

import dataclasses

import numpy as np

from helpers import case_folders, dashboard_store
from splatproof.reports.comparing.cases import CaseRecord, case_record
from splatproof.reports.comparing.compare import ALPHA
from splatproof.reports.dashboard.changes import changes
from splatproof.reports.dashboard.history import all_series, versions
from splatproof.reports.dashboard.site import Site


def test_versions_are_runs_that_differ_in_their_seeds_alone(site: Site):
    for runs in all_series(site.state.index.runs).values():
        found = versions(runs)
        assert [v.of("commit") for v in found] == list(dashboard_store.COMMITS)
        assert [[run.numbers.seed for run in v.runs] for v in found] == [[0, 1, 2]] * 2
        assert found[1].differs(found[0]) == ["commit"]


def test_a_repeated_seed_counts_once_and_the_newest_does(site: Site):
    runs = next(iter(all_series(site.state.index.runs).values()))
    later = dataclasses.replace(runs[0], run="again", ended=runs[-1].ended + 1)
    found = versions([*runs, later])
    assert [len(v.runs) for v in found] == [3, 3]
    assert found[-1].runs[0].run == "again"  # a version is as new as its newest run


def test_failed_runs_have_no_history(site: Site):
    rows = {run.numbers.row for runs in all_series(site.state.index.runs).values() for run in runs}
    assert "broken" not in rows
    assert "3dgs" in rows


def history(psnr: list[float], draw: int) -> list[list[CaseRecord]]:
    """Versions with these true means, three seeds and four images each."""
    return [
        [
            case_record(case_folders.result(
                method="3dgs", seed=seed + 10 * place + 1000 * draw, psnr=mean,
                model_sha256=f"{draw} {place} {seed}",
            ))
            for seed in range(3)
        ]
        for place, mean in enumerate(psnr)
    ]  # fmt: skip


def test_a_planted_change_is_called_where_it_is():
    found = changes(history([24.0, 24.0, 25.0, 25.0, 24.5], draw=0))["psnr"]
    assert [one.at for one in found] == [1, 2, 3, 4]
    verdicts = [one.verdict for one in found]
    assert verdicts[1] == "better"
    assert verdicts[3] == "worse"
    assert not {verdicts[0], verdicts[2]} & {"better", "worse"}
    assert found[1].mean is not None
    assert abs(found[1].mean - 1.0) < 0.2  # three seeds of 0.05 dB


def test_without_a_change_histories_are_called_changed_at_most_at_the_stated_rate():
    """40 histories of 4 versions; three standard errors of a share of 40 are allowed on top of 5 %."""
    called = sum(
        any(
            one.verdict in ("better", "worse") for one in changes(history([24.0] * 4, draw))["psnr"]
        )
        for draw in range(40)
    )
    assert called <= 40 * (ALPHA + 3 * np.sqrt(ALPHA * (1 - ALPHA) / 40))


def test_one_version_has_no_changes():
    assert changes(history([24.0], draw=0)) == {}
