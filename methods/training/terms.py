"""What training minimises: named, weighted terms of an image, and of the parameters themselves."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.kernels.loss import photometric
from splatproof.methods.training.regularisers import opacity_pull, scale_pull, volume_pull
from splatproof.reference.supervision import losses
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

Shared = TypeVar("Shared")


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One view of one step, rendered: what image terms are functions of."""

    view: View
    moment: Moment
    splats: Splats
    output: RenderOutput
    image: Float[Tensor, "h w 3"]
    """What is compared with the photo: the output's colours after the model's `finish_image`."""
    truth: Float[Tensor, "h w 3"]
    """The photo, in [0, 1]."""
    mask: Bool[Tensor, "h w"] | None
    """Pixels that count; None: all."""
    model: Model
    made: dict[str, Any] = field(default_factory=dict)
    """What terms share, by name."""

    def once(self, name: str, make: Callable[[], Shared]) -> Shared:
        """What several terms of this frame look at, made by the first that asks.

        Args:
            name: What it is.
            make: Makes it.
        """
        if name not in self.made:
            self.made[name] = make()
        return self.made[name]


@dataclass(frozen=True, kw_only=True, eq=False)
class Term:
    """A weighted part of the loss that a rendered view has; curves show it by its name."""

    name: str
    """Name of the term: lower case, unique among the terms of a method."""
    loss: Callable[[Frame], Float[Tensor, ""]]
    """loss(frame): the term of one view before it is weighted, differentiable."""
    weight: float = 1.0
    """Factor on the term."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Photometric:
    """(1 - l) L1 + l (1 - SSIM) of image and photo: the term that the kernels' own step knows.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Eq. 7.
    """

    dssim: float = 0.2
    """Weight l of 1 - SSIM, 0 to 1."""
    name: str = "photometric"
    weight: float = 1.0

    def loss(self, frame: Frame) -> Float[Tensor, ""]:
        """The term of one view.

        Args:
            frame: The view, rendered.
        """
        return photometric_loss(frame.image, frame.truth, dssim=self.dssim, mask=frame.mask)


def photometric_loss(
    image: Float[Tensor, "h w 3"],
    truth: Float[Tensor, "h w 3"],
    *,
    dssim: float = 0.2,
    mask: Bool[Tensor, "h w"] | None = None,
) -> Float[Tensor, ""]:
    """(1 - l) L1 + l (1 - SSIM) of two images, by the kernels in float32 on the CPU, by torch elsewhere.

    Args:
        image: Render; it alone gets a gradient.
        truth: Photo in [0, 1].
        dssim: Weight l in [0, 1].
        mask: Pixels that count; None: all.
    """
    native = image.device.type == "cpu" and image.dtype == torch.float32
    loss = photometric if native else losses.photometric
    return loss(image, truth, dssim=dssim, mask=mask)


ImageTerm = Term | Photometric


@dataclass(frozen=True, kw_only=True, eq=False)
class ParameterTerm:
    """A part of the loss that depends on the parameters alone, with its gradient written by hand."""

    name: str
    add: Callable[[Parameters], float]
    """Adds the term's gradient to the parameters' .grad where they have one; returns its value."""


def mean_opacity(weight: float) -> ParameterTerm:
    """The term weight * mean(opacity): what no photo needs fades away.

    Args:
        weight: Factor, >= 0 (3DGS-MCMC: 0.01).

    Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Eq. 12.
    """

    def add(parameters: Parameters) -> float:
        logits = parameters.rows["opacity_logits"]
        if logits.grad is not None:
            logits.grad += opacity_pull(logits.detach(), weight)
        return weight * float(torch.sigmoid(logits.detach()).mean())

    return ParameterTerm(name="mean opacity", add=add)


def mean_scale(weight: float, extent: float) -> ParameterTerm:
    """The term weight * mean(scale) / extent: what no photo needs shrinks.

    Args:
        weight: Factor, >= 0 (3DGS-MCMC: 0.01 on scene units, which made giants of an aerial block).
        extent: Size of the scene in scene units, so that another unit changes nothing (ours).

    Source: Kheradmand et al. 2024, "3D Gaussian Splatting as Markov Chain Monte Carlo", Eq. 12.
    """

    def add(parameters: Parameters) -> float:
        log_scales = parameters.rows["log_scales"]
        if log_scales.grad is not None:
            log_scales.grad += scale_pull(log_scales.detach(), weight / extent)
        return weight / extent * float(log_scales.detach().exp().mean())

    return ParameterTerm(name="mean scale", add=add)


def mean_volume(weight: float, extent: float) -> ParameterTerm:
    """The term weight * mean(product of the scales) / extent^3: giants shrink.

    Args:
        weight: Factor, >= 0.
        extent: Size of the scene in scene units, so that another unit changes nothing (ours).

    Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.3, for Gaussians that are trained themselves.
    """
    weight = weight / extent**3

    def add(parameters: Parameters) -> float:
        log_scales = parameters.rows["log_scales"]
        if log_scales.grad is not None:
            log_scales.grad += volume_pull(log_scales.detach(), weight)
        return weight * float(log_scales.detach().sum(dim=1).exp().mean())

    return ParameterTerm(name="mean volume", add=add)
