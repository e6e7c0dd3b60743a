"""Density control as the releases for few views have it: what FSGS and CoR-GS share."""

from dataclasses import dataclass

from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.training.density import Density, reset_opacity
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.schedules import require, shrink


@dataclass(frozen=True, kw_only=True)
class SparseDensity(Density):
    """Density control with the values of FSGS's release, whose 10,000 steps are 30,000 here."""

    start: int = 1500
    """Last step without densification: Gaussians are cloned, split and removed after it."""
    stop: int = 30_000
    """Step from which on nothing is densified and no opacity is reset."""
    interval: int = 300
    """Steps between densifications; a short run shrinks it to no less than `least_interval`, unless
    `fewest` asks for more densifications."""
    gradient: float = 5e-4
    """Pull from which a Gaussian is cloned or split: mean norm of the loss's gradient by its
    position in the image, in units of half the image."""
    largest_size: float = 1e6
    """Largest scale, as a share of the scene's extent, that survives a densification after the
    first opacity reset; here none is ever removed for its size."""
    reset_interval: int = 9000
    """Steps between opacity resets; 0: never."""
    first_reset: int = 6003
    """Step of the first opacity reset."""
    reset_opacity: float = 0.05
    """Opacity, in (0, 1), that a reset leaves no Gaussian above."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        super().__post_init__()
        require(self.first_reset >= 1, "density.first_reset", self.first_reset, ">= 1")
        to = self.reset_opacity
        require(0 < to < 1, "density.reset_opacity", to, "between 0 and 1")


class SparseControl(DensityControl):
    """DensityControl whose resets begin at a step of their own and leave more opacity."""

    def __init__(self, settings: SparseDensity, *, iterations: int, extent: float) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            extent: Size of the scene in scene units.
        """
        super().__init__(settings, iterations=iterations, extent=extent)
        self.first_reset = max(1, round(settings.first_reset * shrink(iterations)))
        self.reset_to = settings.reset_opacity

    def resets(self, step: int) -> bool:
        """Whether a step ends with an opacity reset.

        Args:
            step: Number of the step, from 1.
        """
        every, since = self.settings.reset_interval, step - self.first_reset
        return every > 0 and 0 <= since and step < self.settings.stop and since % every == 0

    def reset(self, parameters: Parameters) -> Edit:
        """Make everything at most as opaque as the settings say.

        Args:
            parameters: The model's tensors, with opacity_logits.
        """
        logits = reset_opacity(parameters.rows["opacity_logits"].detach(), self.reset_to)
        return Edit(values={"opacity_logits": logits}, forget=frozenset({"opacity_logits"}))
