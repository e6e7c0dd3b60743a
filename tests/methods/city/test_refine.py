"""Global refinement: only the appearance moves, towards the photos, through the stored 8 bits."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.testing import assert_close

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.city.refine import QuantisedModel, RefineSettings, clean, refine
from splatproof.methods.contracts.density_strategy import Frozen
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.storage.packed.coded_writer import (
    CodeSettings,
    chosen_steps,
    file_order,
    write_coded,
)
from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.rows import MemoryRows
from splatproof.methods.storage.packed.writer import FileSettings, PackedFacts, write_packed
from splatproof.methods.threedgs.fit import terms
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates
from splatproof.reference.compression.spectral import open_gate
from splatproof.reference.stitching.preclean import CleanSettings

SCENE = tiny_scene(views=5)
BASE = Settings(iterations=200, sh_degree=1)
RUN = Run(backend="cpu", threads=1)


def spoilt():
    """The scene's own Gaussians with colours and opacities that are off."""
    truth = random_gaussians(40)
    return replace(truth, sh=truth.sh + 0.3, opacity_logits=truth.opacity_logits - 1.0)


def refined(**more: Any):
    settings = RefineSettings(iterations=60, **more)
    losses: list[float] = []
    run = replace(RUN, report=lambda step, total, values: losses.append(values["loss"]))
    model, seconds, cpu_seconds = refine(spoilt(), SCENE, settings, BASE, run, None)
    assert seconds > 0
    assert cpu_seconds > 0
    return model, losses


@pytest.mark.parametrize(
    "more", [{}, {"optimizer": "sgd", "sh_dc": 0.05, "sh_rest": 0.05, "opacity": 5.0}]
)
def test_the_loss_falls_and_only_the_appearance_moves(more):
    model, losses = refined(**more)
    assert losses[-1] < 0.7 * losses[0]
    before = spoilt()
    for name in ("means", "quaternions", "log_scales"):
        assert torch.equal(getattr(model, name), getattr(before, name))
    for name in ("opacity_logits", "sh"):
        assert not torch.equal(getattr(model, name), getattr(before, name))


def test_what_lies_near_walls_moves_and_nothing_else_does():
    moving = torch.zeros(40, dtype=torch.bool)
    moving[::3] = True
    truth = random_gaussians(40)
    shift = torch.where(moving[:, None], 0.05, 0.0)
    start = replace(spoilt(), means=truth.means + shift)
    base = replace(BASE, rates=Rates(means=0.05, means_final=1e-4))  # the tiny scene is small
    of, ends = (SCENE, RefineSettings(iterations=200), base, RUN, None), []
    for mask in (None, ~moving & moving, moving):
        model = refine(start, *of, moving=mask).model
        ends.append(model)
        for name in ("means", "quaternions", "log_scales"):
            same = (getattr(model, name) == getattr(start, name)).all(dim=1)
            assert bool(same[~moving].all())
            assert bool(same[moving].all()) is (mask is not moving)
    assert torch.equal(ends[0].sh, ends[1].sh)
    off = [float((m.means - truth.means)[moving].norm(dim=1).mean()) for m in ends]
    assert off[2] < 0.8 * off[0]


def test_the_kernels_and_autograd_refine_alike():
    """Stored harmonics are handed to the kernels' step as autograd sees them."""
    start, pack = spoilt(), FileSettings(gate=0.3)
    rates, ends = Rates(means=0.0, means_final=0.0), []
    for native in (True, False):
        model = QuantisedModel(start, rates, 0.2, BASE, pack)
        plan = Plan(steps=20, views=SCENE.train_views, terms=terms(BASE), density=Frozen(), key="",
                    native=native)  # fmt: skip
        trainer = Trainer(model, plan, RUN)
        assert trainer.path == ("kernels" if native else "autograd")
        trainer.train()
        ends.append(model.gaussians())
    assert 0 < int(open_gate(start.sh[:, 1:], 0.3).sum()) < 40
    for name in ("opacity_logits", "sh"):
        moved = getattr(ends[0], name) - getattr(start, name)
        # rates of 0.05 and 2.5e-3 times 20 steps of Adam, whose first ones go by the sign alone
        assert_close(getattr(ends[0], name), getattr(ends[1], name), rtol=0, atol=2e-3)
        assert float(moved.abs().max()) > 0.01


def test_what_is_rendered_lies_on_256_values_from_the_set_share_on():
    model = QuantisedModel(random_gaussians(2000), Rates(), 0.5, BASE)
    for step, most in ((5, 2000), (6, 256)):
        sh = model.splats(SCENE.views[0], Moment(step=step, total=10)).sh
        assert sh is not None
        rest = sh[:, 1:].flatten(start_dim=1)
        distinct = max(len(column.unique()) for column in rest.T)
        assert (distinct == 2000) if most == 2000 else (distinct <= 256)


def test_quantisation_takes_part_in_training():
    through, past = (refined(quantise_from=share)[0] for share in (0.0, 1.0))
    assert not torch.equal(through.sh, past.sh)


def test_a_checkpoint_of_another_merged_model_or_file_is_not_continued(tmp_path):
    def killed(step: int, total: int, values: dict[str, float]):
        del total, values
        if step >= 30:
            raise KeyboardInterrupt

    of = (SCENE, RefineSettings(iterations=60), BASE)
    run = replace(RUN, report=killed, checkpoint_seconds=0.0)
    with pytest.raises(KeyboardInterrupt):
        refine(spoilt(), *of, run, tmp_path, FileSettings(gate=0.02))
    for model, gate in ((random_gaussians(40), 0.02), (spoilt(), 0.1)):
        with pytest.raises(UsageError, match="differs"):
            refine(model, *of, RUN, tmp_path, FileSettings(gate=gate))
    steps: list[int] = []
    run = replace(RUN, report=lambda step, total, values: steps.append(step))
    refine(spoilt(), *of, run, tmp_path, FileSettings(gate=0.02))
    assert steps[0] > 10


def test_cleaning_drops_the_transparent_and_keeps_the_largest_unless_told():
    model = random_gaussians(2000)
    logits = model.opacity_logits.clone()
    logits[:5] = -6.0
    scales = model.log_scales.clone()
    scales[5] = 3.0
    model = replace(model, opacity_logits=logits, log_scales=scales)
    kept = clean(model, RefineSettings().clean)
    assert not kept[:5].any()
    assert kept[5:].all()
    assert not clean(model, CleanSettings(volume_quantile=0.999))[5]


@pytest.mark.parametrize("unit", [1.0, 10.0])
def test_what_is_cleaned_does_not_depend_on_the_unit_of_length(unit):
    """In a world in metres a river is longer than the 50 scene units at which the paper's bound lies."""
    model = random_gaussians(40)
    model.log_scales[5] = 3.0  # a hundred times as long as the others
    model.opacity_logits[7] = -6.0
    model = replace(model, log_scales=model.log_scales + math.log(unit))
    assert (~clean(model, RefineSettings().clean)).nonzero()[:, 0].tolist() == [7]
    paper = clean(model, CleanSettings(volume_quantile=1.0))
    assert bool(paper[5]) == (unit == 1.0)


def test_steps_follow_the_blocks_and_visit_every_view_unless_given():
    long = replace(BASE, iterations=40_000)
    assert RefineSettings().steps(long, 143) == 7_000
    assert RefineSettings().steps(BASE, 143) == 4 * 143
    assert RefineSettings().steps(replace(BASE, views_per_step=3), 143) == 191
    assert RefineSettings(visits=0).steps(replace(BASE, iterations=1), 143) == 1
    assert RefineSettings(iterations=3).steps(long, 143) == 3


def test_what_the_gate_drops_is_not_seen_and_what_is_seen_is_what_is_stored(tmp_path):
    weak = torch.linspace(0, 1, 500)[:, None, None]
    start = random_gaussians(500)
    sh = torch.cat([start.sh[:, :1], start.sh[:, 1:] * weak], dim=1)
    start, pack = replace(start, sh=sh), FileSettings(gate=0.3)
    model = QuantisedModel(start, Rates(), 0.5, BASE, pack)
    model.parameters.rows["sh_rest"].requires_grad_()
    before, after = (
        model.splats(SCENE.views[0], Moment(step=step, total=10)).sh for step in (5, 6)
    )
    assert before is not None
    assert after is not None
    dropped = ~open_gate(start.sh[:, 1:], 0.3)
    assert 0 < int(dropped.sum()) < 500
    assert bool((after[dropped, 1:] == 0).all())
    assert bool((before[dropped, 1:] != 0).any())
    path = tmp_path / "model.spgs"
    write_packed(path, start, settings=replace(pack, sort=False), facts=PackedFacts(), threads=1)
    stored = read_packed(path)[0].sh
    assert_close(after.detach()[:, 1:], stored[:, 1:], rtol=0, atol=1e-6)
    after[:, 1:].sum().backward()
    gradient = model.parameters.rows["sh_rest"].grad
    assert gradient is not None
    assert torch.equal((gradient != 0).flatten(start_dim=1).any(dim=1), ~dropped)


def test_of_our_file_the_refinement_sees_the_steps(tmp_path):
    start = random_gaussians(500)
    steps = chosen_steps(MemoryRows(start), CodeSettings(harmonics=0.2))
    model = QuantisedModel(start, Rates(), 0.5, BASE, steps)
    assert model.stored_harmonics(Moment(step=5, total=10)) is None
    found = model.stored_harmonics(Moment(step=6, total=10))
    assert found is not None
    path = tmp_path / "model.spgs"
    order = file_order(MemoryRows(start), steps)[1]
    write_coded(path, start, steps=steps, threads=1)
    stored = read_packed(path)[0].sh[:, 1:]
    assert_close(found[0][order], stored, rtol=0, atol=1e-5)
    assert float((found[0] - start.sh[:, 1:]).abs().max()) > 0.05
    assert bool(found[1].all())


def test_exposures_of_photos_stay_out_of_the_refined_colours():
    dim = [replace(view, load=lambda view=view, by=by: (view.load() * by).clamp(0, 1))
           for view, by in zip(SCENE.views, [0.6, 0.8, 1.0, 0.8, 0.6], strict=True)]  # fmt: skip
    scene = replace(SCENE, views=tuple(dim))
    ends = []
    for exposure in ("off", "gain"):
        losses: list[float] = []
        run = replace(RUN, report=lambda step, total, values: losses.append(values["loss"]))  # noqa: B023
        base = replace(BASE, exposure=exposure)
        refine(random_gaussians(40), scene, RefineSettings(iterations=300), base, run, None)
        ends.append(sum(losses[-10:]) / 10)
    assert ends[1] < ends[0]


@pytest.mark.parametrize(
    "wrong", [{"iterations": 0}, {"visits": -1}, {"quantise_from": 2.0}, {"opacity": -1.0}]
)
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(UsageError, match=f"refine.{next(iter(wrong))}"):
        RefineSettings(**wrong)
