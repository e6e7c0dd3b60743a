"""Ghost Gaussians: who they are, what is frozen, and one composite for all."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.partition import ghosts
from splatproof.reference.partition.boxes import inside
from splatproof.reference.rasterizer import compositing
from splatproof.reference.types.gaussians import Gaussians

SEEDS = st.integers(0, 2**16)
D = torch.float64


def uniform(*shape: int, seed: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=D)


@settings(max_examples=40)
@given(count=st.integers(0, 12), pixels=st.integers(0, 3), seed=SEEDS, tied=st.booleans())
def test_core_and_ghosts_composite_to_their_union(count, pixels, seed, tied):
    alpha, colour = uniform(pixels, count, seed=seed), uniform(count, 3, seed=seed + 1)
    depth = uniform(count, seed=seed + 2)
    depth = (4 * depth).floor() if tied else depth
    ghost = uniform(count, seed=seed + 3) < 0.4
    found = ghosts.joint_composite(
        alpha[:, ~ghost], depth[~ghost], colour[~ghost],
        alpha[:, ghost], depth[ghost], colour[ghost],
    )  # fmt: skip
    # Pixel by pixel: nearest first, the core before ghosts of the same depth, then by index.
    order = sorted(range(count), key=lambda i: (float(depth[i]), bool(ghost[i]), i))
    for p in range(pixels):
        light, want = 1.0, torch.zeros(3, dtype=D)
        for i in order:
            a = float(alpha[p, i])
            if light * (1 - a) < compositing.T_MIN:
                break
            want = want + light * a * colour[i]
            light *= 1 - a
        assert_close(found[p], want)


def test_two_separate_composites_would_count_twice():
    # A ghost of alpha 0.5 in front of a core of alpha 0.8, both white: 0.5 + 0.5 * 0.8 = 0.9.
    # Composited apart and added they would give 0.5 + 0.8 = 1.3, more than full opacity.
    white, one = torch.ones(1, 1, dtype=D), torch.ones(1, dtype=D)
    found = ghosts.joint_composite(0.8 * white, 2 * one, white, 0.5 * white, one, white)
    assert_close(found, torch.full((1, 1), 0.9, dtype=D))


def test_the_joint_composite_has_right_gradients():
    core, ghost = uniform(2, 3, seed=1) * 0.8, uniform(2, 2, seed=2) * 0.8
    depths = torch.tensor([1.0, 3, 5], dtype=D), torch.tensor([2.0, 4], dtype=D)
    colours = uniform(3, 3, seed=3), uniform(2, 3, seed=4)

    def render(a: Tensor, b: Tensor, c: Tensor, d: Tensor) -> Tensor:
        return ghosts.joint_composite(a, depths[0], c, b, depths[1], d)

    inputs = tuple(t.requires_grad_() for t in (core, ghost, *colours))
    assert torch.autograd.gradcheck(render, inputs)


@settings(max_examples=30)
@given(count=st.integers(1, 60), blocks=st.integers(1, 4), seed=SEEDS)
def test_ghosts_are_the_neighbours_within_the_rim(count, blocks, seed):
    points = uniform(count, 3, seed=seed)
    labels = torch.randint(0, blocks, (count,), generator=torch.Generator().manual_seed(seed))
    block = int(labels[0])
    core, auxiliary = ghosts.block_boxes(points, labels, block)
    found = ghosts.ghosts(points, labels, block, auxiliary)
    assert not found[labels == block].any()
    assert inside(core, points)[labels == block].all()
    # Outside the core by at most a tenth of its size on each axis.
    size = core.high - core.low
    beyond = torch.maximum(core.low - points, points - core.high).clamp(min=0)
    near = (beyond <= 0.1 * size + 1e-12).all(dim=1)
    assert torch.equal(found, near & (labels != block))


def test_a_neighbour_inside_the_core_box_is_a_ghost():
    points = torch.tensor([[0.0, 0, 0], [2, 2, 2], [1, 1, 1], [2.1, 2, 2], [2.3, 2, 2]])
    labels = torch.tensor([0, 0, 1, 1, 1])
    _, auxiliary = ghosts.block_boxes(points, labels, 0)
    assert ghosts.ghosts(points, labels, 0, auxiliary).tolist() == [False, False, True, True, False]


def model(count: int, seed: int) -> Gaussians:
    return Gaussians(
        means=uniform(count, 3, seed=seed).requires_grad_(),
        quaternions=uniform(count, 4, seed=seed).requires_grad_(),
        log_scales=uniform(count, 3, seed=seed).requires_grad_(),
        opacity_logits=uniform(count, seed=seed).requires_grad_(),
        sh=uniform(count, 4, 3, seed=seed).requires_grad_(),
    )


STRUCTURE = ("means", "quaternions", "log_scales")
APPEARANCE = ("opacity_logits", "sh")


@settings(max_examples=20)
@given(count=st.integers(0, 8), seed=SEEDS, dual=st.booleans())
def test_freezing_keeps_values_and_stops_the_ghosts_gradients(count, seed, dual):
    ghost = uniform(count, seed=seed + 1) < 0.5
    raw = model(count, seed)
    frozen = ghosts.freeze(raw, ghost, dual=dual)
    total = torch.zeros((), dtype=D)
    for name in STRUCTURE + APPEARANCE:
        assert torch.equal(getattr(frozen, name), getattr(raw, name))
        total = total + getattr(frozen, name).sum()
    total.backward()
    for name in STRUCTURE + APPEARANCE:
        gradient = getattr(raw, name).grad
        follows = dual and name in APPEARANCE
        assert (gradient[~ghost] == 1).all()
        assert (gradient[ghost] == (1 if follows else 0)).all()
