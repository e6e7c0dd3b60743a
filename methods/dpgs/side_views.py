"""Side views as views to train on: rendered, z-tested, refined and kept in rounds."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.reference.supervision.side_views import (
    EVIDENCE,
    HOLE,
    SOLID,
    SeenView,
    ViewRefiner,
    is_side_view_step,
    nearest_photo,
    sees,
)  # fmt: skip
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View, camera_view

Draw = Callable[[View], RenderOutput]
"""draw(view): the model as it is now, without gradient."""
Neutral = Callable[[View, Float[Tensor, "h w 3"]], Float[Tensor, "h w 3"]]
"""neutral(view, photo): the photo as the model shows it where no photo's exposure is asked for."""
KEPT = 8
"""Photos that a round keeps with what the model has at their cameras: neighbours on an orbit are guided by the same few."""
SIDE = "side view"
"""What the names of side views begin with."""


def as_it_is(view: View, photo: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
    """The photo itself, where a model has no exposures.

    Args:
        view: Whose photo it is.
        photo: Its colours.
    """
    return photo


class SideViews:
    """The side views of a run, made in rounds by the model as it is when a round is first asked for.

    A round is made whole and kept in one file, so that a run that was killed finds what it had: by
    its checkpoint it has either not begun the round, and makes the same again, or it finds it. A file that is
    damaged or holds something else is made again, by the model as it is then.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        photos: Sequence[View],
        draw: Draw,
        refine: ViewRefiner | None,
        folder: Path | None,
        told: Callable[[int, float], None],
        neutral: Neutral = as_it_is,
        *,
        holes: bool,
    ) -> None:
        """Nothing is rendered yet.

        Args:
            cameras: Where side views are taken from, at least one.
            photos: Training views.
            draw: Renders a view.
            refine: What makes a target of a render; None: the target is the render itself.
            folder: Where rounds are kept; it belongs to this run alone. None: in memory.
            told: Called with the number of a round and the share of its pixels that are trained on.
            neutral: Takes a photo's exposure from it: a render of a side view has none.
            holes: Whether pixels without a surface are trained on too.
        """
        self.cameras, self.photos, self.draw = tuple(cameras), tuple(photos), draw
        self.folder, self.told, self.neutral = folder, told, neutral
        self.refine, self.holes = refine, holes
        self._held: tuple[int, dict[str, Tensor]] | None = None

    def views(self, rounds: int) -> tuple[View, ...]:
        """All side views of the first round, then those of the next, ...

        Args:
            rounds: How many rounds a run may ask for.
        """
        return tuple(
            View(
                name=f"{SIDE} {index} of round {number}", camera=camera,
                load=partial(self._target, number, index),
                load_mask=partial(self._unproven, number, index),
            )
            for number in range(rounds)
            for index, camera in enumerate(self.cameras)
        )  # fmt: skip

    def _target(self, number: int, index: int) -> Float[Tensor, "h w 3"]:
        return self.round(number)["targets"][index].float() / 255

    def _unproven(self, number: int, index: int) -> Bool[Tensor, "h w"]:
        return self.round(number)["unproven"][index]

    def round(self, number: int) -> dict[str, Tensor]:
        """The targets (8 bits) and the pixels of a round that are trained on, made if it is not there.

        Args:
            number: From 0.
        """
        if self._held is None or self._held[0] != number:
            file = None if self.folder is None else self.folder / f"{number}.safetensors"
            made = self._found(file)
            if made is None:
                made = self._made(number)
                if file is not None:
                    write_tensors(file, made)
            self.told(number, float(made["unproven"].float().mean()))
            self._held = (number, made)
        return self._held[1]

    def _found(self, file: Path | None) -> dict[str, Tensor] | None:
        """The round that a file holds; None where there is none that fits these cameras."""
        if file is None or not file.is_file():
            return None
        try:
            found, _ = read_tensors(file)
        except DataError:  # cut short by a full disk: it can be made again
            return None
        lens = self.cameras[0]
        shape = (len(self.cameras), lens.height, lens.width)
        wanted = {"targets": (*shape, 3), "unproven": shape}
        return found if {name: tuple(t.shape) for name, t in found.items()} == wanted else None

    @torch.no_grad()
    def _made(self, number: int) -> dict[str, Tensor]:
        guide = Guide(self.photos, self.draw, self.neutral)
        targets, unproven = [], []
        for seen, proven, best in guide.of(self.cameras):
            target = self.refine(seen, guide.texture(best)) if self.refine else seen.image
            targets.append((target.clamp(0, 1) * 255).round().byte())
            unproven.append(~proven & (self.holes | (seen.alpha >= HOLE)))
        return {"targets": torch.stack(targets), "unproven": torch.stack(unproven)}


class Guide:
    """What a model's renders of side views are worth, and which photo guides the refinement of each."""

    def __init__(self, photos: Sequence[View], draw: Draw, neutral: Neutral = as_it_is) -> None:
        """Nothing is rendered yet.

        Args:
            photos: Training views, at least one.
            draw: Renders a view.
            neutral: Takes a photo's exposure from it.
        """
        self.photos, self.draw, self.neutral = photos, draw, neutral
        self.forward = torch.stack([photo.camera.rotation[2] for photo in photos]).double()
        self._textures: dict[int, SeenView] = {}

    @torch.no_grad()
    def of(self, cameras: Sequence[Camera]) -> Iterator[tuple[SeenView, Bool[Tensor, "h w"], int]]:
        """For each camera its render, the pixels that have evidence, and which photo sees most of it.

        Training views, which may be thousands, are rendered one after the other and not kept; of side views the
        maps of depth and alpha are, and each is rendered once more for its colours.

        Args:
            cameras: Where side views are taken from.
        """
        sides = [_without_image(self._side(camera)) for camera in cameras]
        counts = [torch.zeros(side.alpha.shape, dtype=torch.uint8) for side in sides]
        shared = torch.zeros(len(sides), len(self.photos), dtype=torch.float64)
        for index, photo in enumerate(self.photos):
            there = self._seen(photo)
            for row, side in enumerate(sides):
                seen = sees(there, side)
                counts[row] = (counts[row] + seen).clamp(max=EVIDENCE)
                shared[row, index] = seen.sum()
        for camera, count, row in zip(cameras, counts, shared, strict=True):
            side = self._side(camera)
            proven = (side.alpha >= SOLID) & (count >= EVIDENCE)
            yield side, proven, nearest_photo(row, self.forward, camera.rotation[2].double())

    @torch.no_grad()
    def texture(self, index: int) -> SeenView:
        """A photo in neutral exposure with what the model has at its camera; the last `KEPT` are not read again.

        Args:
            index: Which of the photos.
        """
        found = self._textures.pop(index, None)
        if found is None:
            photo = self.photos[index]
            found = replace(self._seen(photo), image=self.neutral(photo, photo.load()))
        self._textures[index] = found  # now the newest
        if len(self._textures) > KEPT:
            del self._textures[next(iter(self._textures))]
        return found

    def _side(self, camera: Camera) -> SeenView:
        output = self.draw(camera_view(camera, SIDE))
        return SeenView(
            camera=camera, image=output.colour.clamp(0, 1).cpu(), alpha=output.alpha.cpu(),
            depth=output.depth.cpu(),
        )  # fmt: skip

    def _seen(self, photo: View) -> SeenView:
        """What the model has at a photo's camera; what is masked there, such as a car, is no surface."""
        output = self.draw(photo.without_truth())
        alpha = output.alpha.cpu()
        if photo.load_mask is not None:
            alpha = alpha * photo.load_mask()
        return _without_image(
            SeenView(
                camera=photo.camera, image=output.colour, alpha=alpha, depth=output.depth.cpu()
            )
        )


def _without_image(view: SeenView) -> SeenView:
    return replace(view, image=torch.zeros(1).expand(*view.alpha.shape, 3))


class SideOrder:
    """Random epochs of photos; every n-th step of the second half begins with a side view."""

    def __init__(
        self, photos: int, sides: int, *, steps: int, every: int, refresh: int, views_per_step: int
    ) -> None:
        """Start before the first step.

        Args:
            photos: Number of photos, which come first among the views.
            sides: Number of side views of a round; rounds follow one another.
            steps: Steps of the run.
            every: Steps from one side view to the next; 0: none.
            refresh: Steps of a round.
            views_per_step: Views that a step draws.
        """
        self.photos, self.sides, self.steps, self.every = photos, sides, steps, every
        self.refresh, self.views_per_step = refresh, views_per_step
        self.drawn = 0
        self.left: list[list[int]] = [[], []]

    def next(self, generator: torch.Generator) -> int:
        """Index of the next view.

        Args:
            generator: Source of every draw.
        """
        step, place = divmod(self.drawn, self.views_per_step)
        self.drawn += 1
        asked = bool(self.every) and is_side_view_step(step, self.steps, self.every)
        if not (asked and place == 0 and self.sides):
            return self._epoch(0, self.photos, generator)
        number = (step - self.steps // 2) // self.refresh
        return self.photos + number * self.sides + self._epoch(1, self.sides, generator)

    @property
    def rounds(self) -> int:
        """Rounds that the whole run asks for."""
        half = self.steps - self.steps // 2
        return -(-half // self.refresh) if self.every and self.sides else 0

    def _epoch(self, kind: int, count: int, generator: torch.Generator) -> int:
        if not self.left[kind]:
            self.left[kind] = torch.randperm(count, generator=generator).tolist()
        return self.left[kind].pop()

    def coming(self) -> Iterator[int]:
        """What is left of the photos' epoch, the next one first; side views are drawn when their turn comes."""
        return reversed(self.left[0])

    def state(self) -> list[int]:
        """What is left of both epochs, and how many photos' there are of it."""
        photos, sides = self.left
        return [len(photos), *photos, *sides]

    def restore(self, state: list[int], drawn: int) -> None:
        """Go on where a run stopped.

        Args:
            state: What `state` returned then.
            drawn: Number of views that were drawn before.
        """
        count, *left = state
        self.left = [left[:count], left[count:]]
        self.drawn = drawn
