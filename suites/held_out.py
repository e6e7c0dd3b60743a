"""Render the held-out views, keep the pictures, and score them by the protocol."""

import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8, UInt16
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.folders import new_folder
from splatproof.datasets.seen import seen_in_training
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.metrics.registry import find_metric
from splatproof.metrics.scoring import round_to_8_bit
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore, picture_name
from splatproof.reference.types.scene import Scene, View
from splatproof.suites import appearance
from splatproof.suites.view_scoring import Folders, Scorers, Shot, helpers

TIMED_FRAMES = 15
"""Frames whose render time is measured, spread over the test views."""
SEEN_WHOLE = 0.99
"""Share of an image from which what training photos show of it is scored as the image itself; the part
is scored apart where any image of the scene has less."""
TIMED_SECONDS = 5.0
"""No further frame is measured after this long, but at least three are."""


def scored_views(scene: Scene, protocol: Protocol) -> list[View]:
    """The views that are scored, sorted by name; what can be said against them before training.

    Args:
        scene: Scene, opened under the protocol.
        protocol: The rules that the views are scored by.
    Returns: At least one view.
    Raises: DataError for a scene without test views, with two that differ by their suffix alone,
        or with masks under a metric that has no masked form.
    """
    views = sorted(scene.test_views, key=lambda view: view.name)
    if not views:
        raise DataError(f"scene {scene.name}: no test view under protocol {protocol.name!r}")
    if len({picture_name(view.name) for view in views}) < len(views):
        raise DataError(f"scene {scene.name}: two test views have the same name but for the suffix")
    whole = [name for name in protocol.metrics if not find_metric(name).masked]
    if whole and protocol.masked and any(view.load_mask is not None for view in views):
        raise DataError(
            f"scene {scene.name}: has masks, and {whole[0]} has no masked form; take a protocol "
            "with masked = false or without that metric"
        )
    return views


@dataclass(frozen=True, kw_only=True)
class Scored:
    """What `score_views` found."""

    images: tuple[ImageScore, ...]
    """A score for each view, sorted by name."""
    cpu_seconds: float
    """CPU seconds of other processes that helped."""


def score_views(
    scene: Scene,
    model: Reconstruction,
    protocol: Protocol,
    folder: Path,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Scored:
    """Score every test view; of large photos several at a time, as threads and memory allow.

    Writes renders/, truth/, masks/ (where the scene has any) and errors/ (FLIP error maps, magma,
    black where nothing is scored) as PNGs named after the views. Renders, truth and masks are what
    was scored: scoring the files again gives the same numbers (see `kept`).

    Args:
        scene: Scene with test views.
        model: What is scored.
        protocol: The rules.
        folder: Folder of the case.
        tell: Hears how many views are scored, of how many.
    Raises: DataError where `scored_views` refuses the scene, or a view cannot be scored.
    """
    views = scored_views(scene, protocol)
    masked = any(view.load_mask is not None for view in views)
    seen = seen_in_training(scene)
    known = [part for part in seen.values() if part is not None]
    apart = any(float(part.double().mean()) < SEEN_WHOLE for part in known)
    most = max(view.camera.width * view.camera.height for view in views)
    with (
        new_folder(folder / "renders") as renders,
        new_folder(folder / "truth") as truths,
        new_folder(folder / "errors") as errors,
        new_folder(folder / "masks") if masked else nullcontext(None) as masks,
        Scorers(
            helpers(len(views), most, protocol), protocol,
            Folders(renders=renders, truth=truths, errors=errors, masks=masks),
        ) as scorers,
    ):  # fmt: skip
        for view in views:
            tell(scorers.done, len(views))
            render, shown = kept(drawn(view, scene.train_views, model, protocol), protocol.rounding)
            truth, true = kept(view.load(), "float")
            part, moving = seen[view.name], _moving(view, protocol)
            shot = Shot(
                name=view.name, picture=picture_name(view.name),
                render=render.numpy(), truth=truth.numpy(), shown=shown, true=true,
                mask=None if view.load_mask is None else view.load_mask().numpy(),
                moving=None if moving is None else {k: own.numpy() for k, own in moving.items()},
                seen=None if part is None else part.numpy(), known=bool(known), apart=apart,
            )  # fmt: skip
            scorers.give(shot)
        scores = scorers.scores()
        tell(scorers.done, len(views))
    return Scored(images=scores, cpu_seconds=scorers.cpu_seconds)


def drawn(
    view: View, training: Sequence[View], model: Reconstruction, protocol: Protocol
) -> Float[Tensor, "h w 3"]:
    """What a model shows of a view under a protocol: its background, and the light it allows.

    Args:
        view: The view; its image is looked at only where the protocol's `appearance` says so.
        training: The views that the model was trained on.
        model: What is looked at.
        protocol: The rules.
    Returns: The image, neither rounded nor clamped.
    """
    asked = appearance.shown(view, training, model, protocol)
    image = model.render(asked, torch.tensor(protocol.background)).colour
    return appearance.exposed(view, image, protocol)


def _moving(view: View, protocol: Protocol) -> dict[str, Bool[Tensor, "h w"]] | None:
    """What moves in a view, {} where it is not known; None where the protocol scores no parts."""
    if not protocol.parts:
        return None
    return {} if view.load_moving is None else view.load_moving()


def kept(
    image: Float[Tensor, "h w 3"], rounding: Literal["round", "truncate", "float"]
) -> tuple[Float[Tensor, "h w 3"], UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"]]:
    """What is scored of an image, and the PNG that holds exactly that.

    8 bits a channel where they hold the (rounded) image, else 16, to which it is rounded half up:
    a step of 1.5e-5, the noise of which lies at 107 dB.

    Args:
        image: Any values; outside [0, 1] and where it is not finite it is scored as it is.
        rounding: The protocol's rule for renders; "float" for truth.
    """
    clean = image.detach().float().nan_to_num().clamp(0, 1)
    rounded = round_to_8_bit(clean, rounding)
    bits: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w 3"] = to_8_bit(rounded)
    stored = torch.from_numpy(bits).float() / 255
    if not torch.equal(stored, rounded):
        steps = torch.floor(rounded * 65535 + 0.5)
        bits, stored = steps.numpy().astype(np.uint16), steps / 65535
    inside = (image >= 0) & (image <= 1)
    return torch.where(inside, stored, image.detach().float()), bits


def to_8_bit(image: Float[Tensor, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Clamped and rounded half up, as bytes."""
    rounded = round_to_8_bit(image.detach().float().clamp(0, 1), "round") * 255
    return rounded.round().to(torch.uint8).numpy()


def render_milliseconds(
    views: list[View], model: Reconstruction, background: Float[Tensor, "3"]
) -> float:
    """Median milliseconds a frame over the views; the first frame only warms up.

    Args:
        views: Views to render, at least one.
        model: What is timed.
        background: Colour behind everything, sRGB in [0, 1].
    """
    chosen = [views[int(i * len(views) / TIMED_FRAMES)] for i in range(TIMED_FRAMES)]

    def draw(view: View) -> None:
        if model.render(view.without_truth(), background).colour.is_cuda:
            torch.cuda.synchronize()  # the call returns before the GPU has drawn

    draw(chosen[0])
    times: list[float] = []
    for view in chosen:
        started = time.perf_counter()
        draw(view)
        times.append(time.perf_counter() - started)
        if len(times) >= 3 and sum(times) > TIMED_SECONDS:
            break
    return 1000 * statistics.median(times)
