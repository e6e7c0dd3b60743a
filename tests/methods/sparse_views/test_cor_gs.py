"""Method cor-gs: the fields are trained apart, checked against each other, and the first is the result."""

from dataclasses import replace

import pytest
import torch

from helpers.baking import baked
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method
from splatproof.methods.sparse_views.cor_gs import CoControl, CorGS, fit, prepare
from splatproof.methods.sparse_views.density import SparseControl, SparseDensity
from splatproof.methods.sparse_views.twin_fields import (
    FIELD,
    SECOND,
    Paired,
    field_of,
    in_both,
    of_other_field,
)  # fmt: skip
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer

DENSITY = SparseDensity(start=0, interval=10, least_interval=10, gradient=1e-5)
SHORT = CorGS(iterations=50, sh_degree=1, density=DENSITY, agreement_start=0)
ALONE = replace(
    SHORT, agreement_weight=0.0, prune_interval=0, random_background=False,
    density=replace(DENSITY, start=30_000, reset_interval=0),
)  # fmt: skip
RUN = Run(threads=1, seed=3)


def test_views_come_in_pairs_and_a_view_knows_its_field():
    views = in_both(tiny_scene().train_views)
    order, generator = Paired(5), torch.Generator().manual_seed(0)
    seen = [order.next(generator) for _ in range(10)]
    assert sorted(seen) == list(range(10))
    assert [b - a for a, b in zip(seen[::2], seen[1::2], strict=True)] == [5] * 5
    assert [field_of(views[i]) for i in seen] == [0, 1] * 5
    for view in views:
        assert field_of(of_other_field(view)) == 1 - field_of(view)
        assert of_other_field(of_other_field(view)).name == view.name
    assert views[5].name == SECOND + views[0].name


def test_each_field_is_drawn_alone():
    model, plan = prepare(tiny_scene(), SHORT, RUN)
    model.parameters.rows["means"][model.rows_of(1)] += 5
    for view in (plan.views[0], plan.views[5]):
        splats = model.splats(view, TRAINED)
        assert splats.rows is not None
        assert (model.parameters.labels[FIELD][splats.rows] == field_of(view)).all()
        assert torch.equal(splats.means, model.parameters.rows["means"][splats.rows])
    assert torch.equal(model.gaussians().means, model.parameters.rows["means"][model.rows_of(0)])


def test_neither_field_gets_a_gradient_from_the_others_views():
    model, plan = prepare(tiny_scene(), SHORT, RUN)
    trainer = Trainer(model, plan, RUN)
    trainer.step = 10  # both terms are on
    for view in (plan.views[1], plan.views[6]):
        trainer.backward(view)
        for value in model.parameters.rows.values():
            assert value.grad is not None
            assert not value.grad[model.rows_of(1 - field_of(view))].any()
        moved = model.parameters.rows["means"].grad
        assert moved is not None
        assert moved[model.rows_of(field_of(view))].any()
        for value in model.parameters.rows.values():
            value.grad = None


def test_without_its_parts_a_field_is_3dgs():
    plain = Settings(
        iterations=50,
        sh_degree=1,
        sh_interval=1500,
        density=Density(start=30_000, reset_interval=0),
    )
    # the mean over two views halves gradients, of which Adam sees the sign and shape: not the same
    # bits, since its epsilon and roundings stay
    torch.testing.assert_close(
        baked(fit(tiny_scene(), ALONE, RUN)).means,
        baked(get_method("3dgs").fit(tiny_scene(), plain, RUN)).means, atol=2e-3, rtol=0,
    )  # fmt: skip


def test_equal_fields_agree_and_lose_nothing():
    model, plan = prepare(tiny_scene(), SHORT, RUN)
    trainer = Trainer(model, plan, RUN)
    trainer.step = 10
    values, _ = trainer.backward(plan.views[0])
    assert values["co-regularisation"] == pytest.approx(0, abs=1e-6)
    assert isinstance(plan.density, CoControl)
    edit = plan.density.co_prune(model.parameters)
    assert edit.parents is not None
    assert edit.parents.tolist() == list(range(len(model.parameters)))


def test_what_only_one_field_has_is_pruned_from_both_by_the_same_fields():
    model, plan = prepare(tiny_scene(points=20), SHORT, RUN)
    control, rows = plan.density, model.parameters.rows
    assert isinstance(control, CoControl)
    control.prune_distance = 1.0
    rows["means"][3] += 50
    rows["means"][20 + 7] -= 50
    edit = control.co_prune(model.parameters)
    assert edit.parents is not None
    assert sorted(set(range(40)) - set(edit.parents.tolist())) == [3, 27]
    rows["means"][20:] += 500
    edit = control.co_prune(model.parameters)
    assert edit.parents is not None
    assert len(edit.parents) == 40  # nothing would be left of either


def test_the_first_co_pruning_comes_after_two_intervals(monkeypatch):
    """As in the release."""
    model, plan = prepare(tiny_scene(points=20), SHORT, RUN)
    control, asked = plan.density, []
    assert isinstance(control, CoControl)
    control.prune_interval = 5
    monkeypatch.setattr(SparseControl, "edits", lambda *_: iter(()))
    monkeypatch.setattr(CoControl, "co_prune", lambda *_: asked.append(step))
    for step in range(1, 21):
        list(control.edits(step, model.parameters, torch.Generator()))
    assert asked == [10, 15, 20]


def test_a_disagreement_is_lowered():
    told = []
    run = replace(RUN, report=lambda s, t, values: told.append(values["co-regularisation"]))
    # with resets and pruning few rows are left of so short a run: 2 to 5, of which nothing can be said
    whole = replace(DENSITY, stop=9000, reset_interval=0, largest_size=10.0)
    shown = replace(SHORT, iterations=60, prune_interval=0, density=whole)
    both = [replace(shown, agreement_weight=w) for w in (1e-9, 1.0)]
    ends = []
    for settings in both:
        told.clear()
        fit(tiny_scene(views=3), settings, run)
        ends.append(sum(told[4:]) / settings.agreement_weight)
    assert 0 < ends[1] < 0.5 * ends[0], "0.09 to 0.14 of it with three seeds"


def test_the_result_is_the_first_field_alone():
    fitted = fit(tiny_scene(), ALONE, RUN)
    assert fitted.primitives == 40


def test_bad_settings_are_refused():
    with pytest.raises(UsageError, match="prune_distance is -1.0, expected >= 0"):
        CorGS(prune_distance=-1.0)
    with pytest.raises(UsageError, match="exposure is 'gain', expected off"):
        CorGS(exposure="gain")
