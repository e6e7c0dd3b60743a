import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from helpers.splats import colours, slots
from splatproof.reference.anchors import scaffold as an
from splatproof.reference.types import mlp

D = torch.float64
EYE = torch.tensor([0.3, -0.2, 5.0], dtype=D)


def scene(n: int, k: int, seed: int) -> tuple[an.Anchors, an.Decoder]:
    g = torch.Generator().manual_seed(seed)
    stored = an.Anchors(
        centres=torch.randn(n, 3, generator=g, dtype=D),
        offsets=torch.randn(n, k, 3, generator=g, dtype=D),
        features=torch.randn(n, 8, generator=g, dtype=D),
        log_scales=torch.randn(n, 6, generator=g, dtype=D) - 2,
    )
    return stored, an.create_decoder(8, k, g, dtype=D)


@given(n=st.integers(0, 6), k=st.integers(1, 4), seed=st.integers(0, 2**16))
@settings(max_examples=30)
def test_decoding_by_loop(n, k, seed):
    stored, _ = scene(n, k, seed)
    far = seed % 2 == 1
    weights = torch.Generator().manual_seed(seed + 1)
    decoder = an.create_decoder(8, k, weights, extra=4 if far else 3, dtype=D)
    got = an.decode(stored, decoder, EYE, with_distance=far)
    row = 0
    for i in range(n):
        way = stored.centres[i] - EYE
        length = [way.norm()[None]] if far else []
        code = torch.cat([stored.features[i], way / way.norm(), *length])[None]
        outputs = {
            name: mlp.evaluate(getattr(decoder, name), code)[0]
            for name in ("opacity", "shape", "colour")
        }
        for j in range(k):
            opacity = float(torch.tanh(outputs["opacity"][j]))
            if opacity <= 0:
                continue
            assert int(slots(got)[row]) == i * k + j
            assert float(got.opacities[row]) == pytest.approx(opacity)
            mean = stored.centres[i] + stored.offsets[i, j] * stored.log_scales[i, :3].exp()
            assert_close(got.means[row], mean)
            shape = outputs["shape"][7 * j : 7 * j + 7]
            assert_close(got.scales[row], stored.log_scales[i, 3:].exp() * shape[:3].sigmoid())
            dead = not shape[3:].any()  # all hidden units asleep: the identity
            turn = torch.eye(4, dtype=D)[0] if dead else shape[3:] / shape[3:].norm()
            assert_close(got.quaternions[row], turn)
            assert_close(colours(got)[row], outputs["colour"][3 * j : 3 * j + 3].sigmoid())
            row += 1
    assert len(slots(got)) == row


@given(n=st.integers(1, 6), seed=st.integers(0, 2**16))
@settings(max_examples=20)
def test_permuting_anchors_permutes_the_gaussians(n, seed):
    stored, decoder = scene(n, 3, seed)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    moved = an.Anchors(
        centres=stored.centres[order], offsets=stored.offsets[order],
        features=stored.features[order], log_scales=stored.log_scales[order],
    )  # fmt: skip
    a, b = an.decode(stored, decoder, EYE), an.decode(moved, decoder, EYE)
    back = order[slots(b) // 3] * 3 + slots(b) % 3
    again = torch.argsort(back)
    assert_close(back[again], slots(a))
    assert_close(b.means[again], a.means)
    assert_close(colours(b)[again], colours(a))


def test_distance_is_read_where_it_is_asked_for():
    stored, _ = scene(12, 4, 0)
    g = torch.Generator().manual_seed(1)
    decoder = an.create_decoder(8, 4, g, extra=4, dtype=D)
    away = EYE + 3 * (EYE - stored.centres[0])  # same direction for anchor 0, four times as far
    near = an.decode(stored, decoder, EYE, with_distance=True)
    far = an.decode(stored, decoder, away, with_distance=True)
    direction, distance = an.view_code(stored.centres[:1], away)
    assert_close(direction, an.view_code(stored.centres[:1], EYE)[0])
    assert float(distance) == pytest.approx(4 * math.dist(stored.centres[0], EYE))
    assert len(slots(near)) > 0
    assert len(slots(near)) != len(slots(far)) or not torch.equal(colours(near), colours(far))


def test_a_camera_at_an_anchor_is_finite():
    stored, decoder = scene(3, 2, 2)
    centres = stored.centres.clone().requires_grad_()
    got = an.decode(
        replace(stored, centres=centres), decoder, stored.centres[0], with_distance=False
    )
    assert colours(got).isfinite().all()
    (colours(got).sum() + got.opacities.sum()).backward()
    assert centres.grad is not None
    assert centres.grad.isfinite().all()


def test_nothing_opaque_is_an_empty_set():
    stored, decoder = scene(3, 2, 2)
    closed = mlp.change(decoder.opacity, torch.zeros_like)
    got = an.decode(stored, replace(decoder, opacity=closed), EYE)
    assert len(slots(got)) == 0
    assert float(an.volume_loss(got.scales)) == 0


def test_volume_by_hand():
    scales = torch.tensor([[1.0, 2, 3], [0.5, 1, 2]], dtype=D)
    assert float(an.volume_loss(scales)) == pytest.approx((6 + 1) / 2)


@given(n=st.integers(0, 40), seed=st.integers(0, 2**16), voxel=st.floats(0.01, 2))
def test_voxels_are_distinct_near_their_points_and_stable(n, seed, voxel):
    points = torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=D) * 3
    centres = an.anchor_voxels(points, voxel)
    assert len(torch.unique(centres, dim=0)) == len(centres) <= n
    if n:
        gap = (points[:, None] - centres[None]).abs().amax(dim=2).amin(dim=1)
        assert (gap <= voxel / 2 + 1e-12).all()
    assert_close(an.anchor_voxels(centres, voxel), centres)


def test_voxel_size_must_be_positive():
    with pytest.raises(ValueError, match="voxel size"):
        an.anchor_voxels(torch.zeros(1, 3), -1.0)


def test_candidates_by_hand():
    gradients = torch.tensor([50 * 2e-4, 50 * 1.9e-4, 50 * 9e-4, 40 * 1.0], dtype=D)
    counts = torch.tensor([50, 50, 50, 40])
    sure, never = torch.full((4,), 0.99, dtype=D), torch.full((4,), 0.2, dtype=D)
    at = lambda level, draw: an.candidates(gradients, counts, level, 2e-4, 40, draw).tolist()
    assert at(0, sure) == [True, False, True, False]
    assert at(2, sure) == [False, False, True, False]
    assert at(0, never) == [False] * 4  # 0.2 <= 0.5
    assert at(2, never) == [False, False, True, False]  # 0.2 > 0.125


def slots_of(stored: an.Anchors) -> Tensor:
    reach = stored.log_scales[:, None, :3].exp()
    return (stored.centres[:, None] + stored.offsets * reach).reshape(-1, 3)


@given(n=st.integers(1, 8), seed=st.integers(0, 2**16), cell=st.floats(0.05, 2))
@settings(max_examples=40)
def test_growth_fills_each_asked_cell_once_and_touches_nothing_old(n, seed, cell):
    stored, _ = scene(n, 3, seed)
    positions = slots_of(stored)
    wanted = torch.rand(3 * n, generator=torch.Generator().manual_seed(seed)) > 0.4
    grown = an.grow(stored, positions, wanted, cell)
    for name in ("centres", "offsets", "features", "log_scales"):
        assert torch.equal(getattr(grown, name)[:n], getattr(stored, name))
    taken = {tuple(x) for x in (stored.centres / cell).round().long().tolist()}
    asked: dict[tuple, list[int]] = {}
    for slot in torch.where(wanted)[0].tolist():
        key = tuple((positions[slot] / cell).round().long().tolist())
        if key not in taken:
            asked.setdefault(key, []).append(slot // 3)
    new = {
        tuple((c / cell).round().long().tolist()): f
        for c, f in zip(grown.centres[n:], grown.features[n:], strict=True)
    }
    assert sorted(new) == sorted(asked)
    for key, parents in asked.items():
        assert_close(new[key], stored.features[parents].amax(dim=0))
    assert_close(grown.log_scales[n:].exp(), torch.full_like(grown.log_scales[n:], cell))
    again = an.grow(grown, positions, torch.cat([wanted]), cell)
    assert len(again.centres) == len(grown.centres)


def test_nothing_wanted_grows_nothing():
    stored, _ = scene(3, 2, 0)
    none = torch.zeros(6, dtype=torch.bool)
    assert len(an.grow(stored, slots_of(stored), none, 0.1).centres) == 3


def test_pruning_by_hand():
    sums = torch.tensor([0.4, 0.6, 0.0, 0.0], dtype=D)
    visits = torch.tensor([100, 100, 80, 81])
    assert an.keep_visible(sums, visits).tolist() == [False, True, True, False]


def test_gradients():
    stored, decoder = scene(3, 2, 5)
    inputs = [
        x.clone().requires_grad_() for x in (stored.offsets, stored.features, stored.log_scales)
    ]

    def run(offsets, features, log_scales):
        other = an.Anchors(
            centres=stored.centres, offsets=offsets, features=features, log_scales=log_scales
        )
        got = an.decode(other, decoder, EYE)
        return got.means, got.scales, got.quaternions, got.opacities, colours(got)

    assert torch.autograd.gradcheck(run, inputs)
