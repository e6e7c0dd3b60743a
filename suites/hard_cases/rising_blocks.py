"""Rising difficulties of rasterizing, partitions, stitching and the small file."""

import math

import torch
from torch import Tensor

from splatproof.reference.compression import spectral
from splatproof.reference.partition import (
    block_time,
    camera_cells,
    contracted_grid,
    density_split,
    ghosts,
    view_sampling,
    visibility,
)  # fmt: skip
from splatproof.reference.partition.block_time import BlockWork, StepCost
from splatproof.reference.partition.boxes import Box
from splatproof.reference.partition.density_split import DensitySettings
from splatproof.reference.partition.view_sampling import SamplingSettings
from splatproof.reference.rasterizer import screen_gradient, smoothing
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.stitching.preclean import CleanSettings, preclean
from splatproof.reference.types.scene import SparsePoints
from splatproof.suites.hard_cases.case import joined
from splatproof.suites.hard_cases.gaussian_scenes import camera_at
from splatproof.suites.hard_cases.rising import Rising, normal, tenth, uniform


def _smoothed(rung: float, scales: Tensor, opacities: Tensor, filters: Tensor) -> Tensor:
    wide, faint = smoothing.smoothed(scales, opacities, filters)
    return joined(wide / rung, faint)


def _sampling(rung: float, means: Tensor) -> Tensor:
    return smoothing.sampling_widths((camera_at(33, 21),), means) / rung


def _screen(rung: float, pixels: Tensor, means: Tensor) -> Tensor:
    """Pulls to all sides that nearly cancel: what is left of them, and their sizes."""
    probe = ScreenProbe.zeros(len(means), means)
    away = screen_gradient.pixel_offsets(pixels, means.detach().requires_grad_(), probe)
    away.square().sum().backward()
    assert probe.signed.grad is not None
    assert probe.absolute.grad is not None
    return joined(probe.signed.grad, probe.absolute.grad) / rung


def _ghosts(rung: float, points: Tensor, alphas: Tensor, colours: Tensor) -> Tensor:
    labels = (points[:, 0] > points[:, 0].median()).long()
    _, auxiliary = ghosts.block_boxes(points, labels, 0)
    ghost = ghosts.ghosts(points, labels, 0, auxiliary)
    depth = points[:, 2] - points[0, 2]
    picture = ghosts.joint_composite(
        alphas[:, ~ghost], depth[~ghost], colours[~ghost], alphas[:, ghost], depth[ghost],
        colours[ghost],
    )  # fmt: skip
    del rung
    return joined(ghost, picture)


def _lattice(count: int, shift: float) -> Tensor:
    """Whole numbers, which float32 holds exactly up to 1e7, away from the origin."""
    return (16 * uniform(count, 3)).floor() + shift


def _contracted(rung: float, points: Tensor) -> Tensor:
    box = Box(low=points.new_tensor([-1.0] * 3), high=points.new_tensor([1.0] * 3))
    unit = contracted_grid.contract(points, box)
    cells = contracted_grid.cell_of(unit, (4, 4, 1))
    return joined(unit, cells, contracted_grid.expand(unit, box) / rung)


def _cells(rung: float, points: Tensor) -> Tensor:
    grid = camera_cells.camera_grid(points[:, :2], 3, 2)
    owners = camera_cells.owner_cell(grid, points[:, :2] + 0.25)
    return joined(grid.row_walls - rung, owners)


def _split(rung: float, points: Tensor) -> Tensor:
    """A cloud of which all but a few points stand in a square `rung` times as small."""
    ground = points[:, :2].clone()
    ground[8:] /= rung
    found = density_split.split(ground, DensitySettings(max_points=8, max_depth=4))
    size = found.highs - found.lows
    return joined(torch.tensor(float(len(found.lows))), size.to(points).sum(dim=0))


def _covering(rung: float, starts: Tensor) -> Tensor:
    """Views of one point each, and one of all, whose share of the block's points is 1 / rung."""
    count = int(rung)
    views = torch.stack([torch.zeros(count), 1 + torch.arange(count)], dim=1).long()
    points = SparsePoints(
        positions=torch.zeros(count, 3).double(), colours=torch.zeros(count, 3).byte(),
        track_starts=2 * torch.arange(count + 1), track_views=views.flatten(),
    )  # fmt: skip
    chosen = torch.arange(count) < count // 2
    taken = visibility.covering_views(points, chosen, count + 1, view_share=0.5, block_share=0.1)
    return joined(taken, visibility.track_lengths(points)).to(starts)


def _times(rung: float, weights: Tensor) -> Tensor:
    """Blocks of which the last takes `rung` times as long as the first; coefficients as far apart."""
    labels = torch.arange(len(weights)) % 4
    seconds = torch.logspace(0, math.log10(rung), 4, dtype=torch.float64)
    even = block_time.reweighted(weights.double(), labels, seconds)
    cost = StepCost(pixel=1e-7, gaussian=1e-7 / rung, pair=1e-8)
    works = [
        BlockWork(steps=10.0, pixels=1e5, gaussians=rung * (4e5 + 1e5 * i), pairs=1e4 * (1 + i * i))
        for i in range(4)
    ]
    found = block_time.fit_step_cost(works, [block_time.block_seconds(w, cost) for w in works])
    fitted = torch.tensor([found.pixel, rung * found.gaussian, found.pair], dtype=torch.float64)
    return joined(even / even.sum(), 1e7 * fitted).to(weights)


def _bins(rung: float, centres: Tensor) -> Tensor:
    """Cameras on rings about a block, `rung` times as high as wide."""
    lifted = centres + centres.new_tensor([0.0, 0, rung])
    frame, middle = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
    settings = SamplingSettings(distances=1)
    return view_sampling.view_bins(lifted.double(), middle, frame, settings).to(centres)


def _ring(count: int = 16) -> Tensor:
    """Places in the middle of the azimuths' bins."""
    turn = 2 * math.pi * (torch.arange(count).double() + 0.5) / count
    return torch.stack([turn.cos(), turn.sin(), 0 * turn], dim=1)


def _clean(rung: float, logits: Tensor, log_scales: Tensor) -> Tensor:
    """Scales over so many decades: volumes underflow, their logarithms do not."""
    wide = log_scales * math.log(rung) - 2
    return preclean(logits, wide, CleanSettings(volume_quantile=0.9)).to(logits)


def _energies(rung: float, rest: Tensor) -> Tensor:
    """Harmonics `rung` times as small; energies in that unit."""
    low = rest / rung
    return joined(
        rung * spectral.order_energies(low), rung * spectral.energy(low),
        spectral.open_gate(low, gate=0.05 / rung), rung * spectral.gated(low, gate=0.05 / rung),
    )  # fmt: skip


CASES = (
    Rising(component="smoothing", name="filter / scale", run=_smoothed, differentiable=True,
           inputs=lambda h: (0.1 + uniform(9, 3), uniform(9, seed=1), h * (0.5 + uniform(9, seed=2)))),
    Rising(component="smoothing", name="depth", run=_sampling,
           inputs=lambda h: (h * (torch.tensor([[0.0, 0, 2]]) + 0.1 * normal(9, 3)),)),
    Rising(component="screen gradient", name="distance in pixels", run=_screen,
           inputs=lambda h: (20 * uniform(64, 2), h * normal(5, 2))),
    Rising(component="ghosts", name="1 / (1 - alpha)", run=_ghosts, differentiable=True,
           inputs=lambda h: (normal(12, 3), 1 - (0.1 + 0.9 * uniform(6, 12)) / h, uniform(12, 3, seed=1))),
    Rising(component="contracted grid", name="distance / box", run=_contracted, rungs=(1.0, 1e2, 1e4),
           inputs=lambda h: (h * (1 + uniform(20, 3)) * torch.tensor([1.0, -1, 0.5]).double(),),
           more=tenth,
           reason="the way back divides by the distance to the border of the cube, 1 / h, that was rounded"),
    Rising(component="camera cells", name="distance from the origin", run=_cells,
           inputs=lambda h: (_lattice(30, h),)),
    Rising(component="density split", name="times as dense", run=_split, rungs=(1.0, 1e1, 1e2, 1e3),
           inputs=lambda h: (normal(64, 3),)),
    Rising(component="visibility", name="points of a view", run=_covering, rungs=(4.0, 40.0, 400.0),
           inputs=lambda h: (torch.zeros(1).double(),)),
    Rising(component="block times", name="slowest / fastest", run=_times, rungs=(1.0, 1e2, 1e4, 1e6),
           inputs=lambda h: (0.1 + uniform(40).double(),)),
    Rising(component="view sampling", name="height / radius", run=_bins, rungs=(1.0, 1e2, 1e4, 1e6),
           inputs=lambda h: (_ring(),)),
    Rising(component="pre-cleaning", name="largest scale / smallest", run=_clean,
           rungs=(1e1, 1e4, 1e8, 1e16), inputs=lambda h: (normal(40), -uniform(40, 3))),
    Rising(component="spectral gate", name="times as weak", run=_energies, rungs=(1.0, 1e4, 1e8, 1e16),
           inputs=lambda h: (0.1 * normal(10, 15, 3),)),
)  # fmt: skip
