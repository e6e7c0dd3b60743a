"""The refinement in parts: the mean of what they say, wherever they are refined, after any kill."""

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.testing import assert_close

from helpers.city_scene import small_scene
from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import SplatproofError
from splatproof.base.tensor_files import read_tensors
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.coarse import shown_by
from splatproof.methods.city.refine import GEOMETRY, RefineSettings, refine
from splatproof.methods.city.refine_parts import (
    MOVING,
    PartJob,
    Whole,
    mean_of_parts,
    part_jobs,
    refine_parts,
)
from splatproof.methods.contracts.run import Run
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, View

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


def whole(
    moving: torch.Tensor | None = None, scene: Scene = SCENE, views=VIEWS, **more: Any
) -> Whole:
    made: dict[str, Any] = {
        "owners": OWNERS,
        "blocks": FACTS,
        "settings": SETTINGS,
        "base": BASE,
        "pack": None,
    }
    return Whole(**made | {"moving": moving, "scene": scene, "views": views} | more)


def jobs(folder: Path, run: Run = RUN, moving: torch.Tensor | None = None) -> tuple[PartJob, ...]:
    return part_jobs(spoilt(), whole(moving), run, folder)


def refined(model: Gaussians, owners: torch.Tensor, made: tuple[PartJob, ...], run: Run, report):
    """What the parts make of a model, and what each took."""
    facts = refine_parts(made, run, report)
    return mean_of_parts(model, owners, made), facts


def error(model: Gaussians, view: View) -> float:
    """Mean absolute error of a model's picture of a view."""
    image = rasterize(
        view.camera, model.means, model.quaternions, model.scales, model.opacities, sh=model.sh
    ).colour
    return float((image - view.load()).abs().mean())


def test_parts_together_come_nearer_to_the_photos_and_move_nothing_unless_told(tmp_path):
    made = jobs(tmp_path)
    assert [job.facts.block for job in made] == [0, 1]  # no view: nothing to be fitted to
    model, facts = refined(spoilt(), OWNERS, made, RUN, nothing)
    assert all(one.seconds > 0 and one.cpu_seconds > 0 and one.peak_mb > 0 for one in facts)
    for name in GEOMETRY:
        assert torch.equal(getattr(model, name), getattr(spoilt(), name))
    for view in SCENE.train_views:
        before, after = (error(one, view) for one in (spoilt(), model))
        assert after < 0.7 * before


def test_of_what_several_parts_show_the_mean_is_kept_and_geometry_is_the_owners(tmp_path):
    """Each part by itself is what a refinement of its views and what they show makes of them."""
    moving = torch.ones(40, dtype=torch.bool)
    made = jobs(tmp_path, moving=moving)
    model, _ = refined(spoilt(), OWNERS, made, RUN, nothing)
    counts = torch.stack([
        shown_by([SCENE.views[v].camera for v in chosen], spoilt().means.double())
        for chosen in ((1, 2, 3), (2, 3, 4, 5))
    ]).float()  # fmt: skip
    ends = []
    for job in made:
        run, marks = replace(RUN, seed=job.seed), OWNERS[job.rows] == job.facts.block
        seen = Gaussians(**{name: getattr(spoilt(), name)[job.rows] for name in FIELDS})
        steps = job.facts.steps
        alone = refine(seen, job.scene, SETTINGS, BASE, run, None, moving=marks, steps=steps).model
        own = Gaussians(**{name: getattr(spoilt(), name).clone() for name in FIELDS})
        for name in FIELDS:
            getattr(own, name)[job.rows] = getattr(alone, name)
        ends.append(own)
    for block, end in enumerate(ends):
        own = OWNERS == block
        for name in GEOMETRY:
            assert torch.equal(getattr(model, name)[own], getattr(end, name)[own])
        counts[block, own] = counts[block, own].clamp(min=1)
    shares = counts / counts.sum(dim=0)
    assert 0.2 < float(((shares > 0) & (shares < 1)).float().mean())
    for name in ("opacity_logits", "sh"):
        both = torch.stack([getattr(end, name) for end in ends])
        each = shares.reshape(2, 40, *[1] * (both.ndim - 2))
        assert_close(getattr(model, name), (each * both).sum(dim=0), rtol=0, atol=2e-6)


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
        moves = read_tensors(job.start)[0][MOVING]
        assert torch.equal(moves, (moving & (OWNERS == job.facts.block))[job.rows])
    assert len({job.seed for job in made}) == 2
    model, _ = refined(spoilt(), OWNERS, made, RUN, nothing)
    moved = (model.log_scales != spoilt().log_scales).any(dim=1)
    assert int(moved[moving & (OWNERS != 2)].sum()) >= 10  # one of 14 is hidden behind others
    assert not bool(moved[~moving | (OWNERS == 2)].any())


def test_what_no_view_of_a_part_shows_is_not_sent_to_it(tmp_path):
    far = TRUTH.means.clone()
    far[:6] += torch.tensor([1e4, 0.0, 0.0])
    model = replace(spoilt(), means=far)
    near = [job.facts.gaussians for job in jobs(tmp_path / "near")]
    made = part_jobs(model, whole(), RUN, tmp_path)
    # of the six that nobody sees each part has its own two
    assert [job.facts.gaussians for job in made] == [count - 4 for count in near]
    ended, _ = refined(model, OWNERS, made, RUN, nothing)
    assert torch.equal(ended.sh[:6], model.sh[:6])


def test_processes_refine_the_same_parts_and_a_killed_one_goes_on(tmp_path):
    scene = small_scene(40)
    views = [torch.arange(len(scene.views)) % 2 == b for b in range(2)]
    of = whole(scene=scene, views=views, owners=OWNERS % 2, blocks=FACTS[:2])
    start = part_jobs(spoilt(), of, RUN, tmp_path / "straight")
    straight, _ = refined(spoilt(), OWNERS % 2, start, RUN, nothing)
    run = replace(RUN, engine="processes")
    made = part_jobs(spoilt(), of, run, tmp_path / "killed")

    def kill(step: int, total: int, values: dict[str, float]) -> None:
        del values
        if made[0].done() is not None and step >= total * 0.75:
            for worker in multiprocessing.active_children():
                assert worker.pid is not None
                os.kill(worker.pid, signal.SIGKILL)

    with pytest.raises(SplatproofError, match=r"block 1.*SIGKILL.*continues"):
        refined(spoilt(), OWNERS % 2, made, run, kill)
    assert [job.done() is not None for job in made] == [True, False]
    again = part_jobs(spoilt(), of, run, tmp_path / "killed")
    steps: list[int] = []
    model, _ = refined(
        spoilt(), OWNERS % 2, again, run, lambda step, total, values: steps.append(step)
    )
    assert steps[0] > 10  # not from its start
    for name in FIELDS:
        assert torch.equal(getattr(model, name), getattr(straight, name))


def test_a_part_of_another_model_is_not_taken_for_done(tmp_path):
    made = jobs(tmp_path)
    refined(spoilt(), OWNERS, made, RUN, nothing)
    assert made[0].done() is not None
    assert made[0].work(nothing) == made[0].done()
    other = replace(spoilt(), sh=spoilt().sh + 0.1)
    changed = part_jobs(other, whole(), RUN, tmp_path)
    assert changed[0].done() is None
