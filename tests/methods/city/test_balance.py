"""Cuts by what blocks will take: never slower by the model than ODBP's own, and as even as the model can see."""

from dataclasses import replace
from functools import cache

import pytest
import torch

from helpers.city_scene import small_scene
from splatproof.base.errors import UsageError
from splatproof.methods.city import balance
from splatproof.methods.city.balance import Training, cut, expected_works
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.block_work import STEP_COST, start_of
from splatproof.methods.city.executor import run_blocks
from splatproof.methods.city.ground import Ground, ground
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import Partition, PartitionSettings, partition
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.initialise import from_points
from splatproof.reference.partition.block_time import block_seconds, pairs_a_view
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

TRAINING = Training(iterations=400, even="visits", thickness=20.0)
BY_LOAD = PartitionSettings(seeds=2)
BY_TIME = replace(BY_LOAD, balance="time")


@pytest.fixture(scope="module", autouse=True)
def _few_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(balance, "ROUNDS", 4)
        yield


def crowded() -> Scene:
    """The small scene, with the points of one half ten times as close to each other and seen as often."""
    scene = small_scene(160)
    places = scene.points.positions.clone()
    left = places[:, 0] < places[:, 0].median()
    places[left] = places[left].mean(dim=0) + 0.1 * (places[left] - places[left].mean(dim=0))
    return replace(scene, points=replace(scene.points, positions=places))


def seconds(scene: Scene, found, training: Training = TRAINING) -> torch.Tensor:
    works = expected_works(ground(scene), found, training, BY_TIME.margin, start_of(scene, None))
    return torch.tensor([block_seconds(one, STEP_COST) for one in works])


@cache
def crowded_cut(settings: PartitionSettings, training: Training = TRAINING) -> Partition:
    """A cut of the crowded scene into four, made once."""
    return cut(crowded(), 4, settings, training)


@pytest.mark.parametrize("even", [pytest.param("steps", marks=pytest.mark.slow), "visits"])
def test_the_slowest_block_is_no_slower_than_of_the_cut_by_load(even):
    scene = crowded()
    training = replace(TRAINING, even=even)
    plain = crowded_cut(BY_LOAD, training)
    timed = crowded_cut(BY_TIME, training)
    assert float(seconds(scene, timed, training).max()) <= (
        float(seconds(scene, plain, training).max()) * 1.001
    )
    assert int(timed.labels.unique().numel()) == 4


def test_where_load_is_not_time_the_cut_by_time_is_the_more_even():
    scene = crowded()
    spreads = []
    for settings in (BY_LOAD, BY_TIME):
        found = seconds(scene, crowded_cut(settings))
        spreads.append(float(found.max() / found.mean()))
    assert spreads[1] < spreads[0] - 0.02, spreads


def test_more_rounds_are_never_worse(monkeypatch):
    """The best of all cuts stays, not the last."""
    scene, slowest = crowded(), []
    plain, cuts = balance.odbp_blocks, dict[bytes, Partition]()

    def once(place: Ground, *args, **named) -> Partition:
        """More rounds begin as fewer do, and a cut takes most of a round."""
        key = place.loads.numpy().tobytes()
        if key not in cuts:
            cuts[key] = plain(place, *args, **named)
        return cuts[key]

    monkeypatch.setattr(balance, "odbp_blocks", once)
    for rounds in (1, 2, 3, 4, 5):
        monkeypatch.setattr(balance, "ROUNDS", rounds)
        slowest.append(float(seconds(scene, cut(scene, 4, BY_TIME, TRAINING)).max()))
    assert slowest == sorted(slowest, reverse=True)
    assert slowest[-1] < 0.99 * slowest[0]


def test_a_cut_by_load_and_one_block_are_what_partition_makes():
    scene = small_scene(120)
    for settings, blocks in ((BY_LOAD, 4), (BY_TIME, 1)):
        found, want = cut(scene, blocks, settings, TRAINING), partition(scene, blocks, settings)
        assert torch.equal(found.labels, want.labels)
        assert all(map(torch.equal, found.views, want.views))
    again = [cut(scene, 4, BY_TIME, TRAINING).labels for _ in range(2)]
    assert torch.equal(*again)


def test_only_odbp_cuts_by_time():
    with pytest.raises(UsageError, match=r"partition.balance is 'time', expected 'load'"):
        PartitionSettings(method="vastgaussian", balance="time")


def test_works_are_those_of_the_jobs(tmp_path):
    """Of the same start they agree exactly: steps, pixels, Gaussians, pairs."""
    scene = small_scene(120)
    found = partition(scene, 4, BY_LOAD)
    settings = Settings(iterations=TRAINING.iterations)
    for auxiliary in ("none", "context", "both"):
        training = replace(TRAINING, thickness=1.0, auxiliary=auxiliary)
        jobs = block_jobs(
            scene, found, settings, Run(seed=0), tmp_path, even="visits", auxiliary=auxiliary,
        )  # fmt: skip
        works = expected_works(ground(scene), found, training, 0.05, start_of(scene, None))
        assert works == tuple(job.facts.work for job in jobs)
        assert all(one.pairs >= 1 and one.pixels > 0 for one in works)


def test_a_blocks_pairs_are_of_what_it_holds_in_its_own_views():
    scene = small_scene(120)
    found = partition(scene, 2, BY_LOAD)
    training = replace(TRAINING, thickness=1.0)
    start = start_of(scene, None)
    for block, work in enumerate(
        expected_works(ground(scene), found, training, 0.05, start_of(scene, None))
    ):
        own = found.points[block]
        cameras = [scene.views[i].camera for i in found.views[block].nonzero()[:, 0].tolist()]
        assert work.pairs == pairs_a_view(cameras, start.means[own], start.sizes[own])
        assert work.gaussians == int(own.sum()) < len(scene.points)


def test_gaussians_in_place_of_a_point_are_more_and_smaller():
    scene = small_scene(120)
    found = partition(scene, 2, BY_LOAD)
    one, many = (
        expected_works(
            ground(scene), found, replace(TRAINING, thickness=t), 0.05, start_of(scene, None)
        )
        for t in (1.0, 100.0)
    )
    for before, after in zip(one, many, strict=True):
        assert after.gaussians == 100 * before.gaussians
        assert before.pairs < after.pairs < 95 * before.pairs


def test_with_a_coarse_model_its_gaussians_count():
    scene = small_scene(120)
    coarse = from_points(scene, degree=0, opacity=0.1)
    wide = replace(coarse, log_scales=coarse.log_scales + 2)
    start = start_of(scene, wide)
    assert torch.allclose(start.means, coarse.means.double())
    assert torch.allclose(start.sizes, wide.log_scales.double().amax(dim=1).exp())
    found = partition(scene, 2, BY_LOAD)
    training = replace(TRAINING, thickness=1.0, auxiliary="context")
    thin, thick = (
        expected_works(ground(scene), found, training, 0.05, start_of(scene, model))
        for model in (coarse, wide)
    )
    for narrow, broad in zip(thin, thick, strict=True):
        assert narrow.gaussians == broad.gaussians
        assert narrow.pairs < broad.pairs
    whole = expected_works(ground(scene), found, replace(training, auxiliary="none"), 0.05, start)
    assert [one.gaussians for one in whole] == [len(coarse)] * 2
    assert len(cut(scene, 2, BY_TIME, training, coarse=coarse).views) == 2


def test_every_so_manieth_of_a_coarse_model_foretells_the_same_times(monkeypatch):
    scene = small_scene(120)
    coarse = from_points(scene, degree=0, opacity=0.1)
    many = Gaussians(
        **{name: value.repeat_interleave(50, dim=0) for name, value in vars(coarse).items()}
    )
    start = start_of(scene, many)
    some = start.sampled(500)
    assert (len(some.means), some.each) == (-(-len(many) // some.each), -(-len(many) // 500))
    assert start.sampled(len(many)).each == 1
    found = partition(scene, 2, BY_LOAD)
    training = replace(TRAINING, thickness=1.0, auxiliary="context")
    whole, part = (
        expected_works(ground(scene), found, training, 0.05, one) for one in (start, some)
    )
    for one, other in zip(whole, part, strict=True):
        assert other.gaussians == pytest.approx(one.gaussians, rel=0.05)
        assert other.pairs == pytest.approx(one.pairs, rel=0.1)
    asked: list[int] = []
    plain = balance.expected_works
    monkeypatch.setattr(balance, "SAMPLE", 500)
    monkeypatch.setattr(
        balance, "expected_works", lambda *at: asked.append(len(at[4].means)) or plain(*at)
    )
    cut(scene, 2, BY_TIME, training, coarse=many)
    assert set(asked) == {len(some.means)}


def test_blocks_that_take_longest_start_first(monkeypatch, tmp_path):
    scene = small_scene(120)
    found = partition(scene, 4, BY_LOAD)
    jobs = block_jobs(scene, found, Settings(iterations=40), Run(seed=0), tmp_path, even="visits")
    started: list[int] = []

    def engine(given, workers, threads, report):
        for index, job in enumerate(given):
            started.append(job.facts.block)
            report(index, 1, 1, {"gaussians": 1.0})
        return [job.facts for job in given]

    monkeypatch.setattr("splatproof.methods.city.executor.run_inline", engine)
    heard: list[int] = []
    facts = run_blocks(jobs, engine="inline", report=lambda index, *_: heard.append(index))
    expected = sorted(range(4), key=lambda i: -block_seconds(jobs[i].facts.work, STEP_COST))
    assert started == heard == expected != sorted(expected)
    assert [one.block for one in facts] == [0, 1, 2, 3]


def test_facts_of_before_have_no_work():
    facts = BlockFacts(block=0, views=1, points=2, load=3)
    assert block_seconds(facts.work, STEP_COST) == 0
