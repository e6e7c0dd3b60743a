"""Stochastic interwoven stitching against a primitive-by-primitive loop, and its hard cases."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.base.errors import UsageError
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.stitching import stochastic as stitching
from splatproof.reference.stitching.stochastic import AS_RELEASED, StitchSettings, TrainedBlock

SEEDS = st.integers(0, 2**16)
D = torch.float64
OURS = StitchSettings()


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def block(
    centre: list[float], means: Tensor, opacity: float = 0.5, scale: float = 0.1
) -> TrainedBlock:
    """A block with a cube of half-extent 1; all its primitives alike."""
    count = len(means)
    return TrainedBlock(
        box=OrientedBox(
            centre=torch.tensor(centre, dtype=D), rotation=torch.eye(3, dtype=D),
            half=torch.ones(3, dtype=D),
        ),
        means=means.to(D),
        opacity_logits=torch.full((count,), math.log(opacity / (1 - opacity)), dtype=D),
        log_scales=torch.full((count, 3), math.log(scale), dtype=D),
    )  # fmt: skip


def cube(b: TrainedBlock) -> OrientedBox:
    assert isinstance(b.box, OrientedBox)
    return b.box


def random_blocks(blocks: int, count: int, seed: int) -> tuple[TrainedBlock, ...]:
    """Cubes side by side along x, primitives within 1.3 half-extents, many of them on the rims."""
    g = generator(seed)
    found = []
    for i in range(blocks):
        local = 2.6 * torch.rand(count, 3, generator=g, dtype=D) - 1.3
        local[: count // 2, 0] = 1.05 * local[: count // 2, 0].sign()
        base = block([2.0 * i, 0, 0], local + torch.tensor([2.0 * i, 0, 0]))
        found.append(
            replace(
                base,
                opacity_logits=torch.randn(count, generator=g, dtype=D),
                log_scales=torch.randn(count, 3, generator=g, dtype=D) - 2,
            )
        )
    return tuple(found)


def by_loop(
    blocks: tuple[TrainedBlock, ...], eta: float, k: int, *, normalise: bool
) -> list[list[float]]:
    """The paper's rules, one primitive at a time; if so asked Q is divided by its median over all rims."""

    def at(b: TrainedBlock, p: Tensor) -> float:
        return float(((p - b.box.centre) / cube(b).half).abs().max())  # unrotated cubes

    def q(b: TrainedBlock, i: int) -> float:
        alpha = 1 / (1 + math.exp(-float(b.opacity_logits[i])))
        return alpha / sum(math.exp(float(s)) / 3 for s in b.log_scales[i])

    rim = sorted(q(b, i) for b in blocks for i, p in enumerate(b.means) if 1 < at(b, p) <= 1.1)
    unit = rim[(len(rim) - 1) // 2] if rim and normalise else 1.0
    found = []
    for b in blocks:
        chances = []
        for i, p in enumerate(b.means):
            d = at(b, p)
            scores = []
            for other in blocks:
                alive = [j for j, m in enumerate(other.means) if at(other, m) <= 1.1]
                if other is b or at(other, p) >= 1.1 or not alive:
                    continue
                near = sorted(alive, key=lambda j: float((other.means[j] - p).norm()))[:k]
                scores.append(
                    (1.1 - at(other, p)) * sum(q(other, j) for j in near) / len(near) / unit
                )
            own = (1.1 - d) * q(b, i) / unit
            chance = 1 / (1 + math.exp(-eta * (own - max(scores)))) if scores else 1.0
            chances.append(1.0 if d <= 1 else 0.0 if d > 1.1 else chance)
        found.append(chances)
    return found


@settings(max_examples=20)
@given(
    blocks=st.integers(1, 4), count=st.integers(0, 16), seed=SEEDS,
    eta=st.sampled_from([0.0, 0.5, 3.0]), k=st.sampled_from([1, 2, 5, 11]), normalise=st.booleans(),
)  # fmt: skip
def test_probabilities_are_those_of_the_loop(blocks, count, seed, eta, k, normalise):
    scene = random_blocks(blocks, count, seed)
    chosen = replace(OURS, sharpness=eta, neighbours=k, normalise=normalise)
    found = stitching.keep_probabilities(scene, chosen)
    for chances, want in zip(found, by_loop(scene, eta, k, normalise=normalise), strict=True):
        assert_close(chances, torch.tensor(want, dtype=D).reshape(len(chances)))


def test_zones_by_hand():
    distances = torch.tensor([0.0, 1.0, 1.0000001, 1.1, 1.1000001, 9], dtype=D)
    assert stitching.zones(distances).tolist() == [0, 0, 1, 1, 2, 2]


def test_a_duel_by_hand():
    # Cubes of half 1 at x = 0 and x = 2. A primitive of the first at x = 1.05: d_1 = 1.05, in the
    # second d_2 = 0.95. w_1 = 0.05, w_2 = 0.15. Q_1 = 0.5 / 0.1 = 5, Q_2 = 0.8 / 0.2 = 4; the rims
    # hold Q_1 alone, so the unit is 5: S_self = 0.05, S_2 = 0.15 * 0.8 = 0.12.
    one = block([0, 0, 0], torch.tensor([[1.05, 0, 0]], dtype=D), opacity=0.5, scale=0.1)
    two = block([2, 0, 0], torch.tensor([[2.0, 0, 0], [2.5, 0, 0]]), opacity=0.8, scale=0.2)
    first, second = stitching.keep_probabilities((one, two), replace(OURS, sharpness=10.0))
    assert float(first[0]) == pytest.approx(1 / (1 + math.exp(10 * 0.07)), abs=1e-9)
    assert second.tolist() == [1, 1]


def test_the_release_scores_logits_unnormalised_against_zero():
    # The same duel: logits 0 and ln 4 over 0.1 and 0.2; epsilon 1e-6 beside them is lost below 1e-4.
    one = block([0, 0, 0], torch.tensor([[1.05, 0, 0]], dtype=D), opacity=0.5, scale=0.1)
    two = block([2, 0, 0], torch.tensor([[2.0, 0, 0], [2.5, 0, 0]]), opacity=0.8, scale=0.2)
    first, _ = stitching.keep_probabilities((one, two), AS_RELEASED)
    rival = 0.15 * math.log(4) / 0.2
    assert float(first[0]) == pytest.approx(1 / (1 + math.exp(30 * rival)), rel=1e-4)
    # Alone it competes with 0 there, and is kept here.
    lone = block([0, 0, 0], torch.tensor([[1.05, 0, 0]]), opacity=0.2, scale=0.1)
    (chance,) = stitching.keep_probabilities((lone,), AS_RELEASED)
    own = 0.05 * math.log(0.25) / 0.1
    assert float(chance[0]) == pytest.approx(1 / (1 + math.exp(-30 * own)), rel=1e-4)
    assert stitching.keep_probabilities((lone,), OURS)[0].tolist() == [1]


@settings(max_examples=20)
@given(blocks=st.integers(1, 4), count=st.integers(0, 16), seed=SEEDS)
def test_core_stays_outside_goes_and_a_seed_decides(blocks, count, seed):
    scene = random_blocks(blocks, count, seed)
    kept = stitching.stitch(scene, OURS, generator(seed))
    again = stitching.stitch(scene, OURS, generator(seed))
    for b, mine, same in zip(scene, kept, again, strict=True):
        zone = stitching.zones(b.box.distance(b.means))
        assert mine[zone == stitching.CORE].all()
        assert not mine[zone == stitching.DROPPED].any()
        assert torch.equal(mine, same)
        if blocks == 1:
            assert torch.equal(mine, zone != stitching.DROPPED)


@settings(max_examples=25)
@given(blocks=st.integers(1, 4), count=st.integers(1, 12), seed=SEEDS)
def test_the_order_of_the_blocks_does_not_matter(blocks, count, seed):
    scene = random_blocks(blocks, count, seed)
    order = torch.randperm(blocks, generator=generator(seed)).tolist()
    kept = stitching.stitch(scene, OURS, generator(seed))
    shuffled = stitching.stitch(tuple(scene[i] for i in order), OURS, generator(seed))
    for place, i in enumerate(order):
        assert torch.equal(shuffled[place], kept[i])


@settings(max_examples=25)
@given(count=st.integers(1, 12), seed=SEEDS)
def test_mirrored_blocks_give_mirrored_probabilities(count, seed):
    one, _ = random_blocks(2, count, seed)
    flip = torch.tensor([-1.0, 1, 1], dtype=D)
    two = replace(
        one, box=replace(cube(one), centre=torch.tensor([2.0, 0, 0], dtype=D)),
        means=(one.means - torch.tensor([1.0, 0, 0])) * flip + torch.tensor([1.0, 0, 0]),
    )  # fmt: skip
    first, second = stitching.keep_probabilities((one, two), OURS)
    assert_close(first, second)


@settings(max_examples=25)
@given(count=st.integers(1, 12), seed=SEEDS, scale=st.floats(0.01, 1000))
def test_the_unit_of_length_changes_nothing(count, seed, scale):
    def scaled(b: TrainedBlock) -> TrainedBlock:
        box = replace(cube(b), centre=b.box.centre * scale, half=cube(b).half * scale)
        return replace(b, box=box, means=b.means * scale, log_scales=b.log_scales + math.log(scale))

    scene = random_blocks(3, count, seed)
    scene = tuple(replace(b, means=b.means.float().double()) for b in scene)
    found = stitching.keep_probabilities(tuple(map(scaled, scene)), OURS)
    for chances, want, b in zip(
        found, stitching.keep_probabilities(scene, OURS), scene, strict=True
    ):
        away = b.box.distance(b.means)
        clear = ((away - 1).abs() > 1e-9) & ((away - 1.1).abs() > 1e-9)  # not on a zone's border
        assert_close(chances[clear], want[clear], atol=1e-6, rtol=0)


def test_sharpness_zero_keeps_half_and_a_huge_one_the_winner():
    scene = random_blocks(2, 4000, 5)
    contested = [
        (p > 0) & (p < 1) for p in stitching.keep_probabilities(scene, replace(OURS, sharpness=1.0))
    ]
    halves = stitching.keep_probabilities(scene, replace(OURS, sharpness=0.0))
    kept = stitching.stitch(scene, replace(OURS, sharpness=0.0), generator(0))
    for chances, mine, rim in zip(halves, kept, contested, strict=True):
        assert (chances[rim] == 0.5).all()
        # Binomial(m, 1/2): five standard deviations.
        assert abs(float(mine[rim].double().mean()) - 0.5) <= 2.5 / math.sqrt(int(rim.sum()))
    for chances in stitching.keep_probabilities(scene, replace(OURS, sharpness=1e9)):
        assert chances.isfinite().all()
        assert ((chances < 1e-6) | (chances > 1 - 1e-6)).double().mean() > 0.999


def test_a_competitor_at_the_same_place_halves_the_chance():
    # Symmetric: both at the middle of the overlap x = 1, where both d are 1.05 in cubes of half 1.
    there = torch.tensor([[1.0, 0, 0]])
    one, two = block([-0.05, 0, 0], there), block([2.05, 0, 0], there)
    for chances in stitching.keep_probabilities((one, two), OURS):
        assert float(chances[0]) == pytest.approx(0.5)


def test_tiny_scales_do_not_overflow():
    one = block([0, 0, 0], torch.tensor([[1.05, 0, 0]]), scale=1e-8)
    two = block([2, 0, 0], torch.tensor([[1.0, 0, 0]]), scale=1e-300)
    for settings_ in (OURS, AS_RELEASED, replace(OURS, sharpness=1e9)):
        for chances in stitching.keep_probabilities((one, two), settings_):
            assert chances.isfinite().all()
            assert ((chances >= 0) & (chances <= 1)).all()


def test_more_neighbours_than_primitives_means_all_of_them():
    scene = random_blocks(2, 4, 1)
    few, many = (stitching.keep_probabilities(scene, replace(OURS, neighbours=k)) for k in (4, 99))
    for a, b in zip(few, many, strict=True):
        assert_close(a, b)


def test_three_blocks_meet_in_a_corner_and_the_strongest_rival_counts():
    corner = torch.tensor([[1.05, 1.05, 0]])
    one = block([0, 0, 0], corner)
    weak = block([2, 0, 0], torch.tensor([[2.0, 0, 0]]), opacity=0.1)
    strong = block([0, 2, 0], torch.tensor([[0, 2.0, 0]]), opacity=0.9)
    alone = stitching.keep_probabilities((one, strong), OURS)[0]
    both = stitching.keep_probabilities((one, weak, strong), OURS)[0]
    assert_close(both, alone)
    assert float(both[0]) < float(stitching.keep_probabilities((one, weak), OURS)[0][0])


def test_dropped_primitives_do_not_compete():
    one = block([0, 0, 0], torch.tensor([[1.05, 0, 0]]))
    far = block([2, 0, 0], torch.tensor([[1.06, 9.0, 0]]))  # inside along x, far outside along y
    assert stitching.keep_probabilities((one, far), OURS)[0].tolist() == [1]


def test_the_probability_has_right_gradients():
    own, rival = (torch.rand(5, generator=generator(s), dtype=D).requires_grad_() for s in (0, 1))
    assert torch.autograd.gradcheck(
        lambda a, b: stitching.keep_probability(a, b, 3.0), (own, rival)
    )


def test_no_blocks_give_nothing():
    assert stitching.stitch((), OURS, generator(0)) == ()


@pytest.mark.parametrize(
    "wrong",
    [{"neighbours": 0}, {"sharpness": -1.0}, {"sharpness": math.inf}, {"sharpness": math.nan}],
)
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(UsageError):
        stitching.keep_probabilities((), replace(OURS, **wrong))


def test_overlapping_cores_by_hand():
    """Two blocks side by side whose wall is at d = 1 of both; places from deep in the first to beyond both."""
    away = torch.tensor(
        [[0.5, 0.95, 1.0, 1.05, 1.2, 1.3], [1.5, 1.05, 1.0, 0.95, 0.8, 1.4]], dtype=D
    )
    hard = [[True, True, True, False, False, False], [False, False, False, True, True, False]]
    assert stitching.overlapping(away, 0.0).tolist() == hard
    wide = [[True, True, True, True, True, False], [False, True, False, True, True, False]]
    assert stitching.overlapping(away, 0.2).tolist() == wide


@given(blocks=st.integers(1, 4), overlap=st.floats(0, 1), seed=SEEDS)
def test_cores_that_overlap_keep_the_hard_cut_and_all_that_lies_in_them(blocks, overlap, seed):
    away = 2.2 * torch.rand(blocks, 200, generator=generator(seed), dtype=D)
    hard, wide = (stitching.overlapping(away, o) for o in (0.0, overlap))
    assert int(hard.sum(dim=0).max()) <= 1
    assert bool(wide[hard].all())
    beyond = away > 1
    assert torch.equal(wide[beyond], (away <= 1 + overlap)[beyond])
