"""A trained model that decodes its splats for each view: anchors, moving Gaussians, networks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.method import Loader
from splatproof.methods.contracts.model import TRAINED, Model
from splatproof.methods.contracts.reconstruction import ARRAYS, DESCRIPTION, Stored
from splatproof.methods.models import exposure
from splatproof.methods.models.adapting import HasCode, fit_code
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.rasterizer.spherical_harmonics import C0
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View
from splatproof.reference.types.splats import Splats

FAINTEST, SMALLEST = 1e-6, 1e-9
"""Bounds of baked opacities (and of their distance to 1) and scales: their logarithms stay finite."""
Build = Callable[[Mapping[str, Any], Mapping[str, Tensor]], Model]
"""build(facts, tensors): the model of what was stored, its parameters restored by the caller."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedModel:
    """Any trained Model as a reconstruction: rendered by decoding, baked at a view."""

    kind: str
    """Name by which the loader of such models is found; its method has one."""
    model: Model
    shift: Float[Tensor, "3"] = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    """Vector in scene units, float64; added to positions it gives those in the original frame."""
    units: str = "sfm"
    """Name of the length unit."""
    backend: str = "cpu"
    """Name of the rasterizer; not stored."""

    @staticmethod
    def of(kind: str, model: Model, scene: Scene, backend: str) -> "DecodedModel":
        """What a fit returns; one that adapts (`AdaptingModel`) where the model has a code.

        Args:
            kind: Name of the kind of model.
            model: The model after its last step.
            scene: What it was trained on; its shift and units count.
            backend: Name of the rasterizer.
        """
        return _reconstruction(
            kind=kind, model=model, shift=scene.shift, units=scene.units, backend=backend
        )

    @property
    def mode(self) -> Mode:
        """How it is rasterized, see splatproof.reference.rasterizer."""
        return self.model.mode

    @property
    def primitives(self) -> int:
        """Number of rows that are stored."""
        return self.model.primitives

    @torch.no_grad()
    def render(self, view: View, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image of a view: decoded for its camera, time, sensor and appearance, not clamped.

        Args:
            view: What is looked at; its image is not.
            background: Colour behind everything; None is black.
        """
        self.model.parameters.to(self.device)
        return self._drawn(view.without_truth(), background).to("cpu")

    @property
    def device(self) -> torch.device:
        """Where it is drawn."""
        return torch.device(get_backend(self.backend).device)

    def _drawn(self, view: View, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image of a view, with gradients, where its parameters are."""
        output = self._rasterized(view, background)
        return replace(output, colour=self.model.finish_image(view, output))

    def _rasterized(self, view: View, background: Float[Tensor, "3"] | None) -> RenderOutput:
        return get_backend(self.backend).draw(
            view.camera, self.model.splats(view, TRAINED), mode=self.mode,
            background=None if background is None else background.to(self.device),
        )  # fmt: skip

    @torch.no_grad()
    def bake(self, view: View | None = None) -> Gaussians:
        """Explicit Gaussians that look like the model does from one view, at its time, but for `unbaked`.

        Args:
            view: Camera, time and appearance that the model is decoded for.

        Raises: UsageError without a view, or for splats of other than 3 channels.
        """
        if view is None:
            raise UsageError(
                f"a model of kind {self.kind!r} looks different from every view; name the one to "
                "bake it at"
            )
        return gaussians_of(self.model.splats(view.without_truth(), TRAINED))

    @property
    def unbaked(self) -> tuple[str, ...]:
        """What the model adds to a rasterized image, which baked Gaussians lack: a sky, exposures."""
        return self.model.unbaked

    def store(self, folder: Path) -> Stored:
        """What `save_model` writes: all parameters, and what a loader needs beside them.

        Args:
            folder: Not used: there are no files beside the arrays.
        """
        del folder
        facts = {
            "mode": self.mode, "shift": self.shift.tolist(), "units": self.units,
            "primitives": self.primitives, "model": self.model.facts(),
        }  # fmt: skip
        return Stored(tensors=self.model.parameters.state(), facts=facts)


class AdaptingModel(DecodedModel):
    """A decoded model whose Model has an appearance code (`HasCode`), which can be fitted."""

    def fit_appearance(
        self,
        view: View,
        image: Float[Tensor, "h w 3"],
        columns: slice,
        mask: Bool[Tensor, "h w"] | None = None,
    ) -> Float[Tensor, " c"]:
        """Code that shows a view over black in the light of an image, see `fit_code`.

        Args:
            view: Camera, time and sensor of the image.
            image: The columns that may be looked at, in [0, 1].
            columns: Which columns of the whole image they are.
            mask: Which of their pixels may be looked at; None: all.
        """
        model, asked = self.model, view.without_truth()
        assert isinstance(model, HasCode)
        model.parameters.to(self.device)  # moved tensors are new ones: none asks for a gradient
        start = model.neutral_code(asked)
        once = self._rasterized(asked, None) if model.code_finishes else None

        def show(code: Tensor) -> Tensor:
            coded = replace(asked, appearance=code)
            output = self._rasterized(coded, None) if once is None else once
            return model.finish_image(coded, output)

        return fit_code(show, start, image, columns, mask).cpu()


def _reconstruction(*, model: Model, **about: Any) -> DecodedModel:
    made = AdaptingModel if isinstance(model, HasCode) else DecodedModel
    return made(model=model, **about)


def gaussians_of(splats: Splats) -> Gaussians:
    """Splats as explicit Gaussians; colours become the constant band of harmonics.

    Args:
        splats: With harmonics, or colours of 3 channels.

    Raises: UsageError for colours of other than 3 channels.
    """
    sh = splats.sh
    if splats.colours is not None:
        if splats.colours.shape[1] != 3:
            raise UsageError(f"colours have {splats.colours.shape[1]} channels, expected 3 to bake")
        constant = ((splats.colours - 0.5) / C0)[:, None]
        if sh is not None:
            constant = torch.nn.functional.pad(constant, (0, 0, 0, sh.shape[1] - 1))
        sh = constant if sh is None else torch.cat([sh, constant])
    assert sh is not None
    return Gaussians(
        means=splats.means.cpu(),
        quaternions=splats.quaternions.cpu(),
        log_scales=splats.scales.clamp(min=SMALLEST).log().cpu(),
        opacity_logits=torch.logit(splats.opacities, eps=FAINTEST).cpu(),
        sh=sh.cpu(),
    )


def loader(kind: str, build: Build) -> Loader:
    """How a method loads the models that it left as DecodedModel.

    Args:
        kind: Name of the kind of model.
        build: Makes the model again from `Model.facts()` and the stored tensors, whose names are
            those of `Parameters.state()`.
    """

    def load(folder: Path, stored: Stored, backend: str) -> DecodedModel:
        try:
            model = exposure.restored(build, stored.facts["model"], stored.tensors)
            model.parameters.restore(stored.tensors)
            shift = torch.tensor(stored.facts["shift"], dtype=torch.float64)
            units = str(stored.facts["units"])
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise DataError(f"{folder / DESCRIPTION}: damaged ({error!r})") from None
        for name, value in stored.tensors.items():
            if value.is_floating_point() and not bool(value.isfinite().all()):
                raise DataError(f"{folder / ARRAYS}: {name} is not finite")
        return _reconstruction(kind=kind, model=model, shift=shift, units=units, backend=backend)

    return load
