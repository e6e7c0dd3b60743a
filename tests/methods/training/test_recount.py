"""A training whose number of steps is told on the way goes on to it, also after a kill."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.methods.auto.recount import MEASURED, Recount
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.session import train

SETTINGS = Settings(iterations=40, sh_degree=1, resolution=Resolution(coarsest=2.0, full_from=1.0))


class Killed(Exception):
    """Stands for a kill between two steps."""


def trained(run: Run, steps: int | None = 60):
    told = []

    def recount(step, seconds):
        assert seconds >= 0
        told.append(step)
        return steps if step == 25 else None

    def prepared():
        model, plan = prepare(tiny_scene(), SETTINGS, run)
        return model, replace(plan, recount=recount)

    return train(run, prepared).gaussians(), told


@pytest.mark.parametrize("steps", [60, 30])
def test_more_steps_or_fewer(steps):
    last = []
    run = Run(threads=1, report=lambda step, total, values: last.append((step, total)))
    _, told = trained(run, steps)
    assert told == list(range(1, steps + 1))
    assert last[-1] == (steps, steps)


@pytest.mark.parametrize(("full_from", "smaller"), [(1.0, True), (0.5, False)])
def test_photos_keep_the_size_that_they_have_reached(full_from, smaller):
    """By the speed of steps on them the number was told."""
    run, resolution = Run(threads=1), Resolution(coarsest=2.0, full_from=full_from)
    model, plan = prepare(tiny_scene(), replace(SETTINGS, resolution=resolution), run)
    trainer, view = Trainer(model, plan, run), plan.views[0]
    while trainer.step < 25:
        trainer.advance()
    before = trainer.sized(view).camera.width
    assert (before < view.camera.width) == smaller
    for steps in (60, 90):
        trainer.recounted(steps)
        while trainer.step < steps - 1:
            trainer.advance()
            assert trainer.sized(view).camera.width == before
    trainer.recounted(10)
    assert trainer.plan.steps == trainer.step, "those that are done are"


@pytest.mark.parametrize("at", [20, pytest.param(30, marks=pytest.mark.slow)])
def test_a_killed_run_keeps_the_number(tmp_path, at):
    def killing(step, total, values):
        if step == at:
            raise Killed

    run = Run(threads=1, folder=tmp_path, checkpoint_seconds=0.0)
    straight, _ = trained(Run(threads=1))
    with pytest.raises(Killed):
        trained(replace(run, report=killing))
    again, told = trained(run)
    assert torch.equal(straight.means, again.means)
    assert told[0] == at, "the step whose report was interrupted comes again"


def test_seconds_are_filled_at_the_speed_that_was_measured():
    """Half a second a step from step 601 on: of 600 s, those that are left are divided by it."""
    told = []
    settings = Settings(iterations=1000, resolution=Resolution(coarsest=2.0, full_from=0.6))
    recount = Recount(settings, 600.0, 5000, told.append)
    assert recount(600, 100.0) is None
    for step in range(601, 601 + MEASURED):
        assert recount(step, 100 + 0.5 * (step - 601)) is None
    total = 601 + 1000
    assert recount(601 + MEASURED, 100 + 0.5 * MEASURED) == total
    half = 601 + MEASURED + (1000 - MEASURED) // 2
    assert all(recount(step, 0.0) is None for step in range(602 + MEASURED, half))
    slower = 100 + 0.8 * (half - 601)
    assert recount(half, slower) == half + int((600 - slower) / 0.8), "the machine became slower"
    assert recount(2000, 700.0) == 2000, "nothing is left"


def test_no_more_steps_are_told_than_the_most():
    told = []
    recount = Recount(Settings(iterations=1000), 600.0, 1200, told.append)
    for step in range(1, 1000):
        recount(step, 0.01 * step)
    assert told[-1] == 1200
    assert set(told) == {1000, 1200}, "as many as planned while Gaussians become more"


def seconds_taken(
    settings: Settings, seconds: float, *, slow: float, at: float
) -> tuple[float, list[int]]:
    """Seconds of a run whose steps fill its seconds as planned, on a machine that is `slow` times slower from a share
    `at` of the seconds on, and all numbers of steps that were told. Gaussians become ten times as many by the middle."""
    planned = settings.iterations

    def price(step: int) -> float:
        grown = min(1.0, max(0.0, (step - 0.05 * planned) / (0.45 * planned)))
        return 1 / settings.resolution.factor(step, planned) ** 2 + 0.1 + 0.9 * grown

    unit = seconds / sum(price(step) for step in range(1, planned + 1))
    told: list[int] = []
    recount, step, total, taken = Recount(settings, seconds, 10**6, told.append), 0, planned, 0.0
    while step < total:
        step += 1
        taken += price(step) * unit * (slow if taken >= at * seconds else 1.0)
        total = max(recount(step, taken) or total, step)
    return taken, told


@pytest.mark.parametrize("slow", [2.0, 4.0])
@pytest.mark.parametrize("at", [0.0, 0.3, 0.6, 0.9])
@pytest.mark.parametrize(("steps", "coarsest"), [(300, 2.0), (2000, 1.0), (2000, 8.0)])
def test_a_machine_that_becomes_slower_ends_in_its_seconds(slow, at, steps, coarsest):
    """It took up to 2.4 times as long where it was slow from the first step on: nobody looked before half of the steps."""
    settings = Settings(iterations=steps, resolution=Resolution(coarsest=coarsest, full_from=0.3))
    taken, _ = seconds_taken(settings, 60.0, slow=slow, at=at)
    assert 0.95 * 60 < taken < 1.05 * 60


@pytest.mark.parametrize("coarsest", [1.0, 2.0])
def test_on_a_steady_machine_no_step_is_taken_away_while_gaussians_become_more(coarsest):
    settings = Settings(iterations=2000, resolution=Resolution(coarsest=coarsest, full_from=0.3))
    taken, told = seconds_taken(settings, 60.0, slow=1.0, at=0.0)
    assert 2000 <= max(told) <= 2010
    assert min(told) >= 1990
    assert taken == pytest.approx(60.0, rel=0.01)


def test_steps_that_were_taken_away_come_back_with_the_speed():
    """While Gaussians become more, never more of them than were planned."""
    recount = Recount(Settings(iterations=1000), 100.0, 5000, lambda _: None)
    assert recount(101, 10.0) is None
    shorter = recount(101 + MEASURED, 10.0 + 1.0 * MEASURED)
    assert shorter == 101 + MEASURED + int(60 / 1.0)
    assert recount(101 + 2 * MEASURED, 40.0 + 0.01 * MEASURED) == 1000


def test_a_run_ends_with_its_seconds_but_not_before_its_least_steps():
    recount = Recount(Settings(iterations=1000), 10.0, 5000, lambda _: None)
    assert recount(99, 11.0) is None
    assert recount(100, 11.0) == 100
