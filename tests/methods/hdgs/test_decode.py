"""The wide decoding against the reference's layer by layer."""

import pytest
import torch

from splatproof.methods.hdgs import networks as nets
from splatproof.methods.hdgs.decode import decoded, placed
from splatproof.methods.hdgs.start import drawn_offsets
from splatproof.reference.anchors.motion_hierarchy import (
    HierarchySettings,
    MotionAnchors,
    by_leaf,
    decode,
)
from splatproof.reference.rasterizer import rotation

F64 = torch.float64


def made(layers: int, seed: int = 0, peak: float | None = None):
    """Random anchors and networks, all residuals and spans at work, in float64."""
    sizes = by_leaf(HierarchySettings(layers=layers, features=5, instance=3), 3)
    generator = torch.Generator().manual_seed(seed)
    count = 7

    def random(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator).to(F64)

    shared = nets.drawn(sizes, seed, ice=False)
    shared = {n: random(*v.shape) * 0.3 for n, v in shared.items()}
    peaks = random(count) if peak is None else torch.full((count,), peak, dtype=F64)
    anchors = MotionAnchors(
        centres=random(count, 3), features=random(count, 5), instances=random(count, 3),
        quaternions=random(count, 4), log_scales=0.3 * random(count, 3), peaks=peaks,
        velocities=random(count, 3), log_spans=random(count) * 0.1,
        offsets=tuple(v.to(F64) for v in drawn_offsets(sizes, count, generator).values()),
    )  # fmt: skip
    return anchors, shared, sizes


@pytest.mark.parametrize("layers", [2, 3, 5])
def test_all_five_outputs_and_their_gradients_are_the_references(layers):
    anchors, shared, sizes = made(layers)
    centre = torch.tensor([0.3, -2.0, 0.5], dtype=F64)
    inputs = [v for v in shared.values()] + [
        anchors.features, anchors.instances, anchors.log_scales, anchors.peaks,
        anchors.velocities, anchors.log_spans, *anchors.offsets,
    ]  # fmt: skip
    for value in inputs:
        value.requires_grad_()
    found, want = (
        function(anchors, nets.hierarchy(shared, layers), sizes, 0.4, centre)
        for function in (decoded, decode)
    )
    pulls = torch.Generator().manual_seed(9)
    totals = []
    for splats in (found, want):
        assert splats.colours is not None
        parts = (splats.means, rotation.normalise(splats.quaternions), splats.scales,
                 splats.opacities, splats.colours)  # fmt: skip
        pulls.manual_seed(9)
        pulled = [(p * torch.randn(p.shape, generator=pulls)).sum() for p in parts]
        totals.append(torch.stack(pulled).sum())
    for name in ("means", "scales", "opacities", "colours"):
        torch.testing.assert_close(getattr(found, name), getattr(want, name))
    torch.testing.assert_close(
        rotation.normalise(found.quaternions), rotation.normalise(want.quaternions)
    )
    for one, other in zip(
        *(torch.autograd.grad(total, inputs, allow_unused=True) for total in totals), strict=True
    ):
        torch.testing.assert_close(one, other)


def test_each_at_its_own_time_is_all_at_that_time():
    anchors, shared, sizes = made(3)
    networks = nets.hierarchy(shared, 3)
    times = torch.tensor([0.1, 0.7], dtype=F64)[torch.arange(7) % 2]
    mixed = placed(anchors, networks, sizes, times)
    means = (mixed.at[:, None] + mixed.away).reshape(7, -1, 3)
    for parity, time in enumerate((0.1, 0.7)):
        alone = decode(anchors, networks, sizes, time, torch.zeros(3, dtype=F64))
        want = alone.means.reshape(7, -1, 3)
        torch.testing.assert_close(means[parity::2], want[parity::2])
