"""Which photos are trained on and how large, where the seconds do not hold all of them at full size."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import torch

from splatproof.datasets.truth_image import Truth
from splatproof.methods.auto.choices import Choice
from splatproof.methods.auto.probe import kept
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import VIEWS, Speed, measure
from splatproof.methods.auto.spreading import evenly
from splatproof.methods.auto.usual import usual_for
from splatproof.methods.contracts.run import Run
from splatproof.methods.training.image_room import READING_BYTES
from splatproof.methods.training.resolution import shrunk
from splatproof.methods.training.threads import threads
from splatproof.reference.types.scene import Scene, View

LARGE = 300_000
"""Pixels of a photo up to which all photos are trained on as they are: a minute holds thousands of steps of them."""
ENOUGH = 1250
"""Steps that are to fit: photos are halved until they do. Held-out photos at full size, one seed, in as many processor seconds
at full and at half size, before Gaussians were enlarged again (which gains 0.0 to 0.2 dB): caliterra (900 x 674) 250 and 500 steps
27.6 and 29.1 dB, 850 at half 30.8; 1,000 30.8, 1,700 at half 31.6; 1,700 31.9, 3,400 at half 32.1, 4,000 at a quarter 29.6. Seneca (808 x 603) 700
25.2, 2,400 at half 26.4. Brighton_beach (993 x 557) 600 18.5, 2,000 at half 19.7. A minute on two cores: seneca 1,919 steps 26.9, 2,663 at half 26.4."""
SHORT_SIDE = 300
"""Pixels that the short side of a photo keeps, however few steps fit; one that has fewer stays as it is."""
MEASURED = 400_000
"""Pixels that the photos have at most on which the speed of this machine is measured."""
COARSE = 0.76
"""Pixels of all steps as a share of what they would be at full size: photos are small at first."""
PIXELS_EACH = 5
"""Pixels of a photo for each Gaussian in the middle of a training, where there are not more of them from the start. A minute
ended with one for 8 pixels of seneca (808 x 603), for 12 of caliterra (900 x 674) and for 4 of brighton_beach (993 x 557)."""
READING = 0.3
"""Share of the seconds that reading large photos may take; of more photos some are left out, evenly."""
FEWEST = 12
"""Photos that are read however long it takes."""
BYTES = 12
"""Bytes of a pixel in memory: three float32."""
JPEG = frozenset({".jpg", ".jpeg"})
"""How the names of files end that are decoded at a part of their size."""


@dataclass(frozen=True, kw_only=True)
class Photos:
    """What is trained on."""

    factor: float = 1.0
    """Factor, >= 1, by which both sides of training photos are shrunk before anything looks at them: of small ones
    by less, see `own_factor`."""
    train: tuple[int, ...]
    """Indices of the training views that are read."""
    choices: tuple[Choice, ...] = ()
    """Each decision and why; none where nothing is left out."""
    readers: int | None = None
    """How many are read at once; None: that was not asked, as all are there as they are."""
    seconds: float = 0.0
    """Wall seconds that the decision took."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How photos are read."""

    each: float
    """Wall seconds in which one thread reads one."""
    readers: int
    """How many are read at once."""
    count: int
    """How many are read: no more than take `READING` of the seconds, where they are not the fewest."""

    @property
    def seconds(self) -> float:
        """Wall seconds of all of them."""
        return self.count * self.each / self.readers


def working(scene: Scene, photos: Photos) -> Scene:
    """The scene with the photos that are trained on, each as large as it is trained on.

    Args:
        scene: As a method gets it.
        photos: What was decided of it.
    """
    views = list(scene.views)
    if photos.factor > 1:
        for index in photos.train:
            views[index] = smaller(views[index], own_factor(views[index], photos.factor))
    return replace(scene, views=tuple(views), train=photos.train)


def own_factor(view: View, factor: float) -> float:
    """Factor by which one photo is shrunk: its short side keeps `SHORT_SIDE` pixels, or as many as it has.

    Args:
        view: One to train on.
        factor: Factor, >= 1, that the photo in the middle is shrunk by.
    """
    return max(1.0, min(factor, min(view.size) / SHORT_SIDE))


def smaller(view: View, factor: float) -> View:
    """As `shrunk`; a photo file is read at about that size, in a fraction of the time that all its pixels take.

    Args:
        view: One to train on.
        factor: Factor, >= 1, on both sides of the image.
    """
    small, load = shrunk(view, factor), view.load
    if not isinstance(load, Truth):
        return small
    return replace(small, load=partial(load.at, (small.camera.width, small.camera.height)))


def planned_photos(scene: Scene, asked: AutoSettings, run: Run) -> Photos:
    """Halve large photos until `ENOUGH` steps fit into the seconds, and read as many as can be read.

    A step of a photo of twelve million pixels takes half a second, and reading it as long: a minute at that size is
    a blur. Photos with priors, sweeps or sky masks keep their size, and so do all where the number of steps or
    `coarsest` is given.

    Args:
        scene: As a method gets it.
        asked: The budget.
        run: Threads, and bytes for photos in memory.

    Source: ours.
    """
    began = time.perf_counter()
    views = scene.train_views
    fixed = asked.steps is not None or asked.coarsest is not None
    if not views or fixed or any(map(_has_more, views)):  # whoever trains on none says so
        return Photos(train=scene.train)
    middle = middle_photo(views)
    pixels, short, points = _pixels(middle), min(middle.size), len(scene.points)
    if pixels <= LARGE:
        return Photos(train=scene.train)
    with threads(run.threads):
        shrink = max(1.0, math.sqrt(pixels / MEASURED))
        speed = _speed(scene, asked, run)
        speed = replace(speed, pixels=speed.pixels * shrink**2)
        reading = planned_reading(views, shrink, asked.seconds, run.image_bytes)
        left = asked.seconds - (time.perf_counter() - began) - reading.seconds
        factor = size_factor(
            pixels, points=points, speed=speed, seconds=left, most=max(1.0, short / SHORT_SIDE)
        )
        whole = left / step_seconds(pixels, 1.0, points, speed)
        reading = planned_reading(views, factor, asked.seconds, run.image_bytes)
    count, because, memory = reading.count, f"reading one takes {reading.each:.2f} s", ""
    if factor > 1:  # else reading one again takes no longer than a step
        wanted, full = factor, f"{run.image_bytes >> 20:,} MB hold no more"
        factor, fitting = _in_memory(count, pixels, factor, short, run.image_bytes)
        if fitting < count:
            count, because = fitting, full
        if factor > wanted:
            memory = f"; {full} of {reading.count} photos"
    left = asked.seconds - (time.perf_counter() - began) - count * reading.each / reading.readers
    small = left / step_seconds(pixels, factor, points, speed)
    told = []
    if factor > 1:
        height, width = middle.size
        told.append(Choice(
            component="photos' size", value=f"1/{factor:g} of {width:,} x {height:,} pixels",
            because=_why(whole, reading, asked.seconds) + memory,
            expects=f"about {small:.0f} steps" if small >= 1 else "hardly any step",
        ))  # fmt: skip
    if count < len(views):
        saved = (len(views) - count) * reading.each / reading.readers
        told.append(Choice(
            component="photos", value=f"{count} of {len(views)}, evenly", because=because,
            expects=f"{saved:.0f} s of reading saved",
        ))  # fmt: skip
    spent = time.perf_counter() - began
    return Photos(
        factor=factor, train=evenly(scene.train, count), choices=tuple(told),
        readers=reading.readers, seconds=spent,
    )  # fmt: skip


def _why(whole: float, reading: Reading, seconds: float) -> str:
    """Why photos are made smaller, in words.

    Args:
        whole: Steps that fit at full size; below 0 where reading alone takes longer than the seconds.
        reading: How photos are read.
        seconds: Wall seconds of the budget.
    """
    if whole <= 0:
        return f"reading {reading.count} photos takes {reading.seconds:.0f} s of {seconds:g}"
    return f"at full size about {whole:.0f} steps would fit, and {ENOUGH:,} are wanted"


def _in_memory(count: int, pixels: int, factor: float, short: int, room: int) -> tuple[float, int]:
    """The factor at which memory holds so many photos, where their short side allows it, and how many it holds."""

    def fitting() -> int:
        return int(room / (pixels / factor**2 * BYTES))

    while fitting() < count and short / (2 * factor) >= SHORT_SIDE:
        factor *= 2
    return factor, max(FEWEST, fitting())


def planned_reading(
    views: Sequence[View], factor: float, seconds: float, image_bytes: int
) -> Reading:
    """How many photos are read, and how long that takes.

    Args:
        views: What may be read, at least one.
        factor: Factor by which they are shrunk, >= 1.
        seconds: Wall seconds of the budget.
        image_bytes: Bytes for photos.
    """
    each, readers = read_seconds(views, factor), reading_threads(factor, views, image_bytes)
    readable = max(FEWEST, int(READING * seconds * readers / each))
    return Reading(each=each, readers=readers, count=min(len(views), readable))


def read_seconds(views: Sequence[View], factor: float) -> float:
    """Wall seconds in which one thread reads the photo in the middle, so many times smaller.

    Args:
        views: At least one.
        factor: Factor by which it is shrunk, >= 1.
    """
    began = time.perf_counter()
    view = middle_photo(views)
    (view if factor == 1 else smaller(view, factor)).load()
    return time.perf_counter() - began


def middle_photo(views: Sequence[View]) -> View:
    """The photo in the middle, by number of pixels.

    Args:
        views: At least one.
    """
    return sorted(views, key=_pixels)[len(views) // 2]


def reading_threads(factor: float, views: Sequence[View], image_bytes: int) -> int:
    """How many photos may be read at once: no more than what reading them takes fits into the bytes for photos.

    Args:
        factor: Factor by which each is shrunk.
        views: What is read.
        image_bytes: Bytes for photos.
    """
    largest = max((_decoded(view, own_factor(view, factor)) for view in views), default=1.0)
    return max(1, min(torch.get_num_threads(), int(image_bytes / (READING_BYTES * largest))))


def _decoded(view: View, factor: float) -> float:
    """Pixels of a photo in memory while it is read so many times smaller: a JPEG file has up to twice as many on a
    side, and not below an eighth of its own; all others have all of theirs."""
    jpeg = isinstance(view.load, Truth) and view.load.path.suffix.lower() in JPEG
    return _pixels(view) * (min(1.0, max(4 / factor**2, 1 / 64)) if jpeg and factor > 1 else 1.0)


def _pixels(view: View) -> int:
    return view.camera.width * view.camera.height


def size_factor(pixels: int, *, points: int, speed: Speed, seconds: float, most: float) -> float:
    """Least power of two by which photos are shrunk so that `ENOUGH` steps fit.

    Args:
        pixels: Pixels of a photo.
        points: Points to start from.
        speed: As it is on photos at full size.
        seconds: Wall seconds of training.
        most: Largest factor, >= 1.

    Returns: A power of two of at most `most`, the largest where even that is not enough.
    """
    factor = 1.0
    while 2 * factor <= most and seconds / step_seconds(pixels, factor, points, speed) < ENOUGH:
        factor *= 2
    return factor


def step_seconds(pixels: int, factor: float, points: int, speed: Speed) -> float:
    """Wall seconds of a step, in the mean over a training.

    Args:
        pixels: Pixels of a photo at full size.
        factor: Factor by which it is shrunk.
        points: Points to start from: twice as many Gaussians are there in the middle, or one for `PIXELS_EACH` pixels.
        speed: As it is on photos at full size.
    """
    seen = pixels / factor**2
    gaussians = min(max(2 * points, seen / PIXELS_EACH), seen / 2)
    return COARSE * speed.step(0.0, factor) + speed.gaussian * gaussians


def _has_more(view: View) -> bool:
    """Whether a view has what would be lost with its size."""
    return any(load is not None for load in (view.load_prior, view.load_sweep, view.load_sky))


def _speed(scene: Scene, asked: AutoSettings, run: Run) -> Speed:
    """How fast steps on a few photos of `MEASURED` pixels are, or as many as they have."""
    few = evenly(scene.train, VIEWS)
    views = list(scene.views)
    for index in few:
        factor = max(1.0, math.sqrt(_pixels(views[index]) / MEASURED))
        views[index] = kept(smaller(views[index], factor))
    width, height = views[few[0]].camera.width, views[few[0]].camera.height
    small = replace(scene, views=tuple(views), train=few)
    return measure(small, usual_for(asked, width, height), run)
