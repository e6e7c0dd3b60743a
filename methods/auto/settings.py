"""What can be asked of method auto, and what of its plan can be fixed by hand."""

import math
from dataclasses import dataclass

from splatproof.methods.models.exposure import Exposure
from splatproof.methods.training.density import Pace
from splatproof.methods.training.schedules import require, require_cell

LACKING = {
    "coarsest": 1.0,
    "opacity_weight": 0.0,
    "dropout": 0.0,
    "rates": 1.0,
    "split_gradient": 0.0,
    "completed": False,
}
"""Settings that Gaussians that move do not have, and the values that stand for going without."""


@dataclass(frozen=True, kw_only=True)
class AutoSettings:
    """A budget. Everything else is planned, unless a setting below says what it is to be."""

    seconds: float = 60.0
    """Wall seconds that measuring, probing and training may take together on this machine, > 0."""
    megabytes: float = 0.0
    """Most megabytes (2^20 bytes) of the saved model; 0: no bound."""
    db: float = 0.0
    """PSNR in dB at which training ends before its seconds are over, on every sixth training photo, 12 at most,
    which are kept back for that. 0: none is kept back, and the seconds are used."""
    probe_share: float = 0.15
    """Share of the seconds, 0 to 0.5, that short trainings may take in which settings compete on
    training views that they do not see. 0: none; what they would decide stays as it is by default."""
    steps: int | None = None
    """Number of training steps. None: as many as the seconds hold, by the speed measured before."""
    coarsest: float | None = None
    """Factor by which photos are shrunk at first; 1: not at all. None: planned."""
    dense_cell: float | None = None
    """About how many pixels points lie apart that are matched between photos before training; 0: none
    are. None: planned."""
    most_points: int | None = None
    """Most points that training starts from; where there are more, those of one voxel become one. None:
    planned."""
    sh_degree: int | None = None
    """Degree of the spherical harmonics, 0 to 3. None: planned."""
    opacity_weight: float | None = None
    """Weight of the mean opacity in the loss. None: planned."""
    dropout: float | None = None
    """Share of Gaussians that a step hides at random, growing to this. None: planned."""
    rates: float | None = None
    """Factor on the release's learning rates of everything but positions and opacities; where it is not 1, they fall
    to a tenth of that in the second half of a training. None: planned."""
    widest: float | None = None
    """Largest scale of a Gaussian as a share of its distance to the nearest training camera; 0: no bound.
    None: planned."""
    widest_at_points: float | None = None
    """The same on points that training starts from; further away a Gaussian may be as wide as it is far from the nearest
    of them. 0: as elsewhere. None: planned."""
    thickest: float | None = None
    """Largest extent of a Gaussian along the ray to the nearest training camera, as a share of its distance to it; 0:
    no bound. None: planned."""
    gradient: float | None = None
    """Pull from which a Gaussian is cloned or split; smaller values give more Gaussians; inf: nothing
    is densified. None: planned."""
    split_gradient: float | None = None
    """Sum of absolute gradients from which a large Gaussian is split; 0: `gradient` decides on large ones as on small ones.
    None: planned."""
    pace: Pace | None = None
    """How fast the number of Gaussians may come to its cap: free: at once; even: by equal shares of the room that
    is left. None: planned."""
    motion: bool | None = None
    """Whether Gaussians move, as method pvg's do, by the scene's times and LiDAR sweeps. None: planned."""
    completed: bool | None = None
    """Whether the depth of each photo is completed before training, and virtual Gaussians fill what photos do
    not show, as in method stratosplat. None: planned."""
    exposure: Exposure | None = None
    """What is learnt of each photo beside the scene. None: planned."""

    def __post_init__(self) -> None:
        """Refuse what no plan can keep."""
        require(0 < self.seconds < math.inf, "seconds", self.seconds, "> 0")
        require(0 <= self.megabytes < math.inf, "megabytes", self.megabytes, ">= 0")
        require(0 <= self.db < 100, "db", self.db, "0 to 100, 0: no such end")
        require(0 <= self.probe_share <= 0.5, "probe_share", self.probe_share, "0 to 0.5")
        for name, low, high in (
            ("steps", 1, math.inf), ("coarsest", 1, math.inf), ("most_points", 1, math.inf), ("sh_degree", 0, 3),
            ("opacity_weight", 0, math.inf), ("dropout", 0, 1), ("rates", 0, math.inf), ("widest", 0, math.inf), ("widest_at_points", 0, math.inf),
            ("thickest", 0, math.inf), ("gradient", 0, math.inf), ("split_gradient", 0, math.inf),
        ):  # fmt: skip
            value = getattr(self, name)
            fine = value is None or low <= value <= high
            require(fine, name, value, f"{low} to {high}, or None: planned")
        for name, what in (("completed", "virtual Gaussians"), ("motion", "Gaussians that move")):
            value = getattr(self, name)
            expected = (
                f"False, or None, where megabytes bounds the saved model: {what} have no such bound"
            )
            require(not (value and self.megabytes), name, value, expected)
        for name, without in LACKING.items() if self.motion else ():
            value = getattr(self, name)
            expected = f"{without:g}, or None, where motion is True: what moves does not have it"
            require(value in (None, without), name, value, expected)
        if self.dense_cell is not None:
            require_cell(self.dense_cell)

    def against_motion(self) -> dict[str, float]:
        """What is fixed here and Gaussians that move cannot follow, by the setting's name."""
        given = {name: getattr(self, name) for name in LACKING}
        return {name: value for name, value in given.items() if value not in (None, LACKING[name])}
