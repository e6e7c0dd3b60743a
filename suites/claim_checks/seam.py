"""Whether the seam metrics see a seam that was planted, and only where it was planted."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.metrics.seam_partition import partition_seam_mask
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.types.render import RenderOutput
from splatproof.suites.claim_checks.check import Check, Measurement
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene
from splatproof.suites.twins.random_scenes import speed_scene

COUNTS, QUICK_COUNTS = (4_000, 5_000, 6_000, 7_000, 8_000), (2_000,)
"""Numbers of Gaussians: each gives a scene of its own."""
WIDTH, HEIGHT = 160, 120
SHARE = 0.03
"""Share of the Gaussians that a planted gap takes."""


def gaps(at_wall: bool, reduced: bool) -> Measurement:
    """Mean squared error over the seam mask, over that of the whole image, when Gaussians are lost.

    Two blocks meet at the median of the Gaussians' positions on one axis. Lost are those nearest to
    that wall, or as many in the middle of one block.

    Args:
        at_wall: Where the gap is planted.
        reduced: One scene instead of five.
    """
    counts = QUICK_COUNTS if reduced else COUNTS
    where = "at the wall" if at_wall else "inside a block"
    return Measurement(
        values=tuple(_share(count, at_wall) for count in counts),
        compared=f"{100 * SHARE:g} % of {', '.join(f'{n:,}' for n in counts)} Gaussians lost {where}",
    )


def _share(count: int, at_wall: bool) -> float:
    scene, _ = speed_scene(count, WIDTH, HEIGHT)
    x = scene.means[:, 0].double()
    wall = x.median()
    centre = wall if at_wall else x.quantile(0.8)
    near = (x - centre).abs()
    kept = near > near.quantile(SHARE)
    truth, broken = _render(scene), _render(_select(scene, kept))
    mask = partition_seam_mask(scene.camera, truth.depth, _blocks(scene.means.double(), wall))
    images = broken.colour.clamp(0, 1), truth.colour.clamp(0, 1)
    error = (images[0] - images[1]).square()
    return float(error[mask].mean() / error.mean())


def _render(scene: GaussianScene) -> RenderOutput:
    return rasterize(
        scene.camera, scene.means, scene.quaternions, scene.scales, scene.opacities, sh=scene.sh
    )


def _select(scene: GaussianScene, kept: Tensor) -> GaussianScene:
    names = ("means", "quaternions", "scales", "opacities", "sh")
    return replace(scene, **{name: getattr(scene, name)[kept] for name in names})


def _blocks(means: Tensor, wall: Tensor) -> list[OrientedBox]:
    """The boxes on both sides of the wall."""
    low, high = means.amin(dim=0), means.amax(dim=0)
    ends = ((low, torch.cat([wall[None], high[1:]])), (torch.cat([wall[None], low[1:]]), high))
    return [
        OrientedBox(centre=(a + b) / 2, rotation=torch.eye(3, dtype=a.dtype), half=(b - a) / 2)
        for a, b in ends
    ]


def _at_wall(reduced: bool, folder: Path) -> Measurement:
    del folder
    return gaps(True, reduced)


def _inside(reduced: bool, folder: Path) -> Measurement:
    del folder
    return gaps(False, reduced)


SEAM = {
    "seam_at_wall": Check(measure=_at_wall, unit="times", seconds=(2.0, 1.0)),
    "seam_inside": Check(measure=_inside, unit="times", seconds=(2.0, 1.0)),
}
