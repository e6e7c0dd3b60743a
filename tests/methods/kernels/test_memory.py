"""Scratch memory: bounded, reported, given back; large models fit."""

import subprocess
import sys
from typing import Any

import pytest
import torch

from splatproof import _ext
from splatproof.methods.kernels import rasterizer as native
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene, random_scene

ALL_ROWS = 2**22
"""The default of set_backward_rows."""


def gradients(scene: GaussianScene) -> list[torch.Tensor]:
    leaves = scene.arguments(torch.float32)
    out = native.rasterize(scene.camera, *leaves[:4], sh=leaves[4])
    weight = torch.rand(out.colour.shape, generator=torch.Generator().manual_seed(1))
    (out.colour * weight + out.depth[..., None]).sum().backward()
    return [leaf.grad for leaf in leaves if leaf.grad is not None]


@pytest.fixture
def few_rows():
    yield _ext.set_backward_rows
    _ext.set_backward_rows(ALL_ROWS)


@pytest.mark.parametrize("rows", [1, 100, 1000])
def test_a_bounded_backward_pass_has_the_same_bits(few_rows, rows):
    scene = random_scene(600, 3, width=130, height=70)
    whole = gradients(scene)
    few_rows(rows)
    for one, other in zip(whole, gradients(scene), strict=True):
        assert torch.equal(one, other)


def test_fewer_rows_take_less_memory(few_rows):
    scene = random_scene(600, 3, width=500, height=400)
    peaks = []
    for rows in (ALL_ROWS, 64):
        few_rows(rows)
        _ext.forget_peak()
        before = _ext.memory()[0]
        gradients(scene)
        peaks.append(_ext.memory()[1] - before)
    leaves = scene.arguments(torch.float32)
    node: Any = native.rasterize(scene.camera, *leaves[:4], sh=leaves[4]).colour.grad_fn
    pairs = node.state.pairs
    # of the 64 bytes that a pair takes, at most those of the longest tile and of each Gaussian are left
    assert peaks[1] < peaks[0] - 64 * (pairs / 2 - 2 * 600)


def test_scratch_is_given_back():
    before = _ext.memory()[0]
    gradients(random_scene(600, 3, width=130, height=70))
    held, peak, idle = _ext.memory()
    assert held == before
    assert peak > before
    assert idle > 0


@pytest.mark.slow
def test_what_is_kept_of_large_pictures_is_bounded():
    """Each of another size, so that none finds what the one before has given back."""
    for width in (4000, 4500, 5000):
        gradients(random_scene(20, 3, width=width, height=3000))
        assert _ext.memory()[2] <= 2**29
    assert _ext.memory()[2] > 0


LARGE = """
import resource, torch
from splatproof.methods.kernels import rasterizer
from splatproof.reference.types.camera import Camera
n, g = 5_000_000, torch.Generator().manual_seed(1)
z = 2 + 8 * torch.rand(n, generator=g)
means = torch.stack([(torch.rand(n, generator=g) - 0.5) * z, 0.75 * (torch.rand(n, generator=g) - 0.5) * z, z], 1)
scales = (1 + 3 * torch.rand(n, 3, generator=g)) * z[:, None] / 1600
K = torch.tensor([[1600, 0, 800], [0, 1600, 600], [0, 0, 1]], dtype=torch.float64)
camera = Camera(K=K, world_to_camera=torch.eye(4, dtype=torch.float64), width=1600, height=1200)
out = rasterizer.rasterize(
    camera, means, torch.randn(n, 4, generator=g), scales, 0.1 + 0.8 * torch.rand(n, generator=g),
    sh=0.1 * torch.randn(n, 16, 3, generator=g),
)
assert float(out.alpha.mean()) > 0.99
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


@pytest.mark.slow
def test_five_million_gaussians_render_in_six_gigabytes():
    run = [sys.executable, "-P", "-c", LARGE]
    megabytes = int(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
    assert megabytes < 6000
