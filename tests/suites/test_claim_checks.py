"""Checks of our own claims: each measures what it says, and sees the fault that it is there for."""

import statistics
import time
from pathlib import Path

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import MissingError, UsageError
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.ply import read_ply
from splatproof.methods.training.loop import Trainer
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.claim_checks import (
    accuracy,
    bits,
    registry,
    seam,
    size,
    speed,
    steps,
    trained,
)
from splatproof.suites.claim_checks.registry import CHECKS, run_check
from splatproof.suites.studies.speed.neural import SMALL
from splatproof.suites.twins.registry import COMPONENTS

STEPS = 16


def cloud(count: int = 40, seed: int = 0) -> Gaussians:
    draw = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=draw)
    return Gaussians(
        means=normal(count, 3), quaternions=normal(count, 4), log_scales=normal(count, 3) - 3,
        opacity_logits=normal(count), sh=0.1 * normal(count, 16, 3),
    )  # fmt: skip


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fits of one method, few steps and a tiny scene; what an earlier test fitted is not seen."""
    monkeypatch.setattr(bits, "QUICK_STEPS", STEPS)
    monkeypatch.setattr(size, "QUICK_STEPS", STEPS)
    monkeypatch.setattr(bits, "SETTINGS", {"3dgs": trained.DENSITY})
    monkeypatch.setattr(trained, "scene", tiny_scene)
    for kept in (bits._kept, size.model, size.quality, size.row):
        kept.cache_clear()


class Slow(Trainer):
    """A run whose steps take so many milliseconds."""

    def __init__(self, milliseconds: float) -> None:
        self.seconds, self.step = milliseconds / 1e3, 0

    def advance(self) -> dict[str, float]:
        self.step += 1
        time.sleep(self.seconds)
        return {"loss": 0.0}


def test_a_step_that_takes_thrice_as_long_is_measured_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(steps, "QUICK_TURNS", 5)
    both = [Slow(60), Slow(20)]
    found = steps._ratio("one over other", SMALL, both, reduced=True)
    assert statistics.median(found.values) == pytest.approx(3, rel=0.3)
    assert [one.step for one in both] == [steps.QUICK_WARM + 5 * steps.QUICK_TURN] * 2


def test_the_step_of_scaffold_is_one_of_as_many_anchors_as_are_said():
    found = run_check("scaffold_step", reduced=True)
    assert len(found.values) == steps.QUICK_TURNS
    assert f"of {steps.QUICK_ANCHORS:,} anchors, 400x300" in found.compared
    assert min(found.values) > 0


def test_bytes_that_differ_are_counted():
    assert bits.differing(b"abc", b"abc") == 0
    assert bits.differing(b"abc", b"abd") == 1
    assert bits.differing(b"abc", b"aXcde") == 3


@pytest.mark.usefixtures("short")
def test_ways_to_one_model_are_told_from_ways_to_two():
    for name in ("same_seed", "continued", "threads"):
        found = run_check(name, reduced=True)
        assert found.values == (0.0,), found
    assert run_check("other_seed", reduced=True).values[0] > 100


@pytest.mark.usefixtures("short")
def test_a_run_that_goes_on_from_elsewhere_is_seen(monkeypatch: pytest.MonkeyPatch):
    """A continued run that draws from another generator ends in other bytes."""
    fit = bits.fit

    def disturbed(method: str, steps: int, run: Run):
        return fit(method, steps, run if run.folder is None else Run(seed=1, **changed(run)))

    def changed(run: Run) -> dict:
        return {n: getattr(run, n) for n in ("folder", "threads", "checkpoint_seconds", "report")}

    monkeypatch.setattr(bits, "fit", disturbed)
    assert run_check("continued", reduced=True).values[0] > 100


@pytest.mark.usefixtures("short")
def test_files_come_back_and_a_changed_bit_is_seen(monkeypatch: pytest.MonkeyPatch):
    fitted = ExplicitModel(model=cloud())
    monkeypatch.setattr(bits, "fit", lambda *_: fitted)
    assert run_check("ply_copy", reduced=True).values == (0.0,)

    def rounded(path: Path):
        found, shift = read_ply(path)
        found.means[0, 0] += 1e-3
        return found, shift

    monkeypatch.setattr(bits, "read_ply", rounded)
    assert run_check("ply_copy", reduced=True).values[0] >= 1
    assert bits.in_memory(cloud()) != bits.in_memory(cloud(seed=1))


@pytest.mark.slow  # a process that imports everything; decoding itself is in tests/methods/storage
def test_a_packed_file_is_decoded_elsewhere(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bits, "fit", lambda *_: ExplicitModel(model=cloud()))
    assert run_check("packed_elsewhere", reduced=True).values == (0.0,)


def test_times_are_ratios_of_turns(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(speed, "QUICK_REPETITIONS", 2)
    found = speed.ratio("soft rank", (50,), "direct", "sorted", reduced=True, folder=Path())
    assert len(found.values) == 2
    assert min(found.values) > 0
    assert found.compared == "direct over sorted, 50, in turns in one process"
    with pytest.raises(MissingError, match="soft rank has no cuda on this machine: direct, sorted"):
        speed.ratio("soft rank", (50,), "cuda", "sorted", reduced=True, folder=Path())


def test_both_passes_are_timed_and_one_where_there_is_one():
    assert speed.shortest([(2.0, 3.0), (1.0, 5.0)]) == 5.0
    assert speed.shortest([(2.0, float("nan"))]) == 2.0


@pytest.mark.parametrize(
    "name", ["colour_error", "gradient_error", "decoding_error", "decoding_gradient_error"]
)
def test_errors_are_small_and_a_twin_that_is_off_is_seen(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    found = run_check(name, reduced=True)
    assert 0 < max(found.values) < 2e-5
    component = "anchors" if "decoding" in name else "rasterizer"
    evaluate = "splatproof.suites.studies.speed.judge.evaluate"
    from splatproof.suites.studies.speed import judge

    exact = judge.evaluate

    def off(twin, problem, ignored):
        value, gradients = exact(twin, problem, ignored)
        wrong = 1.01 if twin.name == COMPONENTS[component].usual else 1.0
        return wrong * value, {key: wrong * gradient for key, gradient in gradients.items()}

    monkeypatch.setattr(evaluate, off)
    assert max(run_check(name, reduced=True).values) > 2e-3


def test_a_seam_is_seen_where_it_is_and_nowhere_else():
    (at_wall,) = seam.gaps(True, reduced=True).values
    (inside,) = seam.gaps(False, reduced=True).values
    assert at_wall > 2
    assert inside < 0.5


@pytest.mark.usefixtures("short")
def test_sizes_are_those_of_the_files(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(size, "row", lambda name, *_: {
        "ply": {"bytes_each": 248.0, "primitives": 5, "psnr_change": 0.0},
        "spz 4": {"bytes_each": 20.0, "primitives": 5, "psnr_change": -0.5},
        size.OURS: {"bytes_each": 31.0, "primitives": 5, "psnr_change": -0.1},
    }[name])  # fmt: skip
    assert run_check("packed_over_ply").values == (8.0,)
    assert run_check("packed_over_spz").values == pytest.approx((20 / 31,), rel=1e-5)
    assert run_check("packed_loss").values == (0.1,)
    assert run_check("packed_above_spz").values == (0.4,)


@pytest.mark.usefixtures("short")
def test_what_is_decoded_is_counted_by_processor_time(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(size, "scene", tiny_scene)
    clock = iter(range(0, 100, 2))
    monkeypatch.setattr("time.process_time", lambda: next(clock))
    found = run_check("packed_decode", reduced=True)
    count = len(size.model(size.QUICK_STEPS).model)
    assert found.values == pytest.approx((count / 2e6,) * 3, rel=1e-5)
    assert run_check("packed_decode_fast", reduced=True).compared.startswith("fast, ")


@pytest.mark.usefixtures("short")
def test_a_row_of_the_study_of_sizes(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(size, "scene", tiny_scene)
    found = size.row("ply", True)
    assert found["bytes_each"] > 4 * 62  # and a header
    assert abs(found["psnr_change"]) < 1e-3


def test_what_a_machine_lacks_is_told_and_stops_nothing(monkeypatch: pytest.MonkeyPatch):
    def lacking(reduced: bool, folder: Path):
        raise MissingError("no such library:   install it")

    monkeypatch.setitem(registry.CHECKS, "same_seed", CHECKS["same_seed"].__class__(
        measure=lacking, unit="bytes", seconds=(1.0, 1.0)))  # fmt: skip
    found = run_check("same_seed")
    assert (found.values, found.error) == ((), "no such library: install it")
    with pytest.raises(UsageError, match="check: unknown 'same_sed', did you mean 'same_seed'"):
        run_check("same_sed")


def test_errors_are_a_value_a_twin_and_size():
    found = accuracy.errors("rasterizer", "max_abs_error", ((60, 32, 24), (80, 32, 24)))
    exact = [t for t in COMPONENTS["rasterizer"].twins if not t.approximates]
    assert len(found.values) == 2 * len(exact)
