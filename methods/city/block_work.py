"""What the training of a block will work on, by what it starts from and which views train it."""

from dataclasses import dataclass, replace
from statistics import fmean

from jaxtyping import Bool, Float64
from torch import Tensor

from splatproof.methods.training.initialise import neighbour_distance
from splatproof.reference.partition.block_time import BlockWork, StepCost, pairs_a_view
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene

STEP_COST = StepCost(pixel=1.4e-7, gaussian=1.0e-7, pair=2.7e-7)
"""Measured of the native kernels; `bench study balance` fits it to a machine's own times. Only the ratios of its numbers
change a cut, which therefore is the same on every machine."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """What all blocks start from, as far as their times depend on it."""

    means: Float64[Tensor, "n 3"]
    """Middles of the Gaussians in scene units: those of a coarse model, or the sparse points."""
    sizes: Float64[Tensor, " n"]
    """Largest standard deviation of each, in scene units."""
    coarse: bool
    """Whether it is a coarse model; else there is one a sparse point."""
    each: int = 1
    """How many Gaussians each of these stands for, of its own size."""

    def sampled(self, most: int) -> "Start":
        """Every so manieth, each for those that are left out, so that there are at most `most`.

        Args:
            most: At least 1.
        """
        every = -(-len(self.means) // most) if len(self.means) else 1
        return replace(
            self, means=self.means[::every], sizes=self.sizes[::every], each=self.each * every
        )


def start_of(scene: Scene, coarse: Gaussians | None) -> Start:
    """A coarse model, or a Gaussian a sparse point as wide as points lie apart.

    Args:
        scene: The whole scene.
        coarse: The coarse model; None: there is none.
    """
    if coarse is not None:
        sizes = coarse.log_scales.double().amax(dim=1).exp()
        return Start(means=coarse.means.double(), sizes=sizes, coarse=True)
    positions = scene.points.positions.double()
    return Start(means=positions, sizes=neighbour_distance(positions, 1.0), coarse=False)


def block_work(
    scene: Scene,
    views: Bool[Tensor, " v"],
    start: Start,
    held: Bool[Tensor, " n"],
    *,
    steps: int,
    thickness: float = 1.0,
) -> BlockWork:
    """What a block's training works on; no steps without views.

    Args:
        scene: The whole scene.
        views: Which of its views train the block.
        start: What all blocks start from.
        held: Which of that the block holds, whatever its role.
        steps: Training steps of the block.
        thickness: Gaussians in place of each, >= 1, smaller in proportion to its area.

    Source: ours.
    """
    cameras = [scene.views[i].camera for i in views.nonzero()[:, 0].tolist()]
    sizes = start.sizes[held] / thickness**0.5
    return BlockWork(
        steps=float(steps if cameras else 0),
        pixels=fmean(one.width * one.height for one in cameras) if cameras else 0.0,
        gaussians=start.each * thickness * float(held.sum()),
        pairs=start.each * thickness * pairs_a_view(cameras, start.means[held], sizes),
    )
