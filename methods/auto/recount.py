"""How many steps there will be, told anew while a training goes on, by the speed that it turns out to have."""

from collections.abc import Callable

from splatproof.methods.auto.steps import LEAST_STEPS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.schedules import restarts, shrink

MEASURED = 30
"""Steps over which a speed is measured."""
SETTLED = 0.1
"""Share of the steps after which it is looked at first: by then photos are in memory."""
LACKING = 0.9
"""Share of the steps to come that has to fit while Gaussians become more; where fewer fit, the machine is slower than planned."""


class Recount:
    """How many steps there will be, told when the number of Gaussians and the speed are known.

    Before, both were guesses; densification is over then, and photos have the size of the last step. Until then steps are only
    taken away, as soon as photos have that size: where those to come would not fit even if no Gaussian were added.
    A machine that became slower is so no reason to take longer than was asked for.
    """

    def __init__(
        self, settings: Settings, seconds: float, most: int, tell: Callable[[int], None]
    ) -> None:
        """Wait until photos have the size of the last step.

        Args:
            settings: What is trained.
            seconds: Wall seconds that training may take in all.
            most: Most steps that are told.
            tell: Told the new number of steps.
        """
        self.planned = steps = settings.iterations
        begun = max((0, *restarts(steps, settings.rounds)))
        grown = begun + round(settings.density.stop * shrink(settings.round_steps))
        factors = [settings.resolution.factor(step, steps) for step in range(1, steps + 1)]
        whole = factors.index(factors[-1])
        self.first = min(max(grown, whole) + 1, steps)
        self.next = min(max(whole, int(SETTLED * steps)) + 1, self.first)
        self.seconds, self.most, self.tell = seconds, most, tell
        self.since, self.began = 0, 0.0
        self.growing: bool | None = None

    def __call__(self, step: int, seconds: float) -> int | None:
        """The number of steps, after `MEASURED` steps at the final speed and whenever half of the rest is done.

        Args:
            step: Number of the step that was done.
            seconds: Wall seconds of training so far.
        """
        if seconds >= self.seconds and step >= LEAST_STEPS:
            return self._told(step)
        if step < self.next:
            return None
        growing = step < self.first
        if growing != self.growing:
            self.growing = growing
            self._measure_from(step, seconds)
            return None
        each = max(1e-6, (seconds - self.began) / (step - self.since))
        left = max(0, int((self.seconds - seconds) / each))
        if growing:
            self._measure_from(step, seconds)
            fits = left >= LACKING * (self.planned - step)
            return self._told(self.planned if fits else step + left)
        self.next = step + max(MEASURED, left // 2)
        return self._told(max(step, min(step + left, self.most)))

    def _measure_from(self, step: int, seconds: float) -> None:
        self.since, self.began, self.next = step, seconds, step + MEASURED
        if self.growing:
            self.next = min(self.next, self.first)

    def _told(self, steps: int) -> int:
        self.tell(steps)
        return steps
