"""Density control by relocation, by errors of several views, and by insertion: rules, caps, resumes, refusals."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from helpers.baking import baked
from helpers.killed_run import assert_continues
from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.threedgs.density import ErrorGate, Insertion, Mcmc, StrategicDensity
from splatproof.methods.threedgs.error_control import ErrorControl, splats_of
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.insertion import by_weight, inserted, lifted
from splatproof.methods.threedgs.mcmc import McmcControl, drawn
from splatproof.methods.threedgs.scored_views import ScoredView, ViewScorer
from splatproof.methods.threedgs.settings import Settings, ThreeDGS
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.schedules import Rates
from splatproof.methods.training.terms import mean_scale
from splatproof.reference.density.multi_view_error import evidence
from splatproof.reference.rasterizer import compositing, projection, rotation
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.rasterizer.screen_gradient import pixel_offsets
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.splats import activated

RUN = Run(threads=1, seed=3)
OFTEN: dict[str, Any] = {
    "start": 0,
    "interval": 10,
    "least_interval": 10,
    "stop": 25_000,
    "reset_interval": 0,
}
MCMC = StrategicDensity(strategy="mcmc", most=60, mcmc=Mcmc(spread=0.5), **OFTEN)
IN_PLACE = replace(MCMC, mcmc=Mcmc())
ERROR = StrategicDensity(
    strategy="error", most=80, gradient=1e-5, scored_views=3, **OFTEN,
    error=ErrorGate(pixels=0.5, blame=0.95), insertion=Insertion(share=0.1),
)  # fmt: skip
SHORT = ThreeDGS(iterations=60, sh_degree=1, density=MCMC)


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def parameters(opacities: Tensor) -> Parameters:
    """Rows of so many random Gaussians with some opacities."""
    start = replace(random_gaussians(len(opacities)), opacity_logits=opacities.logit())
    return GaussianModel(start, Rates(), extent=1.0).parameters


def moves(density: StrategicDensity = MCMC, *, extent: float = 1.0) -> McmcControl:
    return McmcControl(
        density, iterations=60, extent=extent, rate=lambda step, total: 1e-4 * extent
    )


def only(edits) -> Edit:
    (edit,) = edits
    return edit


# --- relocation


def test_what_is_dead_becomes_a_copy_and_what_it_copies_a_stack():
    rows = parameters(torch.tensor([0.001, 0.9, 0.002, 0.0049]))
    before = {name: value.clone() for name, value in rows.rows.items()}
    edit = only(moves(IN_PLACE).relocate(rows, seeded()))
    assert edit.fresh is not None
    assert edit.fresh.tolist() == [False, True, False, False]  # those that move keep their moments
    rows.edit(edit)
    assert len(rows) == 4
    for name in ("means", "quaternions", "sh_dc", "sh_rest"):
        assert torch.equal(rows.rows[name], before[name][1].expand_as(before[name]))
    together = 1 - (1 - rows.rows["opacity_logits"].sigmoid().double()).prod()
    assert float(together) == pytest.approx(0.9, rel=1e-5)
    assert rows.rows["log_scales"].unique(dim=0).shape[0] == 1
    assert (rows.rows["log_scales"][0] < before["log_scales"][1]).all()


@pytest.mark.parametrize("opacities", [[0.001, 0.001], [0.5, 0.9], [0.001], [0.9]])
def test_nothing_moves_where_nothing_or_all_is_dead(opacities):
    assert list(moves().relocate(parameters(torch.tensor(opacities)), seeded())) == []


def test_the_living_are_drawn_by_opacity_and_untouched_rows_keep_their_bits():
    opacities = torch.cat([torch.full((3000,), 0.001), torch.tensor([0.1, 0.3, 0.6])])
    rows = parameters(opacities)
    before = {name: value.clone() for name, value in rows.rows.items()}
    edit = only(moves(IN_PLACE).relocate(rows, seeded()))
    assert edit.fresh is not None
    same = edit.values["means"][:3000, None] == before["means"][None, 3000:]
    shares = same.all(dim=2).double().mean(dim=0)
    # 3,000 draws: a share of 0.6 by sqrt(0.24 / 3000) = 0.009
    torch.testing.assert_close(shares, torch.tensor([0.1, 0.3, 0.6]).double(), atol=0.04, rtol=0)
    # a stack of more than 51 is made as one of 51, and no fainter than what counts as dead
    raised = edit.values["opacity_logits"].sigmoid()
    assert raised.min() >= 0.005 * (1 - 1e-5)
    idle = parameters(torch.cat([torch.tensor([0.001, 0.999]), torch.full((5,), 0.5)]))
    kept = {name: value.clone() for name, value in idle.rows.items()}
    edit = only(moves().relocate(idle, seeded()))
    assert edit.fresh is not None
    still = ~edit.fresh
    still[0] = False
    assert int(still.sum()) == 5
    for name, value in kept.items():
        assert torch.equal(edit.values[name][still], value[still])


def test_an_opaque_one_under_many_copies_stays_finite():
    rows = parameters(torch.cat([torch.full((200,), 0.001), torch.tensor([0.5])]))
    rows.rows["opacity_logits"][-1] = 60.0  # an opacity of 1 in float32
    rows.edit(only(moves().relocate(rows, seeded())))
    assert all(value.isfinite().all() for value in rows.rows.values())


@pytest.mark.parametrize(("count", "most", "wanted"), [(40, 60, 42), (59, 60, 60), (60, 60, 60),
                                                       (61, 60, 61), (1, 60, 1)])  # fmt: skip
def test_growth_is_a_share_up_to_the_cap(count, most, wanted):
    rows = parameters(torch.full((count,), 0.5))
    for edit in moves(replace(MCMC, most=most)).grow(rows, seeded()):
        assert edit.parents is not None
        assert edit.fresh is not None
        assert bool(edit.fresh[count:].all())
        assert torch.equal(edit.fresh[:count].nonzero()[:, 0], edit.parents[count:].unique())
        rows.edit(edit)
    assert len(rows) == wanted


def test_copies_are_spread_by_their_own_shape_and_what_they_copy_stays():
    rows = parameters(torch.cat([torch.full((4000,), 0.001), torch.tensor([0.5])]))
    before = {name: value.clone() for name, value in rows.rows.items()}
    wide = moves(replace(MCMC, mcmc=Mcmc(spread=2.0)))
    rows.edit(only(wide.relocate(rows, seeded())))
    assert torch.equal(rows.rows["means"][-1], before["means"][-1])
    away = (rows.rows["means"][:-1] - before["means"][-1]).double()
    shape = rotation.covariance(rows.rows["quaternions"][:1], rows.rows["log_scales"][:1].exp())
    # 4,000 draws: a covariance by 2 / sqrt(4000) = 0.03 of itself
    torch.testing.assert_close(away.T.cov(), 4 * shape[0].double(), rtol=0.15,
                               atol=0.15 * float(4 * shape.max()))  # fmt: skip
    count = len(rows)
    (edit,) = moves(replace(wide.settings, most=5000)).grow(rows, seeded())
    assert torch.equal(edit.values["means"][:count], rows.rows["means"])


def test_noise_depends_on_no_unit_and_spares_the_opaque():
    rows = parameters(torch.tensor([0.001, 0.1, 0.9999]))
    moved = only([moves().shake(1, rows, seeded())]).values["means"] - rows.rows["means"]
    far = parameters(torch.tensor([0.001, 0.1, 0.9999]))
    for name, value in rows.rows.items():
        far.rows[name] = value.clone()
    far.rows["means"] = 100 * rows.rows["means"]
    far.rows["log_scales"] = rows.rows["log_scales"] + torch.tensor(100.0).log()
    again = moves(extent=100.0).shake(1, far, seeded()).values["means"] - far.rows["means"]
    # differences of places near 100, which float32 has to 8e-6
    torch.testing.assert_close(again / 100, moved, atol=1e-6, rtol=1e-4)
    assert moved[0].abs().max() > 1e-3
    assert not moved[1:].any()


def test_draws_are_by_weight_and_never_of_weight_0():
    found = drawn(torch.tensor([0.0, 1.0, 3.0, 0.0]), 4000, seeded())
    assert set(found.tolist()) == {1, 2}
    # 4,000 draws: a share of 0.75 by 0.007
    assert float((found == 2).double().mean()) == pytest.approx(0.75, abs=0.03)


def test_the_term_of_mean_scale_is_its_gradient():
    rows = Parameters({"log_scales": torch.linspace(-2, 1, 9).reshape(3, 3)})
    rows.rows["log_scales"].grad = torch.zeros(3, 3)
    value = mean_scale(0.3, 4.0).add(rows)
    wanted = rows.rows["log_scales"].clone().requires_grad_()
    loss = 0.3 * wanted.exp().mean() / 4
    loss.backward()
    assert value == pytest.approx(float(loss.detach()))
    torch.testing.assert_close(rows.rows["log_scales"].grad, wanted.grad)


def test_a_run_grows_to_the_cap_and_shakes_after_every_step():
    trainer = Trainer(*prepare(tiny_scene(), SHORT, RUN), RUN)
    still = replace(SHORT, density=replace(MCMC, mcmc=Mcmc(noise=0.0)))
    other = Trainer(*prepare(tiny_scene(), still, RUN), RUN)
    told = trainer.advance()
    other.advance()
    assert "mean scale" in told
    assert not torch.equal(*(t.model.parameters.rows["means"] for t in (trainer, other)))
    trainer.train()
    assert len(trainer.model.parameters) == 48  # 42, 44, 46, 48: the pass after stops at step 50


# --- errors of several views


def scorer(**changed) -> ViewScorer:
    usual = ViewScorer(
        views=tiny_scene().train_views, count=3, backend=get_backend("cpu"), mode="classic",
        background=(0.0, 0.0, 0.0), resolution=Resolution(), total=60, dssim=0.2,
    )  # fmt: skip
    return replace(usual, **changed)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_evidence_is_the_sum_of_weights_over_marked_pixels(backend):
    model, where = random_gaussians(30), camera(2)
    marks = torch.rand(where.height, where.width, generator=seeded()) > 0.6
    found = scorer(backend=get_backend(backend)).evidence(where, activated(model), marks)
    half = rotation.half_covariance(model.quaternions, model.scales)
    flat = projection.project(where, model.means, half)
    order = torch.where(flat.in_front)[0]
    order = order[torch.sort(flat.depths[order], stable=True).indices]
    rows, columns = torch.meshgrid(
        torch.arange(where.height), torch.arange(where.width), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2) + 0.5
    offsets = pixel_offsets(pixels, flat.means, None)[:, order]
    weights, _ = compositing.weights(
        compositing.alphas(offsets, flat.conics[order], model.opacities[order])
    )
    want = torch.zeros(30)
    want[order] = evidence(weights, marks.flatten())
    # float32 sums over 432 pixels in another order
    torch.testing.assert_close(found, want, rtol=1e-4, atol=1e-4)
    assert (found > 1).any()


def test_views_are_drawn_without_replacement_and_as_large_as_the_steps():
    model = activated(random_gaussians(20))
    small = scorer(resolution=Resolution(coarsest=1.5, full_from=0.5))
    found = small.drawn(1, model, seeded())
    assert len(found) == 3
    assert len({float(view.camera.world_to_camera[0, 3]) for view in found}) == 3
    assert {(view.camera.width, view.factor) for view in found} == {(16, 1.5)}
    assert {view.camera.width for view in small.drawn(60, model, seeded())} == {24}
    assert len(scorer(count=99).drawn(1, model, seeded())) == 5
    again = small.drawn(1, model, seeded())
    assert all(torch.equal(a.image, b.image) for a, b in zip(found, again, strict=True))


def gated(**rules: float) -> tuple[ErrorControl, Parameters]:
    density = replace(ERROR, insertion=Insertion(), error=ErrorGate(**rules), least_opacity=0.0)
    settings = ThreeDGS(iterations=60, sh_degree=1, density=density)
    model, plan = prepare(tiny_scene(), settings, RUN)
    control = plan.density
    assert isinstance(control, ErrorControl)
    control.gradient_sum = control.seen = torch.ones(len(model.parameters))
    control.absolute_sum = torch.zeros(len(model.parameters))
    return control, model.parameters


def test_only_what_views_agree_on_grows():
    control, rows = gated(pixels=5.0)
    found = torch.zeros(2, 40)
    found[:, 7] = torch.tensor([4.0, 8.0])
    found[0, 9] = 9.0  # one view alone
    edit, *rest = control.gated(10, rows, seeded(), found, torch.ones(2), None)
    assert rest == []
    assert edit.parents is not None
    assert edit.parents.bincount(minlength=40).nonzero()[:, 0].tolist() == list(range(40))
    assert (edit.parents.bincount() == 2).nonzero()[:, 0].tolist() == [7]


def test_blame_follows_its_rows_through_the_densification():
    control, rows = gated(pixels=5.0, blame=0.9)
    found = torch.full((2, 40), 1.0)
    found[:, 3] = 20.0  # it grows; a split takes its row out of the middle
    found[:, 30] = 19.5
    control.gradient_sum[30] = 0.0  # nothing pulls at this one
    before = rows.rows["means"].clone()
    for edit in control.gated(10, rows, seeded(), found, torch.ones(2), None):
        rows.edit(edit)
    kept = (rows.rows["means"][:, None] == before).all(dim=2).any(dim=0)
    assert not kept[30]
    assert int((~kept).sum()) <= 2


def test_nothing_marked_lets_nothing_grow_and_removes_nothing():
    control, rows = gated(pixels=0.0, blame=0.5)
    (edit,) = control.gated(10, rows, seeded(), torch.zeros(2, 40), torch.ones(2), None)
    assert edit.parents is not None
    assert edit.parents.tolist() == list(range(40))


# --- insertion


def view(error: Tensor, depth: Tensor, valid: Tensor | None = None) -> ScoredView:
    truth = torch.full((18, 24, 3), 0.25)
    return ScoredView(
        camera=camera(2), factor=1.0, image=truth + error[:, :, None], truth=truth, valid=valid,
        depth=depth, loss=1.0,
    )  # fmt: skip


def test_new_gaussians_lie_on_their_pixels_at_the_depth_of_the_render():
    depth = 2 + torch.rand(18, 24, generator=seeded())
    error = torch.zeros(18, 24)
    error[3, 5] = error[10, 20] = 0.5
    made = inserted([view(error, depth)], 9, size=2.0, opacity=0.3, generator=seeded())
    pixels, depths = project_points(camera(2), made["means"])
    assert {tuple(round(float(part), 3) for part in place) for place in pixels} == {
        (5.5, 3.5), (20.5, 10.5)
    }  # fmt: skip
    torch.testing.assert_close(sorted(depths), sorted([depth[3, 5], depth[10, 20]]))
    torch.testing.assert_close(made["log_scales"].exp()[:, 0], 2.0 * depths / (1.6 * 24))
    assert made["opacity_logits"].sigmoid().tolist() == pytest.approx([0.3, 0.3])
    assert made["quaternions"].tolist() == [[1, 0, 0, 0]] * 2
    model = Parameters({name: value for name, value in made.items()})
    assert model.rows["sh_dc"].shape == (2, 1, 3)


def test_a_new_gaussian_has_the_photos_colour_where_it_is_looked_at():
    error = torch.zeros(18, 24)
    error[9, 12] = 1.0
    made = inserted([view(error, torch.full((18, 24), 3.0))], 1, size=3.0, opacity=0.99,
                    generator=seeded())  # fmt: skip
    shown = rasterize(camera(2), made["means"], made["quaternions"], made["log_scales"].exp(),
                      made["opacity_logits"].sigmoid(), sh=made["sh_dc"])  # fmt: skip
    torch.testing.assert_close(
        shown.colour[9, 12], shown.alpha[9, 12] * torch.full((3,), 0.25), atol=1e-5, rtol=0
    )
    assert shown.alpha[9, 12] > 0.9


def test_pixels_that_show_nothing_or_do_not_count_get_none():
    depth = torch.zeros(18, 24)
    depth[:2] = 3.0
    valid = torch.zeros(18, 24, dtype=torch.bool)
    valid[1:] = True
    one = view(torch.ones(18, 24), depth, valid)
    made = inserted([one], 1000, size=1.0, opacity=0.1, generator=seeded())
    assert len(made["means"]) == 24
    rows = project_points(camera(2), made["means"])[0][:, 1]
    assert rows.tolist() == pytest.approx([1.5] * 24, abs=1e-4)
    empty = inserted([view(torch.ones(18, 24), torch.zeros(18, 24))], 5, size=1.0, opacity=0.1,
                     generator=seeded())  # fmt: skip
    assert len(empty["means"]) == 0


def test_every_view_has_its_share():
    depth, error = torch.full((18, 24), 3.0), torch.ones(18, 24)
    made = inserted([view(error, depth)] * 3, 10, size=1.0, opacity=0.1, generator=seeded())
    assert len(made["means"]) == 10


def test_pixels_are_drawn_by_their_error():
    weights = torch.tensor([1.0, 3.0, 0.0])
    first = [int(by_weight(weights, 1, seeded(seed))[0]) for seed in range(2000)]
    assert set(first) == {0, 1}
    # 2,000 draws: a share of 0.75 by 0.01
    assert sum(first) / 2000 == pytest.approx(0.75, abs=0.04)
    assert sorted(by_weight(weights, 5, seeded()).tolist()) == [0, 1]


def test_lifting_is_the_inverse_of_projection():
    pixels = torch.arange(0, 432, 7)
    depth = 1 + torch.rand(len(pixels), generator=seeded())
    error = torch.zeros(18, 24)
    places, depths = project_points(camera(2), lifted(view(error, error), pixels, depth))
    torch.testing.assert_close(places, torch.stack([pixels % 24, pixels // 24], 1) + 0.5,
                               atol=1e-3, rtol=0)  # fmt: skip
    torch.testing.assert_close(depths, depth)


def test_insertion_pads_the_statistics_and_keeps_to_the_cap():
    density = replace(ERROR, strategy="gradient", error=ErrorGate(), most=42)
    model, plan = prepare(tiny_scene(), ThreeDGS(iterations=60, sh_degree=1, density=density), RUN)
    control, rows = plan.density, model.parameters
    assert isinstance(control, ErrorControl)
    control.gradient_sum = control.absolute_sum = control.seen = torch.arange(40.0)
    views = control.scorer.drawn(10, splats_of(rows), seeded())
    edit = only(control.insert(views, rows, seeded(), control.settings.most))
    rows.edit(edit)
    assert len(rows) == 42  # 4 were wanted
    assert edit.fresh is not None
    assert edit.fresh.tolist() == [False] * 40 + [True] * 2
    assert control.gradient_sum.tolist() == [*range(40), 0, 0]
    assert list(control.insert(views, rows, seeded(), control.settings.most)) == []


# --- whole runs


@pytest.mark.parametrize("density", [MCMC, ERROR])
def test_a_killed_run_continues_bit_for_bit(density, tmp_path):
    assert_continues(replace(SHORT, density=density), RUN, 30, tmp_path)


@pytest.mark.parametrize("density", [MCMC, ERROR])
def test_the_same_seed_gives_the_same_model_and_caps_hold(density):
    settings = replace(SHORT, density=density)
    one, again = (baked(fit(tiny_scene(), settings, RUN)) for _ in range(2))
    assert torch.equal(one.means, again.means)
    assert 40 < len(one.means) <= density.most
    other = baked(fit(tiny_scene(), settings, replace(RUN, seed=4)))
    assert one.means.shape != other.means.shape or not torch.equal(one.means, other.means)


def test_with_strategy_gradient_it_is_3dgs_as_it_was():
    chosen = replace(SHORT, density=StrategicDensity(**OFTEN))
    before = Settings(iterations=60, sh_degree=1, density=Density(**OFTEN))
    one, other = (baked(fit(tiny_scene(), settings, RUN)) for settings in (chosen, before))
    assert torch.equal(one.means, other.means)


def test_a_gaussian_alone_and_one_view_alone_are_enough():
    for density in (MCMC, ERROR):
        scene = tiny_scene(views=2, points=1)
        assert len(baked(fit(scene, replace(SHORT, density=density), RUN)).means) >= 1


@pytest.mark.parametrize(
    ("density", "said"),
    [
        (StrategicDensity(strategy="mcmc"), "density.most is None, expected a number"),
        (replace(MCMC, gradient=1e-3), "density.gradient is 0.001, expected 0.0002, its default"),
        (replace(MCMC, reset_interval=100), "density.reset_interval is 100, expected 0 under"),
        (replace(MCMC, least_opacity=0.0), "density.least_opacity is 0.0, expected > 0 under"),
        (replace(MCMC, insertion=Insertion(share=0.1)), "density.insertion.share is 0.1"),
        (StrategicDensity(mcmc=Mcmc(growth=0.1)), "density.mcmc.growth is 0.1, expected 0.05"),
        (StrategicDensity(error=ErrorGate(pixels=1.0)), "density.error.pixels is 1.0"),
        (StrategicDensity(scored_views=3), "density.scored_views is 3, expected 10"),
    ],
)
def test_a_setting_that_the_strategy_does_not_look_at_is_refused(density, said):
    with pytest.raises(UsageError, match=said):
        ThreeDGS(density=density)


def test_errors_are_not_looked_at_through_exposures():
    with pytest.raises(UsageError, match="exposure is 'gain', expected off"):
        ThreeDGS(density=ERROR, exposure="gain")


@pytest.mark.parametrize(
    ("kind", "setting"),
    [
        (Mcmc, {"growth": -0.1}), (Mcmc, {"noise": -1.0}), (Mcmc, {"scale_weight": -1.0}),
        (Mcmc, {"spread": -1.0}),
        (ErrorGate, {"threshold": 1.5}), (ErrorGate, {"pixels": -1.0}), (ErrorGate, {"blame": 2.0}),
        (Insertion, {"share": -1.0}), (Insertion, {"size": 0.0}), (Insertion, {"opacity": 1.0}),
        (StrategicDensity, {"scored_views": 0}),
    ],
)  # fmt: skip
def test_impossible_settings_are_refused(kind, setting):
    (name,) = setting
    with pytest.raises(UsageError, match=rf"{name} is .*, expected"):
        kind(**setting)
