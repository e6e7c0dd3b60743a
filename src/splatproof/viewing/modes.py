"""What of a model a picture shows: its colours, or what is known of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.base.names import unknown
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.regions import nearest_region
from splatproof.methods.contracts.backends import get_backend
from splatproof.metrics.seam_partition import partition_seam_mask, surface_points
from splatproof.reference.rasterizer.spherical_harmonics import C0
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import activated
from splatproof.viewing.against_photos import error_against_photo, seen_by_photos
from splatproof.viewing.stage import Shown, Stage

NEAR, FAR = 0.1, 10.0
"""Depths between which colours of the depth mode run, in radii of the scene, on a log scale."""
MOST_ERROR = 0.5
"""Mean absolute difference of the channels, of 1, from which the error is drawn at its brightest."""
UNSEEN = (0.95, 0.1, 0.75)
"""Colour over what no training photo shows."""
RIM, WALL = (1.0, 0.55, 0.0), (1.0, 1.0, 1.0)
"""Colours of where two blocks compete, and of the walls between regions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Looked:
    """One model from one camera."""

    stage: Stage
    shown: Shown
    view: View
    output: RenderOutput
    photo: View | None
    """Photo that the error is measured against; None: the nearest."""

    @property
    def colours(self) -> Float[Tensor, "h w 3"]:
        """The image, clamped."""
        return self.output.colour.clamp(0, 1)

    @property
    def covered(self) -> Bool[Tensor, "h w"]:
        """Where more than half of what is seen is the model."""
        return self.output.alpha >= 0.5


Picture = tuple[Float[Tensor, "h w 3"], dict[str, str]]
"""A picture in [0, 1], and what is to be read beside it, by name."""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """One way to look at a model."""

    label: str
    legend: str
    """What its colours mean, in one line."""
    draw: Callable[[Looked], Picture]
    missing: Callable[[Stage, Shown], str]
    """Why it cannot be shown of a model; empty where it can."""


def mode_named(name: str) -> Mode:
    """The mode of that name.

    Raises: UsageError for an unknown one.
    """
    if name not in MODES:
        raise unknown("mode", name, MODES)
    return MODES[name]


def check_mode(stage: Stage, name: str) -> None:
    """Refuse a mode in which the first model cannot be shown.

    Args:
        stage: What is shown.
        name: Name of the mode.
    Raises: UsageError.
    """
    missing = mode_named(name).missing(stage, stage.models[0])
    if missing:
        raise UsageError(f"--mode {name}: {missing}")


def _colour(looked: Looked) -> Picture:
    return looked.colours, {}


def _depth(looked: Looked) -> Picture:
    radius = looked.stage.place.radius
    z = looked.output.depth.clamp(min=1e-12)
    share = (z / (NEAR * radius)).log() / np.log(FAR / NEAR)
    picture = _mapped(1 - share, cv2.COLORMAP_TURBO)
    picture[looked.output.alpha < 0.02] = 0.0
    told = f"{NEAR * radius:.3g} (red) to {FAR * radius:.3g} (blue), log scale"
    return picture * looked.output.alpha[..., None].clamp(0, 1), {"depth": told}


def _blocks(looked: Looked) -> Picture:
    model = looked.shown.model
    assert isinstance(model, CityModel)
    light = (0.5 + C0 * model.model.sh[:, 0]).clamp(0, 1).mean(dim=1, keepdim=True)
    colours = block_colours(int(model.blocks.max()) + 1)[model.blocks] * (0.35 + 0.65 * light)
    backend, behind = get_backend(model.backend), looked.stage.background
    painted = replace(activated(model.model), sh=None, colours=colours).to(backend.device)
    output = backend.draw(
        looked.view.camera, painted, mode=model.mode,
        background=None if behind is None else behind.to(backend.device),
    ).to("cpu")  # fmt: skip
    return output.colour.clamp(0, 1), {"blocks": str(len(model.blocks.unique()))}


def block_colours(count: int) -> Float[Tensor, "count 3"]:
    """Colours that are told apart: hues by the golden angle.

    Args:
        count: How many.
    """
    hues = (torch.arange(count, dtype=torch.float64) * 0.618034) % 1.0
    hsv = torch.stack([hues * 360, torch.full_like(hues, 0.75), torch.ones_like(hues)], dim=1)
    rgb = cv2.cvtColor(hsv.float().numpy()[None], cv2.COLOR_HSV2RGB)[0]
    return torch.from_numpy(np.ascontiguousarray(rgb))


def _seams(looked: Looked) -> Picture:
    model, camera = looked.shown.model, looked.view.camera
    assert isinstance(model, CityModel)
    depth = torch.where(looked.covered, looked.output.depth, torch.inf)
    rim = partition_seam_mask(camera, depth, model.regions)
    picture = _grey(looked.colours)
    picture[rim] = 0.4 * picture[rim] + 0.6 * picture.new_tensor(RIM)
    here = torch.where(looked.covered)
    owner = torch.full(depth.shape, -1, dtype=torch.int64)
    owner[here] = nearest_region(model.regions, surface_points(camera, depth)[here])
    wall = torch.zeros_like(rim)
    down, across = owner[1:] != owner[:-1], owner[:, 1:] != owner[:, :-1]
    wall[1:] |= down & (owner[1:] >= 0) & (owner[:-1] >= 0)
    wall[:, 1:] |= across & (owner[:, 1:] >= 0) & (owner[:, :-1] >= 0)
    picture[wall] = picture.new_tensor(WALL)
    return picture, {"seam pixels": f"{float(rim.double().mean()):.2%}"}


def _unseen(looked: Looked) -> Picture:
    unseen = ~seen_by_photos(looked.stage, looked.shown, looked.view.camera, looked.output)
    picture = looked.colours.clone()
    picture[unseen] = 0.3 * _grey(picture)[unseen] + 0.7 * picture.new_tensor(UNSEEN)
    return picture, {"unseen": f"{float(unseen.double().mean()):.1%} of the picture"}


def _error(looked: Looked) -> Picture:
    found = error_against_photo(
        looked.stage, looked.shown, looked.view.camera, looked.output, looked.photo
    )
    picture = _mapped(found.error / MOST_ERROR, cv2.COLORMAP_MAGMA)
    picture[~found.known] = 0.25 * _grey(looked.colours)[~found.known] + 0.3
    told = {"photo": found.name, "compared": f"{float(found.known.double().mean()):.0%}"}
    if bool(found.known.any()):
        told["mean error"] = f"{float(found.error[found.known].double().mean()):.4f}"
    return picture, told


def _grey(image: Float[Tensor, "*hw 3"]) -> Float[Tensor, "*hw 3"]:
    return image.mean(dim=-1, keepdim=True).expand(image.shape).clone()


def _mapped(share: Float[Tensor, "h w"], colours: int) -> Float[Tensor, "h w 3"]:
    """Numbers from 0 to 1 by one of OpenCV's colour maps."""
    index = (share.nan_to_num().clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    picture = cv2.applyColorMap(index, colours)[..., ::-1]
    return torch.from_numpy(np.ascontiguousarray(picture)).float() / 255


def _always(stage: Stage, shown: Shown) -> str:
    del stage, shown
    return ""


def _needs_blocks(stage: Stage, shown: Shown) -> str:
    del stage
    if isinstance(shown.model, CityModel):
        return ""
    return "the model was not trained in blocks"


def _needs_regions(stage: Stage, shown: Shown) -> str:
    absent = _needs_blocks(stage, shown)
    if not absent and isinstance(shown.model, CityModel) and len(shown.model.regions) < 2:
        return "the model does not say where its blocks lie"
    return absent


def _needs_photos(stage: Stage, shown: Shown) -> str:
    del shown
    return "" if stage.training else "there is no scene with photos; name one with --scene"


MODES = {
    "colour": Mode(label="Colour", legend="as photos show it", draw=_colour, missing=_always),
    "depth": Mode(
        label="Depth", legend="red is near, blue is far", draw=_depth, missing=_always
    ),
    "blocks": Mode(
        label="Blocks", legend="one colour for each block that trained a Gaussian",
        draw=_blocks, missing=_needs_blocks,
    ),
    "seams": Mode(
        label="Seams", legend="orange: two blocks compete; white: walls between regions",
        draw=_seams, missing=_needs_regions,
    ),
    "unseen": Mode(
        label="Unseen", legend="pink: no training photo shows it", draw=_unseen,
        missing=_needs_photos,
    ),
    "error": Mode(
        label="Error", legend="against the nearest photo: black is equal, grey is not in it",
        draw=_error, missing=_needs_photos,
    ),
}  # fmt: skip
