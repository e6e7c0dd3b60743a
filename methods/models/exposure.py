"""Each training photo's exposure and white balance, or colour map, learnt beside any model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.contracts.reconstruction import ARRAYS, DESCRIPTION, Stored
from splatproof.methods.models.adapting import HasCode, chosen_code, fit_code
from splatproof.methods.models.explicit import ExplicitModel, load_explicit
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.training.schedules import log_linear
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View
from splatproof.reference.types.splats import Splats

Kind = Literal["gain", "affine"]
Exposure = Literal["off", "gain", "affine"]
"""The setting of every method: no exposures, three gains a photo, or a 3x4 map of colours a photo."""
NUMBERS = {"gain": 3, "affine": 12}
"""How many numbers a photo has."""
RATE, LAST_RATE = 3e-3, 3e-4
"""Adam's rates at the first and last step. The 3DGS release has 0.01 and 0.001 in 30,000 steps; in short
runs these follow what opacity resets do to single images (gains, tunnel, 1000 steps: 27.8 dB, with these
28.8, without gains 28.1; one seed)."""
TENSOR = "photo_exposures"
"""Name of the trained numbers among a model's shared tensors."""
EXPOSED = "explicit with exposures"
"""Kind of models of Gaussians and exposures."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposures:
    """What photos did to colours: gains exp(c) each, or the map x -> x + A x + b with c = (A | b).

    Codes c are the trained numbers less their mean over all photos: on average photos do nothing,
    exactly, so that the scene's brightness and colours stay those of the model.

    Source: ours; the maps as in the 3DGS release of 2024, which leaves their mean free.
    """

    kind: Kind
    photos: tuple[str, ...]
    """Names of the training photos."""
    raw: Float[Tensor, "n c"]
    """The trained numbers of each photo."""

    def codes(self) -> Float[Tensor, "n c"]:
        """Code of each photo; their mean is zero."""
        return self.raw - self.raw.mean(dim=0)

    def neutral(self) -> Float[Tensor, " c"]:
        """The code that changes nothing."""
        return self.raw.new_zeros(self.raw.shape[1])

    def shown(self, view: View, colour: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """Colours as the photo has them whose exposure a view is shown with (`chosen_code`).

        Args:
            view: What is shown.
            colour: Its colours in neutral exposure.
        """
        return adjusted(colour, self._code(view))

    def undone(self, view: View, photo: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """Colours in neutral exposure of a photo: what `shown` makes the photo of.

        Args:
            view: The training view whose photo it is.
            photo: Its colours.
        """
        code = self._code(view).to(photo)
        if len(code) == NUMBERS["gain"]:
            return photo / code.exp()
        rows = code.reshape(3, 4)
        return torch.linalg.solve(
            torch.eye(3).to(photo) + rows[:, :3].T, photo - rows[:, 3], left=False
        )

    def _code(self, view: View) -> Float[Tensor, " c"]:
        return chosen_code(view, self.photos, self.codes(), self.neutral())


def adjusted(colour: Float[Tensor, "h w 3"], code: Float[Tensor, " c"]) -> Float[Tensor, "h w 3"]:
    """Colours times exp(code), or mapped by identity plus code, see `Exposures`.

    Args:
        colour: sRGB; not clamped.
        code: 3 numbers, or 12: rows (A | b) of the map one after the other.
    """
    if len(code) == NUMBERS["gain"]:
        return colour * code.exp()
    rows = code.reshape(3, 4)
    return colour + colour @ rows[:, :3].T + rows[:, 3]


class ExposedModel(Model):
    """Any model whose images are finished by the exposure of the photo that is asked for.

    A code that the model has itself comes before that of the exposure.
    """

    def __init__(self, base: Model, kind: Kind, photos: Sequence[str]) -> None:
        """Start with neutral exposures.

        Args:
            base: The model; its parameters get one more tensor, shared by all rows.
            kind: What is learnt of each photo.
            photos: Names of the training photos.
        """
        base.parameters.shared[TENSOR] = torch.zeros(len(photos), NUMBERS[kind])
        super().__init__(base.parameters, base.schedules | {TENSOR: log_linear(RATE, LAST_RATE)})
        self.base, self.photos = base, tuple(photos)
        self.kind: Kind = kind
        self.mode = base.mode
        self.code_finishes = not isinstance(base, HasCode)

    @property
    def exposures(self) -> Exposures:
        """The exposures as they are now."""
        raw = self.parameters.shared[TENSOR]
        return Exposures(kind=self.kind, photos=self.photos, raw=raw)

    def splats(self, view: View, moment: Moment) -> Splats:
        """What the model shows.

        Args:
            view: What is looked at.
            moment: Step of training, or TRAINED.
        """
        return self.base.splats(self._asked(view)[0], moment)

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w c"]:
        """The model's image, exposed.

        Args:
            view: Its appearance says which photo's exposure.
            output: What was rasterized.
        """
        inner, own = self._asked(view)
        return self.exposures.shown(own, self.base.finish_image(inner, output))

    @property
    def unbaked(self) -> tuple[str, ...]:
        """The exposures of photos, after what the model itself adds."""
        return (*self.base.unbaked, "the exposures of its photos")

    def neutral_code(self, view: View) -> Float[Tensor, " c"]:
        """The model's own neutral code, if it has one, and that of neutral exposure.

        Args:
            view: What is to be shown.
        """
        own = self.exposures.neutral()
        if not isinstance(self.base, HasCode):
            return own
        return torch.cat([self.base.neutral_code(view), own])

    def facts(self) -> dict[str, Any]:
        """What `restored` needs beside the tensors."""
        told = {"kind": self.kind, "photos": list(self.photos)}
        return self.base.facts() | {TENSOR: told}

    def _asked(self, view: View) -> tuple[View, View]:
        """The view as the model is asked for it, and as its exposure is."""
        code, count = view.appearance, NUMBERS[self.kind]
        if not isinstance(code, Tensor) or not isinstance(self.base, HasCode):
            return view, view
        return replace(view, appearance=code[:-count]), replace(view, appearance=code[-count:])


def exposed(model: Model, exposure: Exposure, views: Sequence[View]) -> Model:
    """A model that also learns the exposure of its photos, or the model itself where that is off.

    Args:
        model: The model at its start.
        exposure: What is learnt of each photo.
        views: Training views.

    Raises: DataError for fewer than two views.
    """
    if exposure == "off":
        return model
    if len(views) < 2:
        raise DataError(
            f"exposure {exposure!r} with {len(views)} training view: it compares photos, at least 2; "
            "train on more, or set exposure to 'off'"
        )
    return ExposedModel(model, exposure, [view.name for view in views])


def restored(
    build: Callable[[Mapping[str, Any], Mapping[str, Tensor]], Model],
    facts: Mapping[str, Any],
    tensors: Mapping[str, Tensor],
) -> Model:
    """The model of what was stored, with the exposures that it had, if any.

    Args:
        build: build(facts, tensors): the model without them.
        facts: What `Model.facts` said.
        tensors: As `Parameters.state` names them.

    Raises: KeyError or ValueError if something is missing or does not fit.
    """
    told, name = facts.get(TENSOR), f"shared.{TENSOR}"
    if told is None:
        return build(facts, tensors)
    raw = tensors[name]
    base = build(facts, {key: value for key, value in tensors.items() if key != name})
    model = ExposedModel(base, told["kind"], told["photos"])
    _check(model.exposures, raw)
    return model


def _check(wanted: Exposures, raw: Tensor) -> None:
    if raw.shape != wanted.raw.shape:
        raise ValueError(f"{TENSOR}: {tuple(raw.shape)}, expected {tuple(wanted.raw.shape)}")


@dataclass(frozen=True, kw_only=True, eq=False)
class ExposedGaussians(ExplicitModel):
    """Explicit Gaussians in neutral exposure, and the exposure of each training photo."""

    exposures: Exposures

    @property
    def kind(self) -> str:
        """Name by which the loader of these models is found."""
        return EXPOSED

    @torch.no_grad()
    def render(self, view: View, background: Float[Tensor, "3"] | None = None) -> RenderOutput:
        """The image of a view in the exposure that is asked for, not clamped.

        Args:
            view: Its camera and appearance count.
            background: Colour behind everything, before the exposure; None is black.
        """
        output = super().render(view, background)
        return replace(output, colour=self.exposures.shown(view, output.colour))

    def fit_appearance(
        self,
        view: View,
        image: Float[Tensor, "h w 3"],
        columns: slice,
        mask: Bool[Tensor, "h w"] | None = None,
    ) -> Float[Tensor, " c"]:
        """Exposure that shows a view over black as an image does, see `fit_code`.

        Args:
            view: Camera of the image.
            image: The columns that may be looked at, in [0, 1].
            columns: Which columns of the whole image they are.
            mask: Which of their pixels may be looked at; None: all.
        """
        colour = super().render(view).colour
        neutral = self.exposures.neutral()
        return fit_code(lambda c: adjusted(colour, c), neutral, image, columns, mask)

    def store(self, folder: Path) -> Stored:
        """What `save_model` writes: the Gaussians, how they are drawn, and the exposures.

        Args:
            folder: Not used: there are no files beside the arrays.
        """
        stored, mine = super().store(folder), self.exposures
        told = {TENSOR: {"kind": mine.kind, "photos": list(mine.photos)}}
        return Stored(
            tensors=dict(stored.tensors) | {TENSOR: mine.raw}, facts=dict(stored.facts) | told
        )


def load_exposed(folder: Path, stored: Stored, backend: str) -> ExposedGaussians:
    """The Gaussians with exposures of a folder whose files were read.

    Args:
        folder: Folder of the model, for errors.
        stored: Arrays and facts that the folder holds.
        backend: Name of the rasterizer to draw it with.

    Raises: DataError, in one line, for what is missing or damaged.
    """
    plain = load_explicit(folder, stored, backend)
    try:
        told, raw = stored.facts[TENSOR], stored.tensors[TENSOR]
        exposures = Exposures(kind=told["kind"], photos=tuple(told["photos"]), raw=raw)
        if raw.shape != (len(exposures.photos), NUMBERS[exposures.kind]):
            raise ValueError(f"{TENSOR} has shape {tuple(raw.shape)}")
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{folder / DESCRIPTION}: damaged ({error!r})") from None
    if not bool(raw.isfinite().all()):
        raise DataError(f"{folder / ARRAYS}: {TENSOR} is not finite")
    return ExposedGaussians(**vars(plain), exposures=exposures)


def explicit(model: Model, scene: Scene, backend: str) -> ExplicitModel:
    """What a fit of explicit Gaussians returns; with its exposures where it learnt them.

    Args:
        model: A GaussianModel after its last step, or one inside an ExposedModel.
        scene: What it was trained on; its shift and units count.
        backend: Name of the rasterizer.
    """
    base = model.base if isinstance(model, ExposedModel) else model
    assert isinstance(base, GaussianModel)
    plain = ExplicitModel(
        model=base.gaussians(), shift=scene.shift, units=scene.units, backend=backend,
        mode=base.mode,
    )  # fmt: skip
    if not isinstance(model, ExposedModel):
        return plain
    now = model.exposures
    exposures = replace(now, raw=now.raw.detach().cpu())
    return ExposedGaussians(**vars(plain), exposures=exposures)
