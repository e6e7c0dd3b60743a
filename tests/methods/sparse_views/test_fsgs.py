"""Method fsgs: what unpooling makes, when it resets, its depth term, and that off means off."""

from dataclasses import replace

import pytest
import torch

from helpers.baking import baked
from helpers.prior_scenes import plane_scene
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.priors.oracle import prior_of
from splatproof.methods.registry import get_method
from splatproof.methods.sparse_views.density import SparseControl, SparseDensity
from splatproof.methods.sparse_views.fsgs import (
    Fsgs,
    FsgsControl,
    FsgsDensity,
    depth_term,
    fit,
    prepare,
)  # fmt: skip
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.reference.types.scene import Scene

DENSITY = FsgsDensity(start=0, interval=10, least_interval=10, gradient=1e-5, unpool_distance=0.8)
SHORT = Fsgs(iterations=60, sh_degree=1, density=DENSITY)
RUN = Run(threads=1, seed=3)


def with_prior(*, of: float = 1.0) -> Scene:
    """The plane, each training view with its true disparity times a factor as a prior."""
    scene = plane_scene()

    def prior(view):
        assert view.load_depth is not None
        known = prior_of(view.load_depth())
        return replace(known, disparity=of * known.disparity)

    views = [replace(v, load_prior=lambda v=v: prior(v)) for v in scene.views]
    return replace(scene, views=tuple(views))


def test_resets_come_at_the_steps_of_the_release():
    control = SparseControl(SparseDensity(), iterations=30_000, extent=1.0)
    assert [s for s in range(1, 30_001) if control.resets(s)] == [6003, 15003, 24003]
    short = SparseControl(SparseDensity(), iterations=10_000, extent=1.0)
    assert [s for s in range(1, 10_001) if short.resets(s)] == [2001, 5001, 8001]
    never = SparseControl(SparseDensity(reset_interval=0), iterations=10_000, extent=1.0)
    assert not any(never.resets(s) for s in range(1, 10_001))


def test_a_reset_leaves_0_05_and_forgets():
    model, plan = prepare(tiny_scene(), SHORT, RUN)
    assert isinstance(plan.density, FsgsControl)
    edit = plan.density.reset(model.parameters)
    assert float(edit.values["opacity_logits"].sigmoid().max()) == pytest.approx(0.05, rel=1e-5)
    assert edit.forget == {"opacity_logits"}


def test_what_is_unpooled_lies_half_way_grey_and_upright_with_the_neighbours_looks():
    model, plan = prepare(tiny_scene(points=15), SHORT, RUN)
    control, parameters = plan.density, model.parameters
    assert isinstance(control, FsgsControl)
    generator = torch.Generator().manual_seed(0)
    for name, value in parameters.rows.items():
        parameters.rows[name] = torch.randn(value.shape, generator=generator)
    control.unpool_distance = 1.5
    before = {name: value.clone() for name, value in parameters.rows.items()}
    edit = control.unpool(parameters, None)
    parameters.edit(edit)
    added = len(parameters) - 15
    assert added > 0
    assert added % 3 == 0
    now = parameters.rows
    assert edit.fresh is not None
    assert edit.parents is not None
    assert edit.fresh.tolist() == [False] * 15 + [True] * added
    assert all(torch.equal(now[name][:15], before[name]) for name in before)
    of = edit.parents[15:]
    for name in ("log_scales", "opacity_logits"):
        assert torch.equal(now[name][15:], before[name][of])
    assert not now["sh_dc"][15:].any()
    assert not now["sh_rest"][15:].any()
    assert now["quaternions"][15:].tolist() == [[1, 0, 0, 0]] * added
    sources = 2 * now["means"][15:] - before["means"][of]
    assert torch.cdist(sources, before["means"]).amin(dim=1).max() < 1e-5


def test_unpooling_keeps_to_the_cap_and_ends():
    capped = replace(SHORT, density=replace(DENSITY, most=50, unpool_distance=0.0))
    assert len(baked(fit(tiny_scene(), capped, RUN)).means) <= 50
    free = replace(capped, density=replace(DENSITY, unpool_distance=0.0))
    off = replace(free, density=replace(free.density, unpool_stop=0))
    sizes = [len(baked(fit(tiny_scene(), each, RUN)).means) for each in (free, off)]
    assert sizes[0] > 2 * sizes[1]


def test_with_all_of_it_off_it_is_3dgs():
    density = replace(
        DENSITY, unpool_stop=0, reset_interval=0, largest_size=0.1, stop=15_000, interval=10
    )
    ours = replace(SHORT, density=density, sh_interval=1000)
    plain = Settings(
        iterations=60, sh_degree=1, density=replace(density, first_reset=1), sh_interval=1000
    )
    one, other = fit(tiny_scene(), ours, RUN), get_method("3dgs").fit(tiny_scene(), plain, RUN)
    assert all(torch.equal(getattr(baked(one), n), getattr(baked(other), n)) for n in FIELDS)


def test_the_depth_term_falls_while_it_alone_is_followed_and_is_off_where_no_view_has_a_prior():
    scene = with_prior()
    told = []
    facts = {}
    run = replace(
        RUN, report=lambda step, total, values: told.append(values["depth correlation"]),
        on_fact=facts.__setitem__,
    )  # fmt: skip
    settings = Fsgs(iterations=200, sh_degree=0, depth_weight=50.0)
    fit(scene, settings, run)
    assert sum(told[9:18]) < 0.7 * sum(told[:9])  # the last steps weigh 0.02
    assert facts["depth correlated"] == "4 of 4 views"
    fit(tiny_scene(), SHORT, replace(RUN, on_fact=facts.__setitem__))
    assert facts["depth correlated"] == "0 of 5 views"
    assert facts["gradients by"] == "kernels"


def test_the_weight_of_depth_ends_low():
    model, plan = prepare(with_prior(), replace(SHORT, iterations=100), RUN)
    trainer = Trainer(model, plan, RUN)
    view = plan.views[0]
    trainer.step = 95
    early, _ = trainer.backward(view)
    trainer.step = 96
    late, _ = trainer.backward(view)
    name = depth_term(1.0).name
    assert late[name] == pytest.approx(0.02 * early[name], rel=1e-4)


def test_another_prior_is_another_run():
    scene = with_prior()
    facts = [scene.facts | {"depth_prior_sha256": each} for each in ("one", "other")]
    keys = {prepare(replace(scene, facts=f), SHORT, RUN)[1].key for f in facts}
    assert len(keys) == 2


def test_bad_settings_are_refused():
    with pytest.raises(UsageError, match="depth_weight is -1.0, expected >= 0"):
        Fsgs(depth_weight=-1.0)
    with pytest.raises(UsageError, match="density.reset_opacity is 1.0, expected between 0 and 1"):
        SparseDensity(reset_opacity=1.0)
    with pytest.raises(UsageError, match="density.unpool_distance"):
        FsgsDensity(unpool_distance=-0.1)
