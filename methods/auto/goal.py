"""The end of a training that is to reach a quality: photos kept back, and when they are shown well enough."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from splatproof.base.errors import DataError
from splatproof.methods.auto.probe import HELD, psnr, valid_of
from splatproof.methods.auto.spreading import spread
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.reference.types.scene import Scene, View

MOST_HELD = 12
"""Most photos that are kept back: they are rendered again and again."""
CHECKS = 40
"""How often, about, a training of the planned length looks at them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptBack:
    """A scene without some of its training photos, and those."""

    scene: Scene
    """What is trained on."""
    views: tuple[View, ...]
    """Training views that training does not see."""


def keep_back(scene: Scene) -> KeptBack:
    """Keep every sixth training view back, spread over the scene's order: at least 1, at most `MOST_HELD`.

    Args:
        scene: The scene as a method gets it.

    Raises: DataError with fewer than four training views.
    """
    train = list(scene.train)
    if len(train) < 4:
        raise DataError(
            f"{scene.name}: {len(train)} training photos, expected at least 4: a quality is measured "
            "on photos that are kept back; leave db out"
        )
    held = spread(train, min(MOST_HELD, max(1, len(train) // HELD)))
    rest = tuple(index for index in train if index not in held)
    views = tuple(scene.views[index] for index in sorted(held))
    return KeptBack(scene=replace(scene, train=rest), views=views)


class Goal:
    """Ends a training as soon as the photos that were kept back reach a PSNR."""

    def __init__(
        self,
        kept: KeptBack,
        model: Model,
        *,
        least: float,
        steps: int,
        finish: Callable[[Model], Reconstruction],
        background: tuple[float, float, float],
        tell: Callable[[str], None],
        otherwise: Callable[[int, float], int | None] | None,
    ) -> None:
        """Look at a model in training.

        Args:
            kept: The photos that were kept back.
            model: What is trained; it changes with each step.
            least: Mean PSNR in dB at which training ends.
            steps: Number of steps that are planned.
            finish: What of a model in training is rendered.
            background: sRGB colour behind everything.
            tell: Told after each look, in words.
            otherwise: Says the number of steps where the goal does not end them; None: it stays.
        """
        self.kept, self.model, self.least = kept, model, least
        self.every = max(10, steps // CHECKS)
        self.finish, self.background = finish, torch.tensor(background)
        self.tell, self.otherwise = tell, otherwise

    def score(self) -> float:
        """Mean PSNR in dB of the photos that were kept back."""
        fitted = self.finish(self.model)
        found = []
        for view in self.kept.views:
            image = fitted.render(view.without_truth(), self.background).colour
            found.append(psnr(image, view.load(), valid_of(view)))
        return sum(found) / len(found)

    def __call__(self, step: int, seconds: float) -> int | None:
        """The number of steps of the whole training; `step` itself ends it.

        Args:
            step: Number of the step that was done.
            seconds: Wall seconds of training so far.
        """
        if step % self.every == 0:
            found = self.score()
            reached = found >= self.least
            word = "reached" if reached else "not reached"
            self.tell(
                f"{word}: {found:.2f} dB on {len(self.kept.views)} photos kept back after {step} steps, "
                f"{self.least:g} asked for"
            )
            if reached:
                return step
        return self.otherwise(step, seconds) if self.otherwise else None
