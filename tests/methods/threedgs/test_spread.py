"""Density control by the spread of opacity gradients: who grows, how many, resumes, refusals."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from helpers.baking import baked
from helpers.killed_run import assert_continues
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.density import ErrorGate, Insertion, Mcmc, StrategicDensity
from splatproof.methods.threedgs.error_control import splats_of
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.settings import ThreeDGS
from splatproof.methods.threedgs.spread_control import SpreadControl
from splatproof.methods.training.loop import Trainer
from splatproof.reference.density import opacity_spread

RUN = Run(threads=1, seed=3)
SPREAD = StrategicDensity(
    strategy="spread", most=80, pace="even", scored_views=3, start=0, interval=10, least_interval=10,
    stop=25_000, reset_interval=0, gradient=0.0,
)  # fmt: skip
SHORT = ThreeDGS(iterations=60, sh_degree=1, density=SPREAD)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def control(**changed: Any) -> tuple[SpreadControl, Parameters]:
    density = replace(SPREAD, least_opacity=0.0, **changed)
    model, plan = prepare(tiny_scene(), replace(SHORT, density=density), RUN)
    assert isinstance(plan.density, SpreadControl)
    pulled_at(plan.density)
    return plan.density, model.parameters


def pulled_at(control: SpreadControl) -> None:
    """The loss pulled at each of 40 Gaussians in two views, from 0 to 1 in the mean."""
    control.gradient_sum, control.seen = torch.linspace(0, 2, 40), torch.full((40,), 2.0)


def test_who_grows_is_drawn_by_the_spread(monkeypatch: pytest.MonkeyPatch):
    found, rows = control()
    scores = torch.zeros(40)
    scores[7], scores[9] = 1.0, 3.0
    monkeypatch.setattr("splatproof.methods.threedgs.spread_control.spread", lambda tallies: scores)
    grown = []
    for seed in range(200):
        pulled_at(found)
        monkeypatch.setattr(found, "most_after", lambda step, count: count + 1)
        (edit,) = found.edits(10, rows, seeded(seed))
        assert edit.parents is not None
        assert len(edit.parents) == 41
        grown.append(int(edit.parents.bincount().argmax()))
    assert set(grown) == {7, 9}
    # 200 draws: a share of 0.75 by 0.03
    assert grown.count(9) / 200 == pytest.approx(0.75, abs=0.12)


def test_the_score_is_of_all_views_together():
    found, rows = control(scored_views=99)
    splats = splats_of(rows)
    views = found.scorer.chosen(seeded())
    assert len(views) == 5
    tallies = [found.scorer.tallied(10, view, splats) for view in views]
    together = opacity_spread.spread(torch.stack(tallies).sum(dim=0))
    assert (together > 0).sum() > 20
    # each view alone says other things
    assert not torch.allclose(together, opacity_spread.spread(tallies[0]))


def test_who_grows_is_scored_by_all_that_is_looked_at(monkeypatch: pytest.MonkeyPatch):
    found, rows = control(scored_views=99)
    heard: list[torch.Tensor] = []

    def listening(tallies: torch.Tensor) -> torch.Tensor:
        heard.append(tallies)
        return opacity_spread.spread(tallies)

    monkeypatch.setattr("splatproof.methods.threedgs.spread_control.spread", listening)
    list(found.edits(10, rows, seeded()))
    splats = splats_of(rows)
    views = found.scorer.chosen(seeded())
    wanted = torch.stack([found.scorer.tallied(10, view, splats) for view in views]).sum(dim=0)
    assert len(views) == 5
    torch.testing.assert_close(heard, [wanted])


@pytest.mark.parametrize(("gradient", "wanted"), [(0.0, 40), (0.5, 20), (1.1, 0)])
def test_as_many_grow_as_are_pulled_at(gradient, wanted):
    found, rows = control(gradient=gradient, most=None, pace="free")
    (edit,) = found.edits(10, rows, seeded())
    assert edit.parents is not None
    seen = 40 if wanted < 40 else len(edit.parents) - 40  # some show in no photo
    assert len(edit.parents) == 40 + min(wanted, seen)
    assert seen > 20
    # statistics start anew
    (edit,) = found.edits(20, rows, seeded())
    assert edit.parents is not None
    assert len(edit.parents) == 40


def test_nothing_grows_where_nothing_is_seen_or_no_room_is_left():
    for changed in ({"most": 40}, {"most": 41}):
        found, rows = control(**changed)
        (edit,) = found.edits(10, rows, seeded())
        assert edit.parents is not None
        assert len(edit.parents) == 40


def test_as_many_are_added_each_time_up_to_the_cap():
    trainer = Trainer(
        *prepare(tiny_scene(), replace(SHORT, density=replace(SPREAD, least_opacity=0.0)), RUN), RUN
    )
    counts = []
    while trainer.step < 60:
        trainer.advance()
        counts.append(len(trainer.model.parameters))
    assert counts[9] == 40 + 40 // 4  # passes at 10, 20, 30 and 40
    assert counts[-1] == 80


@pytest.mark.parametrize("seed", [3, 4])
def test_the_same_seed_gives_the_same_model_and_another_another(seed):
    one, again = (baked(fit(tiny_scene(), SHORT, replace(RUN, seed=s))) for s in (seed, 3))
    assert (one.means.shape == again.means.shape and torch.equal(one.means, again.means)) == (
        seed == 3
    )


def test_a_killed_run_continues_bit_for_bit(tmp_path):
    assert_continues(replace(SHORT, density=replace(SPREAD, reset_interval=20)), RUN, 30, tmp_path)


def test_a_gaussian_alone_and_one_view_alone_are_enough():
    assert len(baked(fit(tiny_scene(views=2, points=1), SHORT, RUN)).means) >= 1


@pytest.mark.parametrize(
    ("density", "said"),
    [
        (
            replace(SPREAD, split_gradient=1e-3),
            "density.split_gradient is 0.001, expected 0.0, its",
        ),
        (replace(SPREAD, insertion=Insertion(share=0.1)), "density.insertion.share is 0.1"),
        (replace(SPREAD, mcmc=Mcmc(growth=0.1)), "density.mcmc.growth is 0.1, expected 0.05"),
        (replace(SPREAD, error=ErrorGate(pixels=1.0)), "density.error.pixels is 1.0"),
    ],
)
def test_a_setting_that_the_strategy_does_not_look_at_is_refused(density, said):
    with pytest.raises(UsageError, match=said):
        ThreeDGS(density=density)


def test_a_backend_that_tells_no_fragments_is_refused():
    with pytest.raises(UsageError, match="'spread', and backend reference does not tell"):
        prepare(tiny_scene(), SHORT, replace(RUN, backend="reference"))
