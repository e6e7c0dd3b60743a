"""One block: its rows keep their roles, it continues after a kill bit for bit, odd blocks end well."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from helpers.city_scene import small_scene
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.point_roles import CONTEXT, GHOST, OWN, ROLE, Auxiliary
from splatproof.methods.city.train_block import BlockJob, least_visits, prepare, train_block
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.settings import NO_SIDES, SideSettings
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models import exposure as exposure_of
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.supervision.spiral_path import SpiralSettings
from splatproof.reference.types.scene import Scene, View

SHORT = Settings(
    iterations=30,
    sh_degree=1,
    density=Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=15_000,
                    gradient=1e-6, largest_size=10.0),
)  # fmt: skip
"""Densifies at 10 and 20, resets at 15; a low threshold, so that much is cloned and split."""
RUN = Run(backend="cpu", threads=1, checkpoint_seconds=0.0)


def jobs(folder: Path, auxiliary: Auxiliary = "both", scene: Scene | None = None, **more):
    scene = scene or small_scene(60)
    found = partition(scene, 2, PartitionSettings(margin=0.1))
    return block_jobs(scene, found, SHORT, RUN, folder, auxiliary=auxiliary, **more)


def trained(job: BlockJob) -> GaussianModel:
    model, plan = prepare(job, None, RUN)
    Trainer(model, plan, replace(RUN, folder=None)).train()
    return model


def roles_in(model: GaussianModel) -> torch.Tensor:
    return model.parameters.labels[ROLE]


def nothing(*_: object) -> None: ...


def loaded(job: BlockJob):
    model = load_reconstruction(job.model, backend="cpu")
    assert isinstance(model, ExplicitModel)
    return {name: getattr(model.model, name) for name in FIELDS}


@pytest.mark.parametrize("follow", [False, True])
def test_ghosts_are_held_and_never_multiply(tmp_path, follow):
    job = jobs(tmp_path, follow=follow)[0]
    start = prepare(job, None, RUN)[0].gaussians()
    after = trained(job)
    ghost = roles_in(after) == GHOST
    assert int(ghost.sum()) == int((job.roles == GHOST).sum()) > 0
    assert len(roles_in(after)) > len(job.roles)  # others multiplied
    for name in ("means", "quaternions", "log_scales"):
        was, now = getattr(start, name)[job.roles == GHOST], getattr(after.gaussians(), name)[ghost]
        assert torch.equal(was, now)
    same = torch.equal(start.sh[job.roles == GHOST], after.gaussians().sh[ghost])
    assert same != follow


def test_context_is_trained_but_never_multiplies(tmp_path):
    job = jobs(tmp_path, "context")[0]
    after = trained(job)
    count = int((job.roles == CONTEXT).sum())
    assert 0 < int((roles_in(after) == CONTEXT).sum()) <= count
    assert int((roles_in(after) == OWN).sum()) > int((job.roles == OWN).sum())
    start = job.scene.points.positions[job.roles == CONTEXT].float()
    moved = after.gaussians().means[roles_in(after) == CONTEXT]
    assert not torch.isclose(start[: len(moved)], moved, rtol=0, atol=0).all()


def test_views_and_points_of_others_are_not_in_a_job(tmp_path):
    scene = small_scene(60)
    found = partition(scene, 2, PartitionSettings(margin=0.0))
    for block, job in enumerate(block_jobs(scene, found, SHORT, RUN, tmp_path)):
        chosen = found.views[block].nonzero()[:, 0].tolist()
        assert [view.name for view in job.scene.views] == [scene.views[i].name for i in chosen]
        assert torch.equal(job.scene.points.positions, scene.points.positions[found.points[block]])
        assert not job.scene.test


@pytest.mark.parametrize(
    ("sampling", "every"),
    [(None, 0), (None, 3), (SamplingSettings(azimuths=3, distances=2), 0),
     pytest.param(SamplingSettings(uniform_share=0.5), 0, marks=pytest.mark.slow)],
)  # fmt: skip
def test_visits_are_those_that_training_makes(tmp_path, monkeypatch, sampling, every):
    scene = replace(small_scene(60), up=torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64))
    side = SideSettings(every=every, spiral=SpiralSettings(layers=1, views=3))
    job = jobs(tmp_path, scene=scene, sampling=sampling, side=side)[0]
    seen = Counter[str]()
    backward = Trainer.backward

    def counting(self: Trainer, view: View):
        seen[view.name] += 1
        return backward(self, view)

    monkeypatch.setattr(Trainer, "backward", counting)
    train_block(job, nothing)
    assert (len(seen) > len(job.scene.views)) == bool(every)
    assert seen.total() == SHORT.iterations
    assert least_visits(job) == min(seen[view.name] for view in job.scene.views)
    assert least_visits(replace(job, scene=replace(job.scene, train=()))) == 0


class Killed(Exception):
    """Stands for a kill between two steps."""


BALANCED = SamplingSettings(uniform_share=0.3)
SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("sampling", "step"),
    [
        (None, 10),
        pytest.param(None, 20, marks=SLOW),
        pytest.param(BALANCED, 10, marks=SLOW),
        (BALANCED, 20),
    ],
)
def test_continuation_is_bit_equal(tmp_path, sampling, step):
    (straight, _), (killed, _) = (
        jobs(tmp_path / name, sampling=sampling) for name in ("straight", "killed")
    )
    assert straight.key == killed.key
    train_block(straight, nothing)

    def kill(now: int, *_: object) -> None:
        if now == step:
            raise Killed

    with pytest.raises(Killed):
        train_block(killed, kill)
    steps: list[int] = []
    facts = train_block(killed, lambda now, *_: steps.append(now))
    assert min(steps) > step - 10  # the report that killed it came before the checkpoint
    for name, values in loaded(straight).items():
        assert torch.equal(values, loaded(killed)[name])
    assert facts.primitives == len(loaded(killed)["means"])
    assert facts.seconds > 0
    assert facts.cpu_seconds > 0
    assert facts.densifications == 2


SIDES = SideSettings(every=3, spiral=SpiralSettings(layers=1, views=4))


def seen_from_above() -> Scene:
    """The small scene with its cameras above its points."""
    return replace(small_scene(60), up=torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64))


def test_side_views_of_a_block_circle_its_own_points(tmp_path):
    scene = seen_from_above()
    found = partition(scene, 2, PartitionSettings(margin=0.1))
    plain = block_jobs(scene, found, SHORT, RUN, tmp_path)
    sided = block_jobs(scene, found, SHORT, RUN, tmp_path, side=SIDES)
    for block, (without, job) in enumerate(zip(plain, sided, strict=True)):
        assert without.sides == ()
        assert without.key != job.key
        assert len(job.sides) == 4
        own = scene.points.positions[found.labels == block].double()
        low, high = torch.quantile(own, own.new_tensor([0.02, 0.98]), dim=0)
        eyes = torch.stack([one.centre for one in job.sides]).mean(dim=0)
        assert_close(eyes[:2], ((low + high) / 2)[:2], atol=1e-6, rtol=0)
    assert replace(sided[0], side=replace(SIDES, every=2)).key != sided[0].key
    assert replace(sided[0], weights="others").key != sided[0].key


def test_a_block_with_side_views_trains_on_them_and_goes_on_after_a_kill_to_the_bit(tmp_path):
    scene = seen_from_above()
    plain, straight, killed = (
        jobs(tmp_path / name, scene=scene, side=side)[0]
        for name, side in (("plain", NO_SIDES), ("straight", SIDES), ("killed", SIDES))
    )
    for job in (plain, straight):
        train_block(job, nothing)

    def kill(now: int, *_: object) -> None:
        if now == 20:
            raise Killed

    with pytest.raises(Killed):
        train_block(killed, kill)
    assert list((killed.folder / "checkpoint" / "side").rglob("*.safetensors"))
    train_block(killed, nothing)
    assert not (killed.folder / "checkpoint" / "side").exists()
    for name, values in loaded(straight).items():
        assert torch.equal(values, loaded(killed)[name])
    assert not torch.equal(loaded(straight)["sh"], loaded(plain)["sh"])


def test_a_trained_block_is_not_repeated_but_another_key_is(tmp_path):
    job = jobs(tmp_path)[0]
    first = train_block(job, nothing)

    def kill(*_: object) -> None:
        raise Killed

    assert train_block(job, kill) == first
    with pytest.raises(Killed):
        train_block(replace(job, seed=5), kill)


def test_balanced_and_uniform_sampling_train_different_models(tmp_path):
    even, uneven = jobs(tmp_path)[0], jobs(tmp_path, sampling=SamplingSettings())[0]
    assert even.key != uneven.key
    assert not torch.equal(trained(even).gaussians().sh, trained(uneven).gaussians().sh)


def test_a_block_without_views_or_points_is_left_empty_and_says_so(tmp_path):
    job = jobs(tmp_path)[0]
    blind = replace(job, scene=replace(job.scene, views=(), train=()), folder=tmp_path / "blind")
    assert "no view" in train_block(blind, nothing).note
    bare = replace(job, roles=torch.full_like(job.roles, GHOST), folder=tmp_path / "bare")
    facts = train_block(bare, nothing)
    assert "no point" in facts.note
    assert facts.primitives == len(loaded_means(bare)) == 0


def loaded_means(job: BlockJob):
    from splatproof.methods.city.block_model import BlockModel
    from splatproof.methods.city.partition import partition as cut

    region = cut(small_scene(60), 1, PartitionSettings()).regions[0]
    return BlockModel(region=region, model=job.model)


def test_a_block_of_one_point_trains(tmp_path):
    job = jobs(tmp_path, "none")[0]
    points = job.scene.points
    one = replace(points, positions=points.positions[:1], colours=points.colours[:1],
                  track_starts=points.track_starts[:2])  # fmt: skip
    job = replace(job, scene=replace(job.scene, points=one), roles=job.roles[:1])
    assert train_block(job, nothing).primitives >= 1


def test_a_block_that_no_view_covers_by_the_shares_takes_those_that_see_it(tmp_path):
    scene = small_scene(60)
    found = partition(scene, 2, PartitionSettings(margin=0.0, view_share=1.0, block_share=1.0))
    blind = replace(found, views=(torch.zeros_like(found.views[0]), found.views[1]))
    job = block_jobs(scene, blind, SHORT, RUN, tmp_path)[0]
    assert "takes those that see" in job.facts.note
    assert job.facts.views == len(job.scene.views) > 0


def test_blocks_learn_exposures_that_stay_out_of_their_gaussians(tmp_path, monkeypatch):
    monkeypatch.setattr(exposure_of, "RATE", 0.02)  # at those of longer runs 400 steps say less
    monkeypatch.setattr(exposure_of, "LAST_RATE", 0.002)
    scene = small_scene(60)
    dim = tuple(
        replace(view, load=lambda view=view, by=by: view.load() * by)
        for by, view in zip([1.0, 0.3] * 4 + [1.0], scene.views, strict=True)
    )
    ends = []
    for exposure in ("off", "gain"):
        still = replace(SHORT.density, gradient=1.0)  # nothing is split: the length counts
        given = replace(SHORT, iterations=120, exposure=exposure, density=still)
        found = partition(scene, 2, PartitionSettings(margin=0.1))
        job = block_jobs(replace(scene, views=dim), found, given, RUN, tmp_path)[0]
        losses: list[float] = []
        train_block(job, lambda step, total, values, to=losses: to.append(values["loss"]))
        ends.append(sum(losses[-10:]))
        assert set(loaded(job)) == set(FIELDS)
    assert ends[1] < 0.95 * ends[0]  # 0.79 to 0.86 with three seeds


def test_a_block_of_one_photo_has_no_exposure_to_learn(tmp_path):
    job = jobs(tmp_path)[0]
    alone = replace(job, settings=replace(SHORT, exposure="gain"),
                    scene=replace(job.scene, views=job.scene.views[:1], train=(0,)))  # fmt: skip
    assert train_block(alone, nothing).primitives > 0
