"""Hard cases of depth, dynamics, appearance, layered memory, planes and anchors."""

import torch
from torch import Tensor

from splatproof.reference.anchors import attention as anchor_attention
from splatproof.reference.anchors import hvi, sparse_convolution, support_network, vibration
from splatproof.reference.layered_memory import layered_depth, multi_plane
from splatproof.reference.rasterizer import rotation, spherical_harmonics
from splatproof.reference.supervision import depth_constraint, soft_rank
from splatproof.reference.types.camera import Camera
from splatproof.suites.hard_cases.case import HardCase, drawn, fixed, joined

ZERO = torch.zeros(1)


def _camera() -> Camera:
    K = torch.tensor([[6.0, 0, 3], [0, 6, 3], [0, 0, 1]], dtype=torch.float64)
    return Camera(K=K, world_to_camera=torch.eye(4, dtype=torch.float64), width=6, height=6)


def _ranks(tau: float):
    return lambda z: soft_rank.soft_rank(z, tau)


def _spearman(tau: float):
    return lambda a, b: soft_rank.spearman(a, b, tau)


def _layers(eps: float):
    def run(points: Tensor) -> Tensor:
        memory = layered_depth.insert(
            layered_depth.empty(_camera(), eps), points, torch.zeros_like(points)
        )
        return joined(memory.depths, memory.counts)

    return run


def _axis(*depths: float) -> Tensor:
    """Points on the optical axis."""
    return torch.tensor([[0.0, 0.0, z] for z in depths])


def _valid_depth(kind: str) -> tuple[Tensor, ...]:
    depth = 1 + torch.rand(5, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    valid = torch.zeros(5, 6, dtype=torch.float64)
    valid += kind not in ("none", "one")
    if kind == "one":
        valid[2, 2] = 1
    if kind == "constant":
        depth[:] = 3
    if kind in ("inf", "nan"):
        depth[1, 1], valid[1, 1] = float(kind), 0
    return depth, valid


def _normalise(depth: Tensor, valid: Tensor) -> Tensor:
    return depth_constraint.normalise_disparity(depth, valid > 0)


def _attention(radius: float):
    weights = anchor_attention.create(4, 3, torch.Generator().manual_seed(0), torch.float64)

    def run(features: Tensor, centres: Tensor) -> Tensor:
        same = anchor_attention.AttentionWeights(
            **{name: value.to(features) for name, value in vars(weights).items()}
        )
        return anchor_attention.local_attention(features, centres, radius, same)

    return run


def _support(centres: Tensor, scales: Tensor) -> Tensor:
    network = support_network.create(3, torch.Generator().manual_seed(0), centres.dtype)
    quaternions = torch.ones(len(centres), 4).to(centres)
    features = torch.ones(len(centres), 3).to(centres)
    return support_network.support(network, features, centres, quaternions, scales, 1.0)


def _hits(origin: Tensor, directions: Tensor) -> Tensor:
    stack = multi_plane.PlaneStack(
        normal=torch.tensor([0.0, 0, 1]).to(origin), offsets=torch.tensor([0.0, -5]).to(origin)
    )
    hits = multi_plane.ray_hits(stack, origin, directions, 0.01)
    return joined(hits.positions, multi_plane.opacity_bias(hits), hits.valid)


def _normal(points: Tensor) -> Tensor:
    return multi_plane.plane_normal(points, torch.tensor([0.0, 0, 1]).to(points))


OCTAHEDRON = torch.cat([torch.eye(3), -torch.eye(3)])

CASES = (
    HardCase(component="rotation", name="zero quaternion", inputs=fixed(torch.zeros(1, 4)),
             run=rotation.rotation_matrix, differentiable=True),
    HardCase(component="rotation", name="norm 1e-30",
             inputs=fixed(1e-30 * torch.tensor([[1.0, 2, 3, 4]])), run=rotation.rotation_matrix),
    HardCase(component="rotation", name="norm 1e30",
             inputs=fixed(1e30 * torch.tensor([[1.0, 2, 3, 4]])), run=rotation.rotation_matrix),
    HardCase(component="spherical harmonics", name="mean at the camera centre",
             inputs=fixed(torch.ones(1, 3), torch.ones(3)),
             run=spherical_harmonics.directions_to, differentiable=True),
    HardCase(component="soft rank", name="constant", inputs=fixed(torch.ones(9), torch.arange(9.0)),
             run=_spearman(0.1), differentiable=True),
    HardCase(component="soft rank", name="ties", inputs=fixed(torch.tensor([1.0, 1, 2, 2, 3])),
             run=_ranks(0.1), differentiable=True),
    HardCase(component="soft rank", name="tau 1e-8", inputs=drawn(1, (20,), (20,)),
             run=_spearman(1e-8), differentiable=True),
    HardCase(component="soft rank", name="tau 1e8", inputs=drawn(1, (20,)), run=_ranks(1e8)),
    HardCase(component="soft rank", name="tau 0", inputs=drawn(1, (5,)), run=_ranks(0.0),
             expect="refused"),
    HardCase(component="soft rank", name="NaN", inputs=fixed(torch.tensor([1.0, torch.nan])),
             run=_ranks(1.0), expect="refused"),
    HardCase(component="depth normalisation", name="no valid pixel",
             inputs=lambda: _valid_depth("none"), run=_normalise),
    HardCase(component="depth normalisation", name="one valid pixel",
             inputs=lambda: _valid_depth("one"), run=_normalise),
    HardCase(component="depth normalisation", name="constant",
             inputs=lambda: _valid_depth("constant"), run=_normalise),
    HardCase(component="depth normalisation", name="masked inf",
             inputs=lambda: _valid_depth("inf"), run=_normalise),
    HardCase(component="depth normalisation", name="masked NaN",
             inputs=lambda: _valid_depth("nan"), run=_normalise),
    HardCase(component="vibration", name="time far outside",
             inputs=drawn(2, (4, 3), (4, 3), (4,)),
             run=lambda c, v, p: vibration.vibrate(c, v, p, 1e5, 1.0), budget=0.05),
    HardCase(component="vibration", name="velocity 0",
             inputs=lambda: (*drawn(3, (4, 3))(), torch.zeros(4, 3).double(), *drawn(4, (4,))()),
             run=lambda c, v, p: vibration.vibrate(c, v, p, 3.0, 1.0), differentiable=True),
    HardCase(component="vibration", name="period 0", inputs=drawn(2, (4, 3), (4, 3), (4,)),
             run=lambda c, v, p: vibration.vibrate(c, v, p, 1.0, 0.0), expect="refused"),
    HardCase(component="vibration", name="span 0", inputs=fixed(torch.zeros(2), torch.zeros(2)),
             run=lambda p, s: vibration.life(p, s, 0.0), expect="refused"),
    HardCase(component="sparse convolution", name="one site", inputs=fixed(torch.zeros(1, 3), ),
             run=lambda x: sparse_convolution.neighbours(sparse_convolution.voxelise(x, 1.0))),
    HardCase(component="sparse convolution", name="negative coordinates",
             inputs=fixed(-torch.tensor([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]])),
             run=lambda x: sparse_convolution.neighbours(sparse_convolution.voxelise(x, 1.0))),
    HardCase(component="support network", name="spheres",
             inputs=fixed(torch.tensor([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5]]), torch.ones(2, 3)),
             run=_support),
    HardCase(component="attention", name="one anchor", inputs=drawn(5, (1, 4), (1, 3)),
             run=_attention(1.0), differentiable=True),
    HardCase(component="attention", name="isolated anchors",
             inputs=lambda: (*drawn(6, (3, 4))(), 1e4 * torch.eye(3).double()),
             run=_attention(1.0), differentiable=True),
    HardCase(component="attention", name="radius 0", inputs=drawn(7, (4, 4), (4, 3)),
             run=_attention(0.0)),
    HardCase(component="HVI", name="black image", inputs=fixed(torch.zeros(4, 4, 3)),
             run=hvi.descriptor, differentiable=True),
    HardCase(component="HVI", name="grey image", inputs=fixed(torch.full((4, 4, 3), 0.5)),
             run=hvi.descriptor),
    HardCase(component="layered depth", name="equal depths", inputs=fixed(_axis(2.0, 2.0, 2.0)),
             run=_layers(0.1)),
    HardCase(component="layered depth", name="chain of close depths",
             inputs=fixed(_axis(*[2 + 0.0625 * k for k in range(9)])), run=_layers(0.07)),
    HardCase(component="layered depth", name="negative and zero depth",
             inputs=fixed(_axis(-1.0, 0.0, 1.0)), run=_layers(0.1)),
    HardCase(component="layered depth", name="over the cap",
             inputs=fixed(_axis(*(float(z) for z in range(1, 21)))), run=_layers(0.1)),
    HardCase(component="multi plane", name="cloud of one point", inputs=fixed(torch.ones(1, 3)),
             run=_normal, expect="refused"),
    HardCase(component="multi plane", name="collinear cloud",
             inputs=fixed(torch.arange(6.0)[:, None] * torch.tensor([1.0, 2, 3])), run=_normal,
             expect="refused"),
    HardCase(component="multi plane", name="sphere", inputs=fixed(OCTAHEDRON), run=_normal,
             expect="refused"),
    HardCase(component="multi plane", name="plane through the camera",
             inputs=fixed(torch.tensor([0.0, 0, 5]), torch.tensor([[0.0, 0, -1]])), run=_hits),
    HardCase(component="multi plane", name="ray parallel to the planes",
             inputs=fixed(torch.tensor([0.0, 0, 2]), torch.tensor([[1.0, 0, 0]])), run=_hits),
)  # fmt: skip
