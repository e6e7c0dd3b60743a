"""What method dlg-gs minimises, term by term."""

from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.anchors.start import centres_of
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs.depth_error import appearance_weight, disparity_error
from splatproof.methods.dlg_gs.disparity import anchor_disparity, gaussian_disparity
from splatproof.methods.dlg_gs.model import LitSplats
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.methods.scaffold.fit import mean_volume
from splatproof.methods.training.schedules import log_linear
from splatproof.methods.training.terms import Frame, ImageTerm, Photometric, Term, photometric_loss
from splatproof.reference.anchors import lighting_appearance
from splatproof.reference.supervision import depth_constraint


def terms(settings: Settings, run: Run) -> tuple[ImageTerm, ...]:
    """What method dlg-gs minimises.

    Args:
        settings: Which parts are on, and their weights.
        run: Whose backend draws depths and what is left without dropped Gaussians.
    """
    made = colour_terms(settings)
    depth = Depth(
        run, kind=settings.depth, weighted=settings.weight_map, final=settings.depth_final
    )
    if settings.vdjc in ("ec", "both") and settings.ec:
        made.append(Term(name="gaussian depth", loss=depth.of_gaussians, weight=settings.ec))
    if settings.moves and settings.mc:
        made.append(Term(name="anchor depth", loss=depth.of_anchors, weight=settings.mc))
    if settings.volume:
        loss = mean_volume if settings.volume_rule == "mean" else summed_volume
        made.append(Term(name="volume", loss=loss, weight=settings.volume))
    if settings.dropout:
        dropout = Dropout(run, share=settings.dropout_share, dssim=settings.dssim)
        made.append(Term(name="dropout", loss=dropout.loss, weight=settings.dropout))
    return tuple(made)


def colour_terms(settings: Settings) -> list[ImageTerm]:
    """L1 of the adapted render, and the structure of the original one where there are two.

    Args:
        settings: dlaam and dssim count.

    Source: DLG-GS, Eq. 16.
    """
    if settings.dlaam == "off":
        return [Photometric(dssim=settings.dssim)]
    return [
        Term(name="adapted l1", loss=adapted_l1, weight=1 - settings.dssim),
        Term(name="original dssim", loss=original_dssim, weight=settings.dssim),
    ]


def adapted_l1(frame: Frame) -> Float[Tensor, ""]:
    """L1 of the render with adapted colours."""
    return photometric_loss(adapted_image(frame), frame.truth, dssim=0.0, mask=frame.mask)


def original_dssim(frame: Frame) -> Float[Tensor, ""]:
    """1 - SSIM of the render with original colours."""
    image = _finished(frame, renders(frame)[1])
    return photometric_loss(image, frame.truth, dssim=1.0, mask=frame.mask)


def adapted_image(frame: Frame) -> Float[Tensor, "h w 3"]:
    """The frame's image, made of the render that other terms look at."""
    return frame.once("adapted image", lambda: _finished(frame, renders(frame)[0]))


def renders(frame: Frame) -> list[Tensor]:
    """With adapted colours and with original ones; the former alone where there is one.

    Parts of one split: its backward pass joins their gradients, where that of each part by itself fills a whole
    picture with zeros, to be added up.
    """
    parts = lambda: [part.contiguous() for part in frame.output.colour.split(3, dim=-1)]
    return frame.once("renders", parts)


def _finished(frame: Frame, colour: Tensor) -> Tensor:
    shown = replace(frame.output, colour=colour)
    return frame.model.finish_image(frame.view.without_truth(), shown)


def summed_volume(frame: Frame) -> Float[Tensor, ""]:
    """Summed volume of the decoded Gaussians of a view."""
    return lighting_appearance.volume_loss(frame.splats.scales)


class Depth:
    """Rendered disparities against the views' depth priors.

    Source: DLG-GS, Sec. 2.2.
    """

    def __init__(
        self, run: Run, *, kind: depth_constraint.Depth, weighted: bool, final: float
    ) -> None:
        """Start without any prior in memory.

        Args:
            run: Its backend draws; priors are kept in as many bytes as images are.
            kind: How far a position is: its distance, or its z.
            weighted: Whether pixels whose two renders differ count less.
            final: Share of the error that counts at the last step, in (0, 1].
        """
        self.backend = get_backend(run.backend)
        self.priors = TensorCache(run.image_bytes)
        self.kind: depth_constraint.Depth = kind
        self.weighted = weighted
        self.share = log_linear(1.0, final)

    def of_gaussians(self, frame: Frame) -> Float[Tensor, ""]:
        """EC, by how far the Gaussians are: it moves and fades them, and leaves their shape alone.

        Args:
            frame: A rendered view that has a depth prior.
        """
        splats, rasterizer = frame.splats, self.backend.rasterize
        if self.backend.again and frame.output.colour.requires_grad:
            # as much of each Gaussian is seen as in the picture itself
            rasterizer = partial(self.backend.again, frame.output)
        disparity = gaussian_disparity(
            frame.view.camera, splats.means, splats.quaternions, splats.scales, splats.opacities,
            depth=self.kind, rasterizer=rasterizer,
        )  # fmt: skip
        return self._error(disparity, frame)

    def of_anchors(self, frame: Frame) -> Float[Tensor, ""]:
        """MC, by how far the anchors are, at a fixed opacity: it moves anchors only.

        Args:
            frame: A rendered view that has a depth prior.
        """
        splats = frame.splats
        assert splats.rows is not None
        disparity = anchor_disparity(
            frame.view.camera, centres_of(frame.model.parameters), splats.rows,
            splats.means, splats.quaternions, splats.scales,
            depth=self.kind, rasterizer=self.backend.rasterize,
        )  # fmt: skip
        return self._error(disparity, frame)

    def _error(self, disparity: Tensor, frame: Frame) -> Tensor:
        """Difference to the prior, where the mask lets it count."""
        device = disparity.device
        load = frame.view.load_prior
        assert load is not None
        name = frame.view.name
        valid = self.priors.get((name, "valid"), lambda: load().valid.to(device))
        if frame.mask is not None:
            valid = valid & frame.mask
        target = self.priors.get(
            (name, "target"),
            lambda: depth_constraint.normalise_disparity(load().disparity.to(device), valid),
        )
        weight = frame.once("appearance weight", lambda: self._weight(frame))
        moment = frame.moment
        share = self.share(moment.step, moment.total)
        return share * disparity_error(disparity, target, valid, weight)

    def _weight(self, frame: Frame) -> Tensor:
        """How much each pixel's depth counts."""
        drawn = renders(frame)
        if not self.weighted or len(drawn) == 1:
            return torch.ones_like(frame.output.alpha)
        return appearance_weight(*drawn)


class Dropout:
    """The render without randomly chosen Gaussians against the full one.

    Source: DLG-GS, Eqs. 18 and 19.
    """

    def __init__(self, run: Run, *, share: float, dssim: float) -> None:
        """Take what every view has in common.

        Args:
            run: Its backend draws, over its background.
            share: Chance of each Gaussian to be left out, in [0, 1).
            dssim: Weight of the structural part of the difference.
        """
        self.backend = get_backend(run.backend)
        self.background = torch.tensor(run.background)
        self.share, self.dssim = share, dssim

    def loss(self, frame: Frame) -> Float[Tensor, ""]:
        """The term of one view; nothing flows through the full render.

        Args:
            frame: The view, rendered; its moment's generator decides who is left out.
        """
        splats, generator = frame.splats, frame.moment.generator
        assert splats.colours is not None
        assert generator is not None
        shown = lighting_appearance.dropout_mask(len(splats), self.share, generator)
        lit = splats.adapted if isinstance(splats, LitSplats) else splats.colours
        left = replace(splats, colours=lit, opacities=splats.opacities * shown.to(splats.means))
        output = self.backend.draw(
            frame.view.camera, left, background=self.background.to(left.means),
            mode=frame.model.mode,
        )  # fmt: skip
        image = frame.model.finish_image(frame.view.without_truth(), output)
        full = adapted_image(frame).detach()
        return photometric_loss(image, full, dssim=self.dssim, mask=frame.mask)
