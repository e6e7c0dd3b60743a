"""The views that changed most, as A/B crops where their error changed most."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from splatproof.base.errors import DataError
from splatproof.reports.comparing.cases import CaseRecord
from splatproof.reports.comparing.compare import Compared, Comparison
from splatproof.reports.store import Picture

VIEWS = 6
"""Number of views that are shown."""
EACH = 2
"""Number of them for one metric of one row."""
SHARE = 0.35
"""Side of the crop as a share of the picture's shorter side."""
LEAST = 48
"""Pixels: a crop is never smaller where the picture is not."""
HEIGHT = 240
"""Pixels of every panel's height."""
FULL = 0.25
"""Change of the mean absolute error (of [0, 1]) that is shown in full red or blue."""
GAP, CAPTION = 6, 20
"""Pixels between panels, and of the line below them."""
FONT = 13

Colours = Float[np.ndarray, "_ _ 3"]
Canvas = UInt8[np.ndarray, "_ _ 3"]


@dataclass(frozen=True, kw_only=True)
class View:
    """A view of a comparison that is shown, in a pair of cases."""

    compared: Compared
    image: str
    base: CaseRecord
    new: CaseRecord
    change: float
    """The metric's NEW - BASE in this view, of these two cases, in its unit."""

    @property
    def title(self) -> str:
        """What it shows, in one line."""
        one = self.compared
        unit = f" {one.measure.unit}" if one.measure.unit else ""
        values = [
            case.measured.images[self.image][one.measure.metric] for case in (self.base, self.new)
        ]
        number = f"{values[0]:.4g} to {values[1]:.4g}{unit}"
        return f"{one.group.name} seed {self.new.measured.seed}, {self.image}: {one.measure.metric} {number}"


def changed_views(found: Comparison, most: int = VIEWS) -> list[View]:
    """The views with the largest change: of what got worse, else of the largest differences there are.

    Args:
        found: A comparison.
        most: Number of views.
    Returns: At most EACH views a metric of a row, no view of a row twice; of every view the pair of
        cases of the same seed (of the first seeds where they share none) in which it changed most.
    """
    per_image = [one for one in found.compared if one.images and one.estimate is not None]
    worse = [one for one in per_image if one.verdict == "worse"]
    chosen = sorted(worse or per_image, key=_size, reverse=True)
    views: list[View] = []
    seen: set[tuple[str, str]] = set()
    for one in chosen:
        fresh = [view for view in _views(one) if (one.group.name, view.image) not in seen][:EACH]
        seen |= {(one.group.name, view.image) for view in fresh}
        views += fresh
    return views[:most]


def _size(one: Compared) -> float:
    """Difference in bands, or in standard errors where there is no band."""
    assert one.estimate is not None
    scale = one.measure.band or one.estimate.error
    return abs(one.estimate.mean) / scale if scale else 0.0


def _views(one: Compared) -> list[View]:
    """All views of a comparison, the most changed to the comparison's side first."""
    assert one.estimate is not None
    sign = 1.0 if one.estimate.mean > 0 else -1.0
    pairs = [
        (b, n) for b in one.group.base for n in one.group.new if b.measured.seed == n.measured.seed
    ]
    metric = one.measure.metric
    best: dict[str, View] = {}
    for base, new in pairs or [(one.group.base[0], one.group.new[0])]:
        for image in sorted(base.measured.images.keys() & new.measured.images.keys()):
            values = [case.measured.images[image].get(metric) for case in (base, new)]
            if values[0] is None or values[1] is None:
                continue
            view = View(compared=one, image=image, base=base, new=new, change=values[1] - values[0])
            if image not in best or sign * view.change > sign * best[image].change:
                best[image] = view
    return sorted(best.values(), key=lambda view: -sign * view.change)


def draw(view: View) -> bytes | str:
    """A PNG of the view: the whole truth, then crops of truth, BASE, NEW and the change of error.

    Args:
        view: What is shown.
    Returns: The file's bytes, or in words why there are no pictures to make it of.
    Raises: DataError naming a picture that is no image, or of another size than the others.
    """
    pictures: list[Colours] = []
    wanted: list[tuple[CaseRecord, Picture, str]] = [
        (view.new, "truth", "NEW"), (view.base, "render", "BASE"), (view.new, "render", "NEW"),
    ]  # fmt: skip
    for case, kind, side in wanted:
        png = case.pictures(kind, view.image) if case.pictures else None
        if png is None:
            return f"{side} has no pictures of {case.name}"
        pictures.append(_decoded(png, f"{side} {kind} of {view.image} in {case.name}"))
    truth, base, new = pictures
    if not truth.shape == base.shape == new.shape:
        raise DataError(
            f"{view.title}: pictures of {truth.shape}, {base.shape} and {new.shape} pixels"
        )
    change = np.abs(new - truth).mean(axis=2) - np.abs(base - truth).mean(axis=2)
    top, left, side = place(change, view.compared)
    cut = np.s_[top : top + side, left : left + side]
    marked = _marked(truth, top, left, side)
    panels = [
        (marked, "truth"), (truth[cut], "truth"), (base[cut], "BASE"), (new[cut], "NEW"),
        (_coloured(change[cut]), f"error: red more, blue less (to {FULL:g})"),
    ]  # fmt: skip
    return _sheet([(_scaled(panel), caption) for panel, caption in panels], view.title)


def place(change: Float[np.ndarray, "_ _"], one: Compared) -> tuple[int, int, int]:
    """Top, left and side in pixels of the square in which the error changed most.

    Args:
        change: Error of NEW less that of BASE at each pixel.
        one: What is shown: of what got better, the square where the error fell most.
    """
    height, width = change.shape
    side = min(height, width, max(LEAST, round(SHARE * min(height, width))))
    risen = change if not _improved(one) else -change
    sums = np.pad(risen, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    boxes = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    top, left = np.unravel_index(int(boxes.argmax()), boxes.shape)
    return int(top), int(left), side


def _improved(one: Compared) -> bool:
    assert one.estimate is not None
    return (one.estimate.mean > 0) == one.measure.higher_is_better


def _decoded(png: bytes, where: str) -> Colours:
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise DataError(f"{where}: not an image; run the case again")
    return pixels[..., ::-1].astype(np.float64) / 255


def _coloured(change: Float[np.ndarray, "_ _"]) -> Colours:
    """White where nothing changed, red where the error rose, blue where it fell."""
    share = np.clip(change / FULL, -1, 1)[..., None]
    red, blue = np.array([0.75, 0.05, 0.1]), np.array([0.1, 0.25, 0.75])
    return 1 - np.abs(share) * (1 - np.where(share > 0, red, blue))


def _marked(truth: Colours, top: int, left: int, side: int) -> Colours:
    """The whole picture with a yellow frame around the square, as wide as three pixels of its panel."""
    thick = max(1, round(3 * truth.shape[0] / HEIGHT))
    shown = np.ascontiguousarray(truth.astype(np.float32))
    cv2.rectangle(shown, (left, top), (left + side - 1, top + side - 1), (1.0, 0.9, 0.0), thick)
    return shown.astype(np.float64)


def _scaled(panel: Colours) -> Canvas:
    """A panel of HEIGHT pixels; small crops are enlarged without blur, so that pixels stay visible."""
    height, width = panel.shape[:2]
    size = max(1, round(width * HEIGHT / height)), HEIGHT
    way = cv2.INTER_NEAREST if height < HEIGHT else cv2.INTER_AREA
    return np.round(255 * cv2.resize(panel, size, interpolation=way).clip(0, 1)).astype(np.uint8)


def _sheet(panels: Sequence[tuple[Canvas, str]], title: str) -> bytes:
    """Panels side by side with a caption each, and a title above; PNG."""
    width = sum(panel.shape[1] for panel, _ in panels) + GAP * (len(panels) - 1)
    sheet = Image.new("RGB", (width, HEIGHT + 2 * CAPTION), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=FONT)
    pen.text((2, 2), title, fill="black", font=font)
    left = 0
    for panel, caption in panels:
        sheet.paste(Image.fromarray(panel), (left, CAPTION))
        corners = (left, CAPTION, left + panel.shape[1] - 1, CAPTION + HEIGHT - 1)
        pen.rectangle(corners, outline="lightgrey")  # the change is white where there is none
        pen.text((left + 2, CAPTION + HEIGHT + 2), caption, fill="black", font=font)
        left += panel.shape[1] + GAP
    stream = io.BytesIO()
    sheet.save(stream, "PNG", optimize=True)
    return stream.getvalue()
