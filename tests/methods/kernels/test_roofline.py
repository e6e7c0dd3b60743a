"""Peaks are plausible, pairs are counted as the definition says, stages are told apart."""

import pytest
import torch

from splatproof import _ext
from splatproof.methods.kernels import rasterizer as native
from splatproof.methods.kernels.roofline import count_pairs, measure_peak
from splatproof.reference.rasterizer import compositing, projection, rotation
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene, random_scene


def brute_force(scene: GaussianScene) -> tuple[int, int]:
    """Contributing pairs and lanes of 4x4 blocks by the definition, all pixels x all Gaussians."""
    camera = scene.camera
    means, quaternions, scales, opacities = (v.detach() for v in scene.arguments(torch.float64)[:4])
    flat = projection.project(camera, means, rotation.half_covariance(quaternions, scales))
    drawn = torch.where(flat.in_front)[0]
    order = drawn[torch.sort(flat.depths[drawn], stable=True).indices]
    rows, columns = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    pixels = torch.stack([columns, rows], dim=-1).reshape(-1, 2).double() + 0.5
    alpha = compositing.alphas(
        pixels[:, None] - flat.means[order], flat.conics[order], opacities[order]
    )
    after = (1 - alpha).cumprod(dim=1)
    contributing = int(((alpha > 0) & (after >= compositing.T_MIN)).sum())
    block = (rows // 4 * ((camera.width + 3) // 4) + columns // 4).flatten()
    before = torch.cat([torch.ones(len(after), 1), after[:, :-1]], dim=1)
    count = int(block.max()) + 1
    meets = torch.zeros(count, len(order)).index_add_(0, block, (alpha > 0).float()) > 0
    open_ = torch.zeros(count, len(order)).index_add_(
        0, block, (before[:, : len(order)] >= compositing.T_MIN).float()
    )
    return contributing, 16 * int((meets & (open_ > 0)).sum())


@pytest.mark.parametrize(("count", "seed"), [(0, 0), (1, 1), (60, 2), (400, 3)])
def test_pairs_are_those_of_the_definition(count, seed):
    scene = random_scene(count, seed)
    found = count_pairs(scene.camera, scene.means, scene.quaternions, scene.scales, scene.opacities)
    assert (found.contributing, found.lanes) == (brute_force(scene) if count else (0, 0))
    assert found.lanes >= found.contributing


def test_a_hidden_gaussian_is_not_counted():
    """Control: behind twenty opaque walls nothing is drawn."""
    scene = random_scene(21, 5)
    n = len(scene.means)
    depth = torch.arange(1.0, n + 1)
    ray = torch.tensor([0.0, 0.0, 1.0])
    pose = scene.camera.world_to_camera.float()
    means = (depth[:, None] * ray - pose[:3, 3]) @ pose[:3, :3]
    walls = (scene.camera, means, scene.quaternions, 5 * depth[:, None].expand(-1, 3))
    opaque = count_pairs(*walls, torch.ones(n))
    pixels = scene.camera.width * scene.camera.height
    # alpha is 0.99 at most: the second wall leaves 1e-4, whose rounding decides
    assert pixels <= opaque.contributing <= 2 * pixels
    thin = count_pairs(*walls, torch.full((n,), 0.02))
    assert thin.contributing == n * pixels


def test_peaks_are_such_as_a_processor_has():
    peak = measure_peak(0.02, 2**20)
    for rate in (peak.flops, peak.blend_pairs, peak.blend_backward_pairs, peak.bytes):
        assert 1e7 < rate < 1e14  # a machine that others use gives little of it


@pytest.mark.parametrize(("seconds", "size"), [(0.0, 100), (float("nan"), 100), (0.1, 0)])
def test_senseless_requests_are_refused(seconds, size):
    with pytest.raises(ValueError, match="seconds must be"):
        _ext.roofline(seconds, size)


def test_stages_are_timed():
    scene = random_scene(200, 1)
    leaves = scene.arguments(torch.float32)
    native.rasterize(scene.camera, *leaves[:4], sh=leaves[4]).colour.sum().backward()
    stages = _ext.stage_seconds()
    assert set(stages) == {"project", "bin", "blend", "blend_backward", "project_backward"}
    assert all(0 < value < 10 for value in stages.values())
