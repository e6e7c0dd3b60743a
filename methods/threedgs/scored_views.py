"""Training views that are rendered to see where a model is wrong, and which Gaussians show there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.methods.contracts.backends import Backend
from splatproof.methods.training.resolution import Resolution, shrunk
from splatproof.methods.training.terms import photometric_loss
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoredView:
    """One training view beside its render."""

    camera: Camera
    """Camera of the photo, as large as training sees it at this step."""
    factor: float
    """Factor, >= 1, by which the photo is shrunk."""
    image: Float[Tensor, "h w 3"]
    truth: Float[Tensor, "h w 3"]
    valid: Bool[Tensor, "h w"] | None
    """Pixels that count; None: all."""
    depth: Float[Tensor, "h w"]
    """Median depth, or the expected one where the backend has no other; 0 where nothing is drawn."""
    loss: float
    """Photometric loss of the view."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewScorer:
    """What views are rendered by: photos as large as the step's."""

    views: Sequence[View]
    """Training views."""
    count: int
    """How many are drawn; of fewer all."""
    backend: Backend
    mode: Mode
    background: tuple[float, float, float]
    resolution: Resolution
    total: int
    """Steps of the run."""
    dssim: float

    def drawn(self, step: int, splats: Splats, generator: torch.Generator) -> list[ScoredView]:
        """Some views, drawn without replacement, rendered.

        Args:
            step: Number of the step, from 1: photos have its size.
            splats: The model.
            generator: Source of the draw.
        """
        factor = self.resolution.factor(step, self.total)
        return [self.scored(view, factor, splats) for view in self.chosen(generator)]

    def chosen(self, generator: torch.Generator) -> list[View]:
        """Some views, drawn without replacement.

        Args:
            generator: Source of the draw.
        """
        indices = torch.randperm(len(self.views), generator=generator)[: self.count]
        return [self.views[index] for index in indices.tolist()]

    @torch.no_grad()
    def scored(self, view: View, factor: float, splats: Splats) -> ScoredView:
        """One view, rendered.

        Args:
            view: A training view.
            factor: Factor, >= 1, by which its photo is shrunk.
            splats: The model.
        """
        view = view if factor == 1 else shrunk(view, factor)
        device = splats.means.device
        output = self.backend.draw(
            view.camera, splats, background=torch.tensor(self.background, device=device),
            mode=self.mode, median="median" in self.backend.capabilities,
        )  # fmt: skip
        truth = view.load().to(device)
        valid = None if view.load_mask is None else view.load_mask().to(device)
        loss = photometric_loss(output.colour, truth, dssim=self.dssim, mask=valid)
        depth = output.depth if output.median_depth is None else output.median_depth
        return ScoredView(
            camera=view.camera, factor=factor, image=output.colour, truth=truth, valid=valid,
            depth=depth, loss=float(loss),
        )  # fmt: skip

    def evidence(
        self, camera: Camera, splats: Splats, marks: Bool[Tensor, "h w"]
    ) -> Float[Tensor, " n"]:
        """Twin of reference.density.multi_view_error.evidence: a backward pass, weights never listed.

        The image of splats of colour 1 is the sum of weights, so that its gradient by their colours is each
        one's.

        Args:
            camera: Camera of the marked image.
            splats: The model.
            marks: Which pixels are marked.
        """
        ones = torch.ones_like(splats.opacities)[:, None].requires_grad_()
        white = replace(splats, sh=None, colours=ones)
        with torch.enable_grad():
            summed = self.backend.draw(camera, white, mode=self.mode).colour[:, :, 0]
            (found,) = torch.autograd.grad(summed, ones, marks.to(summed))
        return found[:, 0]

    def tallied(self, step: int, view: View, splats: Splats) -> Float[Tensor, "n 3"]:
        """What the fragments of one view say of each Gaussian's opacity, see reference.density.opacity_spread.

        Args:
            step: Number of the step, from 1: the photo has its size.
            view: A training view.
            splats: The model.
        """
        assert self.backend.tally is not None
        factor = self.resolution.factor(step, self.total)
        view = view if factor == 1 else shrunk(view, factor)
        device = splats.means.device
        truth = view.load().to(device)
        valid = None if view.load_mask is None else view.load_mask().to(device)
        moving = replace(splats, opacities=splats.opacities.clone().requires_grad_())
        background = torch.tensor(self.background, device=device)
        with torch.enable_grad():
            drawn = self.backend.draw(view.camera, moving, background=background, mode=self.mode)
            loss = photometric_loss(drawn.colour, truth, dssim=self.dssim, mask=valid)
            (by_colour,) = torch.autograd.grad(loss, drawn.colour)
            return self.backend.tally(drawn, by_colour)
