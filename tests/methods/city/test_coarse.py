"""What of a coarse model is whose, what a block starts from, and how steps are shared."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.city_scene import small_scene
from helpers.tiny_scene import camera
from splatproof.base.tensor_files import write_tensors
from splatproof.methods.city.coarse import BESIDE, coarse_roles, shown
from splatproof.methods.city.jobs import block_jobs, block_steps
from splatproof.methods.city.memory_plan import block_memory_mb
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.point_roles import (
    CONTEXT,
    GHOST,
    LEFT_OUT,
    OWN,
    ROLE,
    Auxiliary,
    assigned,
)
from splatproof.methods.city.train_block import prepare, read_gaussians
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.initialise import from_points
from splatproof.methods.training.loop import Trainer
from splatproof.reference.types.camera import project_points

SCENE = small_scene(60)
SETTINGS = Settings(iterations=20, sh_degree=1)
RUN = Run(backend="cpu", threads=1)


def coarse_file(folder: Path) -> Path:
    """A model with opacities that no sparse point has, and view-dependent colour."""
    model = from_points(SCENE, degree=1, opacity=0.7)
    model = replace(model, sh=model.sh + 0.1 * torch.randn(model.sh.shape, generator=generator()))
    path = folder / "coarse.safetensors"
    write_tensors(path, {name: getattr(model, name) for name in FIELDS})
    return path


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


def test_what_is_trained_most_wins():
    own, seen, near = (torch.tensor(bits) for bits in ([True, False, False, False],
                                                       [True, True, False, False],
                                                       [True, True, True, False]))  # fmt: skip
    expected: dict[Auxiliary, list[int]] = {
        "none": [OWN, LEFT_OUT, LEFT_OUT, LEFT_OUT],
        "context": [OWN, CONTEXT, LEFT_OUT, LEFT_OUT],
        "ghosts": [OWN, GHOST, GHOST, LEFT_OUT],
        "both": [OWN, CONTEXT, GHOST, LEFT_OUT],
    }
    for auxiliary, roles in expected.items():
        assert assigned(own, seen, near, auxiliary).tolist() == roles


def test_a_place_is_shown_in_front_of_a_camera_and_a_little_beside_its_image():
    one = camera(0, width=20, height=10)
    places = 3 * torch.randn(500, 3, generator=generator(), dtype=torch.float64)
    pixel, depth = project_points(one, places)
    away = (pixel / torch.tensor([20.0, 10.0]) - 0.5).abs().amax(dim=1)
    expected = (depth > 0) & (away <= 0.5 + BESIDE)
    assert torch.equal(shown([one], places), expected)
    assert 0 < int(expected.sum()) < 500
    assert int((expected & (away > 0.5)).sum()) > 0
    assert not shown([], places).any()


@pytest.mark.parametrize("auxiliary", ["context", "ghosts", "both"])
def test_every_coarse_gaussian_is_someones_own_and_margins_are_shared(auxiliary):
    found = partition(SCENE, 2, PartitionSettings(method="blockgaussian"))
    means = 3 * torch.randn(400, 3, generator=generator(), dtype=torch.float64)
    narrow, wide = (
        torch.stack(coarse_roles(means, SCENE, found, found.views, auxiliary, margin))
        for margin in (0.0, 0.3)
    )
    assert bool(((narrow == OWN).sum(dim=0) == 1).all())
    assert bool((wide == OWN)[narrow == OWN].all())
    assert int((wide == OWN).sum()) > 400
    for block, region in enumerate(found.regions):
        away, roles = region.distance(means), narrow[block]
        seen = shown([SCENE.views[i].camera for i in found.views[block].nonzero()[:, 0]], means)
        role = CONTEXT if auxiliary in ("context", "both") else GHOST
        assert bool((roles[seen & (away > 1)] == role).all())
        rest = roles[~seen & (away > 1.2)]
        assert bool((rest == LEFT_OUT).all())


def test_without_auxiliary_gaussians_every_block_starts_from_all():
    found = partition(SCENE, 2, PartitionSettings(method="citygaussian"))
    means = torch.randn(9, 3, generator=generator(), dtype=torch.float64)
    for roles in coarse_roles(means, SCENE, found, found.views, "none", 0.1):
        assert bool((roles == OWN).all())


@pytest.mark.parametrize("follow", [False, True])
def test_ghosts_have_the_coarse_models_values_and_only_their_look_follows(tmp_path, follow):
    coarse = coarse_file(tmp_path)
    found = partition(SCENE, 2, PartitionSettings(margin=0.0))
    job = block_jobs(
        SCENE, found, SETTINGS, RUN, tmp_path, auxiliary="ghosts", follow=follow, coarse=coarse
    )[0]
    given = read_gaussians(coarse)
    ghosts = job.roles == GHOST
    assert 0 < int(ghosts.sum()) < len(given)
    model, plan = prepare(job, given, RUN)
    assert len(model.gaussians()) == int((job.roles != LEFT_OUT).sum())
    Trainer(model, plan, RUN).train()
    after, held = model.gaussians(), model.parameters.labels[ROLE] == GHOST
    for name in ("means", "log_scales", "quaternions"):
        assert torch.equal(getattr(after, name)[held], getattr(given, name)[ghosts])
    for name in ("opacity_logits", "sh"):
        same = torch.equal(getattr(after, name)[held], getattr(given, name)[ghosts])
        assert same != follow


def test_view_dependent_colour_of_a_coarse_model_shows_from_the_first_step(tmp_path):
    coarse = coarse_file(tmp_path)
    found = partition(SCENE, 2, PartitionSettings(margin=0.0))
    for model, every in ((None, SETTINGS.sh_interval * 20 / 30_000), (coarse, 0.0)):
        job = block_jobs(SCENE, found, SETTINGS, RUN, tmp_path, coarse=model)[0]
        start = None if model is None else read_gaussians(model)
        assert prepare(job, start, RUN)[0].sh_every == every


def test_the_memory_of_a_block_is_that_of_what_it_takes_of_the_coarse_model(tmp_path):
    coarse = coarse_file(tmp_path)
    found = partition(SCENE, 2, PartitionSettings(margin=0.0))
    few, every = (
        block_jobs(SCENE, found, SETTINGS, RUN, tmp_path, auxiliary=auxiliary, coarse=coarse)[0]
        for auxiliary in ("ghosts", "none")
    )
    assert block_memory_mb(few) < block_memory_mb(every)
    left = replace(few, roles=torch.cat([few.roles, torch.full((9**6,), LEFT_OUT).to(few.roles)]))
    assert block_memory_mb(left) == block_memory_mb(few)


@given(
    views=st.lists(st.integers(0, 300), min_size=1, max_size=12), iterations=st.integers(1, 5000)
)
def test_steps_are_shared_by_views_and_none_is_lost(views, iterations):
    held = [count for count in views if count]
    steps = block_steps(iterations, views, "visits")
    assert block_steps(iterations, views, "steps") == [iterations] * len(views)
    assert min(steps) >= 1
    total = sum(of for of, count in zip(steps, views, strict=True) if count)
    assert iterations * len(held) <= total <= iterations * len(held) + len(held)
    for of, count in zip(steps, views, strict=True):
        exact = iterations * len(held) * count / sum(held) if count else iterations
        assert abs(of - exact) <= 1
