"""Where a training step's time goes: the trainer's own parts, timed while it works."""

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.terms import ImageTerm, Term

WHOLE = "rest"
"""What a step spends outside of all parts that have a name."""


class Stopwatch:
    """Seconds by part; what a part spends in another one counts as the other's."""

    def __init__(self) -> None:
        """Start with nothing."""
        self.seconds: dict[str, float] = {}
        self._inner: list[float] = []

    def timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, whose time is counted.

        Args:
            name: Name of the part.
            call: What it does.
        """

        def counted(*arguments: Any, **named: Any) -> Any:
            self._inner.append(0.0)
            begin = time.perf_counter()
            try:
                return call(*arguments, **named)
            finally:
                whole, inner = time.perf_counter() - begin, self._inner.pop()
                self.seconds[name] = self.seconds.get(name, 0.0) + whole - inner
                if self._inner:
                    self._inner[-1] += whole

        return counted


def shares(trainer: Trainer, steps: int) -> dict[str, float]:
    """Share of a step that each of its parts takes: medians over steps, brought to a sum of 1.

    Parts, in this order: prefilter (who is in view, where a model asks that apart), decode, render, finish (sky, exposure),
    each image term by its name, backward, statistics, update (the optimiser's), and the rest.

    Args:
        trainer: What takes the steps; it goes on from where they lead.
        steps: Number of steps, >= 1; one before them is not counted.
    """
    found: list[dict[str, float]] = []
    with watched(trainer) as watch:
        step = watch.timed(WHOLE, trainer.advance)
        for _ in range(steps + 1):
            watch.seconds.clear()
            step()
            total = sum(watch.seconds.values())
            found.append({name: spent / total for name, spent in watch.seconds.items()})
    last = ("backward", "statistics", "update", WHOLE)
    names = [name for name in found[-1] if name not in last]
    names += [name for name in last if name in found[-1]]
    middle = {
        name: statistics.median(each.get(name, 0.0) for each in found[1:]) for name in names
    }  # fmt: skip
    return {name: round(share / sum(middle.values()), 4) for name, share in middle.items()}


@contextmanager
def watched(trainer: Trainer) -> Iterator[Stopwatch]:
    """Time the parts of a trainer's steps inside.

    Args:
        trainer: Its parts are as before afterwards.
    """
    watch, model, backend = Stopwatch(), trainer.model, trainer.backend
    parts = [
        (model, "in_view", "prefilter"), (model, "splats", "decode"), (model, "finish_image", "finish"),
        (trainer, "backward", "backward"), (trainer.plan.density, "observe", "statistics"),
        (trainer, "update", "update"),
    ]  # fmt: skip
    terms = trainer.image_terms
    try:
        for owner, attribute, name in parts:
            if hasattr(owner, attribute):  # not every model asks who is in view
                setattr(owner, attribute, watch.timed(name, getattr(owner, attribute)))
        trainer.backend = replace(backend, rasterize=watch.timed("render", backend.rasterize))
        counted: list[ImageTerm] = [
            Term(name=term.name, weight=term.weight, loss=watch.timed(term.name, term.loss))
            for term in terms
        ]
        trainer.image_terms = counted
        yield watch
    finally:
        trainer.backend, trainer.image_terms = backend, terms
        for owner, attribute, _ in parts:
            with suppress(AttributeError):  # the class's own is there again
                delattr(owner, attribute)
