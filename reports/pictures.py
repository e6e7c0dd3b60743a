"""Which pictures a page carries, and how small it makes them."""

import base64
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd

from splatproof.base.errors import DataError
from splatproof.reports import run_data
from splatproof.reports.frames import groups
from splatproof.reports.store import Picture, StoredResult
from splatproof.reports.table import Row, Table

WIDEST = 960
"""Pixels; wider pictures are scaled down for the page (the store keeps the originals)."""
QUALITY = 90
"""JPEG quality, colour not subsampled."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A test image on the page: data URIs by what they show."""

    name: str
    truth: dict[str, str]
    """The truth for each row label; rows that were scored on the same truth share the string."""
    render: dict[str, str]
    error: dict[str, str]
    """Rows without that picture are absent."""


def choose(table: Table, stored: dict[str, StoredResult], budget: int) -> tuple[list[Shown], int]:
    """The pictures of a scene that fit into `budget`, from worst and best to the ones between.

    Args:
        table: A table of one scene.
        stored: Stored results by their `run_data.case_key`.
        budget: Characters of data URIs; the first image is carried whatever it takes.
    Returns: Images sorted by name, and how many test images the scene has.
    """
    names = _by_score(table)
    shown, spent = [], 0
    for index in spread(len(names)):
        image = _image(table, stored, names[index])
        if image is None:
            continue
        unique = {*image.truth.values(), *image.render.values(), *image.error.values()}
        spent += sum(map(len, unique))
        if shown and spent > budget:
            break
        shown.append(image)
    return sorted(shown, key=lambda image: image.name), len(names)


def spread(count: int) -> list[int]:
    """All of range(count), first the ends, then ever finer between: any start of it is spread out."""
    order = dict.fromkeys([0, count - 1] if count else [])
    parts = 2
    while len(order) < count:
        order |= dict.fromkeys((count - 1) * i // parts for i in range(1, parts, 2))
        parts *= 2
        if parts > 2 * count:
            order |= dict.fromkeys(range(count))
    return list(order)


def encode(png: bytes, name: str) -> str:
    """A picture as a JPEG data URI of at most WIDEST pixels across.

    Args:
        png: Bytes of an image file.
        name: What the picture is called in errors.
    Raises: DataError naming the picture where its bytes are no image.
    """
    return "data:image/jpeg;base64," + base64.b64encode(to_jpeg(png, name)).decode()


def to_jpeg(png: bytes, name: str, widest: int = WIDEST, quality: int = QUALITY) -> bytes:
    """A picture as a JPEG file.

    Args:
        png: Bytes of an image file.
        name: What the picture is called in errors.
        widest: Pixels across; a wider one is scaled down.
        quality: JPEG quality, in [0, 100]; colour is not subsampled.
    Raises: DataError naming the picture where its bytes are no image.
    """
    pixels = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise DataError(f"{name}: not an image; delete the case's folder and run it again")
    height, width = pixels.shape[:2]
    if width > widest:
        size = (widest, max(1, round(height * widest / width)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    return cv2.imencode(".jpg", pixels, options)[1].tobytes()


def _by_score(table: Table) -> list[str]:
    """Names of the scene's test images, sorted by their mean score in the first column."""
    key = table.columns[0].key
    scores = pd.concat([row.scores for row in table.rows]).reindex(columns=["image", key])
    means = {name: float(own[key].to_numpy().mean()) for name, own in groups(scores, "image")}
    # an undefined score is the first thing to look at
    return sorted(means, key=lambda n: (-np.inf if np.isnan(means[n]) else means[n], n))


def _image(table: Table, stored: dict[str, StoredResult], name: str) -> Shown | None:
    """Truth, render and error map of every row's first seed; None where no row has any."""
    shown = Shown(name=name, truth={}, render={}, error={})
    truths: dict[str, str] = {}
    for row in table.rows:
        source, sha = _source(row, stored, name)
        if source is None:
            continue
        if sha not in truths and (uri := _encoded(source, "truth", name)):
            truths[sha] = uri
        pictures = {
            "truth": truths.get(sha),
            "render": _encoded(source, "render", name),
            "error": _encoded(source, "error", name),
        }
        for kind, uri in pictures.items():
            if uri:
                getattr(shown, kind)[row.label] = uri
    return shown if shown.truth or shown.render else None


def _source(
    row: Row, stored: dict[str, StoredResult], name: str
) -> tuple[StoredResult | None, str]:
    """The first seed that was scored on the image, and the hash of its truth."""
    for result in row.results:
        for image in result.images:
            if image.name == name:
                return stored[run_data.case_key(result)], image.truth_sha256
    return None, ""


def _encoded(source: StoredResult, kind: Picture, name: str) -> str | None:
    png = source.picture(kind, name)
    where = f"{run_data.case_name(source.result)} {kind} of {name}"
    return None if png is None else encode(png, where)
