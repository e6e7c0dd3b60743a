"""What a method hands to the trainer: a model that decodes a view into splats, with gradients."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.parameters import Parameters
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

Schedule = Callable[[int, int], float]
"""schedule(step, total): the rate of a tensor at a step, 1 at the first update, of so many."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """When a view is decoded: a step of training, or afterwards."""

    step: int
    """Number of the step, from 1 while training."""
    total: int
    """Steps of the whole run."""
    generator: torch.Generator | None = None
    """Source of every random draw while training; None: the model is trained, nothing is drawn."""

    @property
    def trains(self) -> bool:
        """Whether this is a step of training."""
        return self.generator is not None


TRAINED = Moment(step=1, total=1)
"""After training: everything on, nothing drawn at random."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NativeTensors:
    """Raw tensors that the kernels' training step reads instead of decoded splats."""

    tensors: Mapping[str, Tensor]
    """Tensors means, quaternions, log_scales, opacity_logits, sh_dc, sh_rest: float32, on the CPU."""
    degree: int
    """Highest degree of the spherical harmonics that is drawn."""
    leave: Callable[[Mapping[str, Tensor]], None]
    """Called with the loss's gradient by each tensor: leaves it in the parameters' .grad."""


class Model(ABC):
    """A model that can be trained: parameters, how a view is decoded from them, how fast they move."""

    mode: Mode = "classic"
    """How its splats are rasterized, in training and afterwards."""
    code_finishes: bool = False
    """Whether an appearance code, if it has one, is read by `finish_image` alone: then a fit of a
    code rasterizes once."""

    def __init__(self, parameters: Parameters, schedules: Mapping[str, Schedule]) -> None:
        """Take the parameters and each one's rate.

        Args:
            parameters: All tensors, in groups.
            schedules: Rate of each trained tensor at each step; what has none is frozen.

        Raises: ValueError for a schedule of a tensor that is not there.
        """
        unknown = sorted(schedules.keys() - parameters.trained.keys())
        if unknown:
            raise ValueError(f"schedules of tensors that are not trained: {', '.join(unknown)}")
        self.parameters = parameters
        self.schedules = dict(schedules)

    @abstractmethod
    def splats(self, view: View, moment: Moment) -> Splats:
        """What a view shows, differentiable by the parameters.

        Args:
            view: Camera, time, sensor and appearance; never its image.
            moment: Step of training, or TRAINED.
        """

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w c"]:
        """The final image of what was rasterized: exposure, sky. By default the colours as they are.

        Args:
            view: What was rendered.
            output: Colours over the background, alpha, depth.
        """
        del view
        return output.colour

    def native(self, view: View, moment: Moment) -> NativeTensors | None:
        """The tensors for the kernels' own training step; None where it must go through autograd.

        Args:
            view: What is rendered.
            moment: Step of training.
        """
        del view, moment
        return None

    @property
    def primitives(self) -> int:
        """Number of rows: Gaussians, or anchors."""
        return len(self.parameters)

    def facts(self) -> dict[str, Any]:
        """What a loader needs beside the tensors to make this model again, JSON-ready."""
        return {}

    @property
    def finishes(self) -> bool:
        """Whether `finish_image` does anything."""
        return type(self).finish_image is not Model.finish_image

    @property
    def unbaked(self) -> tuple[str, ...]:
        """What `finish_image` adds that explicit Gaussians do not show, in words a person is told."""
        return ("what it adds to a rasterized image",) if self.finishes else ()
