"""The refinement in parts: each block's own Gaussians from its own part, anywhere, after any kill."""

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from helpers.city_scene import small_scene
from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import SplatproofError
from splatproof.base.tensor_files import read_tensors
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.refine import RefineSettings, refine
from splatproof.methods.city.refine_parts import MOVING, OWN, PartJob, part_jobs, refine_parts
from splatproof.methods.contracts.run import Run
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View

SCENE = tiny_scene(views=6)
BASE = Settings(iterations=200, sh_degree=1)
RUN = Run(backend="cpu", threads=1, engine="inline", checkpoint_seconds=0.0)
SETTINGS = RefineSettings(iterations=60, parts=True)
TRUTH = random_gaussians(40)
OWNERS = (torch.arange(40) % 3).long()
VIEWS = [torch.tensor([v in chosen for v in range(6)]) for chosen in ((1, 2, 3), (2, 3, 4, 5), ())]
FACTS = [BlockFacts(block=b, views=int(VIEWS[b].sum()), points=1, load=1) for b in range(3)]


def spoilt() -> Gaussians:
    """The scene's own Gaussians with colours and opacities that are off."""
    return replace(TRUTH, sh=TRUTH.sh + 0.3, opacity_logits=TRUTH.opacity_logits - 1.0)


def nothing(*_: object) -> None: ...


def jobs(
    folder: Path, run: Run = RUN, moving: torch.Tensor | None = None, scene=SCENE
) -> tuple[PartJob, ...]:
    return part_jobs(
        spoilt(), OWNERS, moving, scene, VIEWS, FACTS, SETTINGS, BASE, run, folder, None
    )


def error(model: Gaussians, view: View) -> float:
    """Mean absolute error of a model's picture of a view."""
    image = rasterize(
        view.camera, model.means, model.quaternions, model.scales, model.opacities, sh=model.sh
    ).colour
    return float((image - view.load()).abs().mean())


def test_a_part_keeps_what_its_block_owns_and_nobody_else_changes_it(tmp_path):
    made = jobs(tmp_path)
    assert [job.facts.block for job in made] == [0, 1]  # no view: nothing to be fitted to
    model, facts = refine_parts(spoilt(), OWNERS, made, RUN, nothing)
    assert all(one.seconds > 0 and one.cpu_seconds > 0 and one.peak_mb > 0 for one in facts)
    left = OWNERS == 2
    for name in FIELDS:
        assert torch.equal(getattr(model, name)[left], getattr(spoilt(), name)[left])
    for name in ("means", "quaternions", "log_scales"):
        assert torch.equal(getattr(model, name), getattr(spoilt(), name))
    for view in SCENE.train_views:
        before, after = (error(one, view) for one in (spoilt(), model))
        assert after < 0.8 * before  # a third of the model belongs to the block without a view


def test_a_part_is_what_a_refinement_of_its_views_alone_makes_of_its_own(tmp_path):
    """Everything here is seen by every view, so that the part sees the whole model."""
    made = jobs(tmp_path)
    model, _ = refine_parts(spoilt(), OWNERS, made, RUN, nothing)
    for job in made:
        run = replace(RUN, seed=job.seed)
        alone = refine(spoilt(), job.scene, SETTINGS, BASE, run, None, steps=job.facts.steps).model
        own = OWNERS == job.facts.block
        for name in FIELDS:
            assert torch.equal(getattr(model, name)[own], getattr(alone, name)[own])


def test_parts_visit_each_view_as_often_as_the_whole_does(tmp_path):
    assert [job.facts.steps for job in jobs(tmp_path)] == [36, 48]
    assert RefineSettings().steps(BASE, 143, 20) == 4 * 20
    assert RefineSettings().steps(replace(BASE, iterations=40_000), 143, 20) == round(
        7_000 * 20 / 143
    )


def test_only_what_the_block_owns_moves(tmp_path):
    moving = torch.zeros(40, dtype=torch.bool)
    moving[:20] = True
    made = jobs(tmp_path, moving=moving)
    for job in made:
        marks, _ = read_tensors(job.start)
        assert int(marks[MOVING].sum()) == int((moving & (OWNERS == job.facts.block)).sum())
        assert not bool((marks[MOVING] & ~marks[OWN]).any())
    assert len({job.seed for job in made}) == 2
    model, _ = refine_parts(spoilt(), OWNERS, made, RUN, nothing)
    moved = (model.log_scales != spoilt().log_scales).any(dim=1)
    assert int(moved[moving & (OWNERS != 2)].sum()) >= 10  # one of 14 is hidden behind others
    assert not bool(moved[~moving | (OWNERS == 2)].any())


def test_what_no_view_of_a_part_shows_is_not_sent_to_it(tmp_path):
    far = TRUTH.means.clone()
    far[:6] += torch.tensor([1e4, 0.0, 0.0])
    model = replace(spoilt(), means=far)
    near = [job.facts.gaussians for job in jobs(tmp_path / "near")]
    made = part_jobs(model, OWNERS, None, SCENE, VIEWS, FACTS, SETTINGS, BASE, RUN, tmp_path, None)
    # of the six that nobody sees each part has its own two
    assert [job.facts.gaussians for job in made] == [count - 4 for count in near]
    refined, _ = refine_parts(model, OWNERS, made, RUN, nothing)
    assert_close(refined.sh[:6], model.sh[:6], rtol=0, atol=0)


def test_processes_refine_the_same_parts_and_a_killed_one_goes_on(tmp_path):
    scene = small_scene(40)
    views = [torch.arange(len(scene.views)) % 2 == b for b in range(2)]
    of = (spoilt(), OWNERS % 2, None, scene, views, FACTS[:2], SETTINGS, BASE)
    straight, _ = refine_parts(
        spoilt(), OWNERS % 2, part_jobs(*of, RUN, tmp_path / "straight", None), RUN, nothing
    )
    run = replace(RUN, engine="processes")
    made = part_jobs(*of, run, tmp_path / "killed", None)

    def kill(index: int, step: int, total: int, values: dict[str, float]) -> None:
        del total, values
        if index == 1 and step >= 20:
            for worker in multiprocessing.active_children():
                assert worker.pid is not None
                os.kill(worker.pid, signal.SIGKILL)

    with pytest.raises(SplatproofError, match=r"block 1.*SIGKILL.*continues"):
        refine_parts(spoilt(), OWNERS % 2, made, run, kill)
    assert [job.done() is not None for job in made] == [True, False]
    again = part_jobs(*of, run, tmp_path / "killed", None)
    steps: list[tuple[int, int]] = []
    model, _ = refine_parts(
        spoilt(), OWNERS % 2, again, run, lambda index, step, *_: steps.append((index, step))
    )
    assert {index for index, _ in steps} == {1}
    assert steps[0][1] > 10
    for name in FIELDS:
        assert torch.equal(getattr(model, name), getattr(straight, name))


def test_a_part_of_another_model_is_not_taken_for_done(tmp_path):
    made = jobs(tmp_path)
    refine_parts(spoilt(), OWNERS, made, RUN, nothing)
    assert made[0].done() is not None
    assert made[0].work(nothing) == made[0].done()
    other = replace(spoilt(), sh=spoilt().sh + 0.1)
    changed = part_jobs(
        other, OWNERS, None, SCENE, VIEWS, FACTS, SETTINGS, BASE, RUN, tmp_path, None
    )
    assert changed[0].done() is None
