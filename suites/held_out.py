"""Render the held-out views, keep the pictures, and score them by the protocol."""

import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8, UInt16
from torch import Tensor

from splatproof.base.errors import DataError, UsageError
from splatproof.base.folders import new_folder
from splatproof.datasets.photos import write_png
from splatproof.datasets.seen import seen_in_training
from splatproof.datasets.truth_image import Truth
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.metrics.ldr_flip import flip_map
from splatproof.metrics.pairs import check_pair
from splatproof.metrics.registry import find_metric
from splatproof.metrics.scoring import prepare, region_columns, round_to_8_bit, score_image
from splatproof.metrics.seen_part import with_seen
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore, picture_name
from splatproof.reference.types.scene import Scene, View
from splatproof.suites import appearance

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


def check_truth(scene: Scene, protocol: Protocol) -> None:
    """Refuse held-out views whose photos cannot be read, or whose masks leave nothing to score; reads both.

    Args:
        scene: Scene, opened under the protocol.
        protocol: The rules that the views are scored by.
    Raises: DataError naming the view.
    """
    for view in scored_views(scene, protocol):
        if isinstance(view.load, Truth):
            view.load.check()
        if view.load_mask is None or not protocol.masked:
            continue
        mask = view.load_mask()
        if not mask[:, region_columns(mask.shape[1], protocol.region)].any():
            raise DataError(
                f"scene {scene.name}: {view.name} is held out, and its mask leaves no pixel to score; "
                "take the photo out of the scene, or correct the mask"
            )


def score_views(
    scene: Scene,
    model: Reconstruction,
    protocol: Protocol,
    folder: Path,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[ImageScore, ...]:
    """Score every test view, one in memory at a time.

    Writes renders/, truth/, masks/ (where the scene has any) and errors/ (FLIP error maps, magma,
    black where nothing is scored) as PNGs named after the views. Renders, truth and masks are what
    was scored: scoring the files again gives the same numbers (see `kept`).

    Args:
        scene: Scene with test views.
        model: What is scored.
        protocol: The rules.
        folder: Folder of the case.
        tell: Hears how many views are scored, of how many.
    Returns: Scores sorted by name.
    Raises: DataError where `scored_views` refuses the scene, or a view cannot be scored.
    """
    views = scored_views(scene, protocol)
    names = [picture_name(view.name) for view in views]
    scores = []
    masked = any(view.load_mask is not None for view in views)
    seen = seen_in_training(scene)
    known = [part for part in seen.values() if part is not None]
    apart = any(float(part.double().mean()) < SEEN_WHOLE for part in known)
    with (
        new_folder(folder / "renders") as renders,
        new_folder(folder / "truth") as truths,
        new_folder(folder / "errors") as errors,
        new_folder(folder / "masks") if masked else nullcontext(folder) as masks,
    ):
        for view, name in zip(views, names, strict=True):
            tell(len(scores), len(views))
            image = drawn(view, scene.train_views, model, protocol)
            render, shown = kept(image, protocol.rounding)
            truth, true = kept(view.load(), "float")
            mask = None if view.load_mask is None else view.load_mask()
            score = score_image(view.name, render, truth, protocol, mask, _moving(view, protocol))
            if known:
                score = with_seen(
                    score, render, truth, protocol, mask, seen[view.name], apart=apart
                )
            scores.append(score)
            write_png(renders / name, shown)
            write_png(truths / name, true)
            write_png(errors / name, error_picture(view.name, render, truth, protocol, mask))
            if masked:
                valid = np.ones(truth.shape[:2], bool) if mask is None else mask.numpy()
                write_png(masks / name, np.repeat(valid[..., None] * np.uint8(255), 3, axis=2))
    return tuple(scores)


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
    Raises: UsageError where a model of somebody else gives no image of the view's size.
    """
    asked = appearance.shown(view, training, model, protocol)
    image = _colour(model.render(asked, torch.tensor(protocol.background)), view, model)
    return appearance.exposed(view, image, protocol)


def _colour(output: object, view: View, model: Reconstruction) -> Float[Tensor, "h w 3"]:
    """The image in what a model gave. Raises: UsageError where it is none, as another's model may give."""
    colour = getattr(output, "colour", None)
    found = f"a {type(output if colour is None else colour).__name__}"
    if isinstance(colour, Tensor):
        if colour.is_floating_point() and tuple(colour.shape) == (*view.size, 3):
            return colour
        found = f"{colour.dtype} of {' x '.join(map(str, colour.shape))}"
    raise UsageError(
        f"{view.name}: the model of kind {model.kind!r} rendered {found}, expected a RenderOutput with "
        f"a colour of floats in [0, 1], {' x '.join(map(str, view.size))} x 3"
    )


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


def error_picture(
    name: str, render: Tensor, truth: Tensor, protocol: Protocol, mask: Tensor | None
) -> UInt8[np.ndarray, "h w 3"]:
    """FLIP of what is scored as colours: black (equal) over red to yellow-white (1).

    Args:
        name: Name of the view, for errors.
        render: The model's image, h x w x 3, sRGB in [0, 1].
        truth: The photo, of the same size.
        protocol: The rules: what of the image is scored.
        mask: True where a pixel is valid, h x w; None: everywhere.
    Returns: A picture of the whole image, black where nothing is scored.
    """
    ready = prepare(render, truth, protocol, mask, name=name)
    pair = check_pair(ready.render, ready.truth, ready.mask, metric="error map")
    error = np.where(pair.valid, flip_map(pair), 0.0)
    whole = np.zeros(render.shape[:2])
    whole[:, region_columns(render.shape[1], protocol.region)] = error
    colours = cv2.applyColorMap((whole * 255).round().astype(np.uint8), cv2.COLORMAP_MAGMA)
    return np.asarray(colours[..., ::-1], dtype=np.uint8)


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
