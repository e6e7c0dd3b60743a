"""Blocks in one pass against rendering each block separately."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatproof.methods.kernels.blocks import block_weights, render_blocks
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.hard_cases.gaussian_scenes import random_scene

BACKGROUND = torch.tensor([0.2, 0.5, 0.7])


def model_of(scene) -> Gaussians:
    return Gaussians(
        means=scene.means, quaternions=scene.quaternions, log_scales=scene.scales.log(),
        opacity_logits=torch.logit(scene.opacities.clamp(1e-6, 1 - 1e-6)), sh=scene.sh,
    )  # fmt: skip


def alone(camera, model: Gaussians, chosen: torch.Tensor, mode):
    return rasterize(
        camera, model.means[chosen], model.quaternions[chosen], model.scales[chosen],
        model.opacities[chosen], sh=model.sh[chosen], background=BACKGROUND, mode=mode,
    )  # fmt: skip


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    n=st.integers(0, 150),
    count=st.integers(1, 7),
    seed=st.integers(0, 2**20),
    size=st.tuples(st.integers(1, 50), st.integers(1, 50)),
    degree=st.integers(0, 3),
    mode=st.sampled_from(["classic", "antialiased"]),
)
def test_each_block_is_its_own_render_to_the_bit(simd_level, n, count, seed, size, degree, mode):
    scene = random_scene(n, seed, width=size[0], height=size[1], degree=degree)
    g = torch.Generator().manual_seed(seed)
    blocks, model = torch.randint(0, count, (n,), generator=g), model_of(scene)
    got = render_blocks(scene.camera, model, blocks, count, background=BACKGROUND, mode=mode)
    for block in range(count):
        wanted = alone(scene.camera, model, blocks == block, mode)
        assert torch.equal(got.colours[block], wanted.colour)
        assert torch.equal(got.alphas[block], wanted.alpha)
        assert torch.equal(got.depths[block], wanted.depth)


@pytest.mark.parametrize("count", [1, 3, 32, 33, 70])
def test_weights_are_the_shares_of_the_pixel(count):
    scene = random_scene(120, 4)
    blocks = torch.arange(120) % count
    model = model_of(scene)
    weights = block_weights(scene.camera, model, blocks, count)
    truth = reference.rasterize(
        scene.camera, model.means.double(), model.quaternions.double(), model.scales.double(),
        model.opacities.double(), colours=torch.nn.functional.one_hot(blocks, count).double(),
    )  # fmt: skip
    torch.testing.assert_close(weights.double(), truth.colour, rtol=0, atol=2e-5)
    torch.testing.assert_close(weights.double().sum(dim=-1), truth.alpha, rtol=0, atol=2e-5)


def test_gaussians_that_change_their_block_are_seen():
    scene = random_scene(60, 5)
    blocks = torch.arange(60) % 2
    model = model_of(scene)
    right = render_blocks(scene.camera, model, blocks, 2)
    wrong = render_blocks(scene.camera, model, 1 - blocks, 2)
    assert not torch.equal(right.colours, wrong.colours)
    assert torch.equal(right.colours, wrong.colours.flip(0))


def test_bits_do_not_depend_on_threads():
    scene = random_scene(700, 3, width=90, height=70)
    before, pictures = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            pictures.append(render_blocks(scene.camera, model_of(scene), torch.arange(700) % 5, 5))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(pictures[0].colours, pictures[1].colours)


@pytest.mark.parametrize("block", [-1, 2])
def test_a_block_out_of_range_is_named(block):
    scene = random_scene(5, 1)
    with pytest.raises(ValueError, match=rf"blocks\[3\] is {block}, expected 0 to 1"):
        render_blocks(scene.camera, model_of(scene), torch.tensor([0, 1, 1, block, 0]), 2)
    with pytest.raises(ValueError, match="count is 0"):
        render_blocks(scene.camera, model_of(scene), torch.zeros(5, dtype=torch.int64), 0)
