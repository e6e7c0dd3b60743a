"""A plan in words: each choice with its reason and what it is expected to bring, computed where it can be."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from splatproof.methods.auto import measured
from splatproof.methods.auto.base import Base
from splatproof.methods.auto.bounds import MEMORY_SHARE, file_mb, gaussian_bytes
from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed
from splatproof.methods.auto.steps import training_seconds
from splatproof.methods.auto.usual import (
    DROPOUT_FROM,
    GROWTH,
    LEAST_SHORT_SIDE,
    MANY_PHOTOS,
    ONE_LIGHT,
    learnt_by_heart,
)
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.schedules import Rates

BY_HEART = f"fewer than {MANY_PHOTOS} are looked at {DROPOUT_FROM} times or more each"
"""When photos are learnt by heart, in words."""


@dataclass(frozen=True, kw_only=True)
class Made:
    """What a plan came to."""

    asked: AutoSettings
    facts: SceneFacts
    settings: Settings
    """All of them, the number of steps too."""
    base: Base
    speed: Speed
    seconds: float
    """Wall seconds that training may take."""
    cap: str
    """Why there may be so many Gaussians."""
    steps: str
    """Why there are so many steps."""

    @property
    def start(self) -> int:
        """Points that training starts from."""
        return min(self.facts.points, self.settings.most_points or self.facts.points)

    @property
    def most(self) -> int:
        """Gaussians that there may be."""
        return max(self.settings.density.most or 0, self.start)

    @property
    def looks(self) -> float:
        """How often a photo is looked at."""
        return self.settings.iterations * self.settings.views_per_step / self.facts.views

    @property
    def by_heart(self) -> bool:
        """Whether photos are learnt by heart."""
        return learnt_by_heart(self.looks, self.facts.views)

    def takes(self, **otherwise: Any) -> float:
        """Wall seconds of the training, by the speed that was measured.

        Args:
            otherwise: Settings in place of the planned ones.
        """
        settings = replace(self.settings, **otherwise)
        return training_seconds(settings, self.facts, self.speed, self.settings.iterations)

    def spares(self, **otherwise: Any) -> str:
        """The seconds that as many steps would take longer, in words.

        Args:
            otherwise: Settings in place of the planned ones.
        """
        return f"{max(0.0, self.takes(**otherwise) - self.takes()):.0f} s saved"


def rows(made: Made, *, sized: bool) -> Iterator[Choice]:
    """Each choice that settings and facts say, in the order in which people ask.

    Args:
        made: What the plan came to.
        sized: Whether the size of the photos has been told of already.
    """
    yield points(made)
    if not sized:
        yield resolution(made)
    yield density(made)
    grows = made.settings.density
    if made.base == "3dgs" and (math.isfinite(grows.gradient) or grows.split_gradient):
        yield splitting(made)
    yield cap(made)
    yield largest_scale(made)
    yield thickness(made)
    yield harmonics(made)
    if made.base != "pvg":
        yield opacity_term(made)
    yield Choice(
        component="views a step", value=str(made.settings.views_per_step),
        because="with more of them fewer steps fit into the seconds",
    )  # fmt: skip
    if made.asked.db:
        yield Choice(
            component="end", value=f"at {made.asked.db:g} dB, or with the last step",
            because="given; measured on training photos that are kept back",
        )  # fmt: skip
    yield steps(made)
    if made.base != "pvg":
        yield rates(made)
    if made.base == "3dgs":
        yield dropout(made)
        yield Choice(
            component="anchors", value="none",
            because="they gained on four scenes and lost on four, and nothing measured before training tells which",
            expects=measured.ANCHORS,
        )  # fmt: skip


def blocks(needed: float, free: float) -> Choice:
    """One model or several: what does not fit into memory as one is trained in blocks, by another method.

    Args:
        needed: Megabytes that training takes with as many Gaussians as the photos bear.
        free: Megabytes of this machine's memory that are free.
    """
    fits = needed <= MEMORY_SHARE * free
    return Choice(
        component="blocks", value="one model" if fits else "one model, with fewer Gaussians than the photos bear",
        because=f"training takes {needed:,.0f} MB at most, and {free:,.0f} MB are free"
        + ("" if fits else "; method odbp+stitch trains blocks apart"),
        expects=f"{100 * needed / free:.0f} % of the free memory" if fits
        else f"{needed - MEMORY_SHARE * free:,.0f} MB saved",
    )  # fmt: skip


def points(made: Made) -> Choice:
    """How many points training starts from.

    Args:
        made: What the plan came to.
    """
    start, there = made.start, made.facts.points
    return Choice(
        component="points", value=f"{start:,} of {there:,}",
        because=f"a photo has {made.facts.width * made.facts.height:,} pixels",
        expects="none is left out" if start == there else made.spares(most_points=None),
    )  # fmt: skip


def resolution(made: Made) -> Choice:
    """How large photos are as training goes on.

    Args:
        made: What the plan came to.
    """
    found, given = made.settings.resolution, made.asked.coarsest is not None
    if found.coarsest > 1:
        share = found.relative_pixels(1000)
        gained = "" if given or made.base != "3dgs" else f"; {measured.SHRUNK}"
        return Choice(
            component="resolution", value=f"from 1/{found.coarsest:g} of the photos' size",
            because="given" if given else f"the shorter side keeps {LEAST_SHORT_SIDE} pixels",
            expects=f"{100 * (1 - share):.0f} % fewer pixels, {made.spares(resolution=Resolution())}{gained}",
        )  # fmt: skip
    why, expects = (
        f"half of the shorter side is less than {LEAST_SHORT_SIDE} pixels",
        measured.FULL_SIZE,
    )
    if given or made.base != "3dgs":
        why = "given" if given else "Gaussians that move have photos of one size"
        if made.base == "stratosplat" and not given:
            why = "completed depths are as fine as the photos"
        expects = NOT_MEASURED
    return Choice(component="resolution", value="full from the first step", because=why, expects=expects)  # fmt: skip


def density(made: Made) -> Choice:
    """Which Gaussians become more, and from which pull on.

    Args:
        made: What the plan came to.
    """
    pull = made.settings.density.gradient
    if math.isinf(pull) and not made.settings.density.split_gradient:
        return Choice(
            component="density", value="none: Gaussians do not become more", because="given"
        )
    low, high = (made.takes() * (factor - 1) for factor in measured.MCMC_SECONDS)
    gained = f"; {measured.GROWING} over half the will to grow" if pull == GROWTH.gradient else ""
    return Choice(
        component="density", value=f"by gradients, from a pull of {pull:g}",
        because="strategy mcmc gained 0.2 dB by the step and next to nothing by the second (docs/minute.md)"
        if made.asked.gradient is None else "given",
        expects=f"{low:.0f} to {high:.0f} s less than mcmc takes{gained}",
    )  # fmt: skip


def splitting(made: Made) -> Choice:
    """From which pull on large Gaussians are split.

    Args:
        made: What the plan came to.
    """
    split, given = made.settings.density.split_gradient, made.asked.split_gradient is not None
    differ = f"photos differ by {100 * math.expm1(made.facts.exposure):.1f} % in brightness"
    return Choice(
        component="splitting",
        value=f"large ones from {split:g} of absolute gradients" if split else "large ones as small ones are cloned",
        because="given" if given
        else "what is drawn too wide is pulled to and fro, which cancels where it is added; photos are of one light, and not learnt by heart" if split
        else f"does not pay where {BY_HEART}" if made.by_heart
        else "whether photos are of one light is not known" if math.isnan(made.facts.exposure)
        else f"{differ}, which pulls to and fro, too; {100 * math.expm1(ONE_LIGHT):.0f} % count as one light",
        expects=measured.SPLIT if split and not given else NOT_MEASURED,
    )  # fmt: skip


def cap(made: Made) -> Choice:
    """The most Gaussians.

    Args:
        made: What the plan came to.
    """
    found = made.settings.density
    megabytes = file_mb(made.most, made.settings.sh_degree, made.facts.views)
    return Choice(
        component="Gaussians",
        value=f"at most {made.most:,}" + (", at an even pace" if found.pace == "even" else ""),
        because=made.cap + ("" if made.most == found.most else f"; training starts from more than these {found.most or 0:,}"),
        expects=NOT_MEASURED if made.base == "pvg"
        else f"{megabytes:.1f} MB of file at most" + (" beside virtual Gaussians" if made.base == "stratosplat" else ""),
    )  # fmt: skip


def largest_scale(made: Made) -> Choice:
    """The bound on scales.

    Args:
        made: What the plan came to.
    """
    widest, near = made.settings.widest, made.settings.widest_at_points
    bounds = [
        f"{share:g} of the distance to the nearest camera{where}"
        for share, where in ((widest, ""), (near, " on start points"))
        if share
    ]
    return Choice(
        component="largest scale",
        value="; ".join(bounds) or "no bound",
        because="given" if made.asked.widest is not None
        else "a wider Gaussian is drawn wrongly from beside it: one can veil a photo that nobody trained on"
        + (", and faint ones over what is known in detail are fog from beside" if near else ""),
        expects=str(measured.BOUNDED) if made.asked.widest is None else NOT_MEASURED,
    )  # fmt: skip


def thickness(made: Made) -> Choice:
    """The bound on what reaches along rays.

    Args:
        made: What the plan came to.
    """
    thickest = made.settings.thickest
    given = made.asked.thickest is not None
    return Choice(
        component="thickness",
        value=f"{thickest:g} of the distance to the nearest camera" if thickest else "no bound",
        because="given" if given
        else "how far a Gaussian reaches along a photo's rays that photo does not see, but who looks from beside: as fog",
        expects=NOT_MEASURED if given else measured.FLATTENED,
    )  # fmt: skip


def harmonics(made: Made) -> Choice:
    """Degree of the spherical harmonics.

    Args:
        made: What the plan came to.
    """
    degree = made.settings.sh_degree
    other = 0 if degree == 3 else 3
    apart = abs(file_mb(made.most, degree, 0) - file_mb(made.most, other, 0))
    return Choice(
        component="harmonics", value=f"degree {degree}",
        because="given" if made.asked.sh_degree is not None
        else "of a higher one the file holds fewer Gaussians than there are points" if degree < 3
        else "colours may change with the direction they are seen from",
        expects=f"{gaussian_bytes(degree)} bytes a Gaussian, {apart:.1f} MB {'more' if degree == 3 else 'less'} than degree {other}",
    )  # fmt: skip


def opacity_term(made: Made) -> Choice:
    """Weight of the mean opacity in the loss.

    Args:
        made: What the plan came to.
    """
    weight, given = made.settings.opacity_weight, made.asked.opacity_weight is not None
    return Choice(
        component="opacity term", value=f"{weight:g}" if weight else "off",
        because="given" if given else "what no photo needs shall fade" if weight else "resets do its work",
        expects=str(measured.FADING) if weight and not given else NOT_MEASURED,
    )  # fmt: skip


def steps(made: Made) -> Choice:
    """How many steps there are.

    Args:
        made: What the plan came to.
    """
    spared = made.seconds - made.takes()
    rest = f", {spared:.0f} s not needed" if made.asked.steps is None and spared >= 1 else ""
    return Choice(
        component="steps", value=f"{made.settings.iterations:,}", because=made.steps,
        expects=f"each photo {made.looks:.0f} times{rest}",
    )  # fmt: skip


def rates(made: Made) -> Choice:
    """How fast everything but positions and opacities learns.

    Args:
        made: What the plan came to.
    """
    factor, given = made.settings.rates.sh_dc / Rates().sh_dc, made.asked.rates is not None
    larger = made.base == "3dgs" and not made.by_heart
    return Choice(
        component="rates",
        value="the release's" if factor == 1 else f"{factor:g} times the release's, falling in the second half",
        because="given" if given
        else "small steps do not get as far" if larger
        else "usual",
        expects=measured.QUICKER if larger and not given else NOT_MEASURED,
    )  # fmt: skip


def dropout(made: Made) -> Choice:
    """Share of the Gaussians that a step leaves out.

    Args:
        made: What the plan came to.
    """
    share, given = made.settings.dropout, made.asked.dropout is not None
    expects = (
        str(measured.DROPPING) if share
        else str(measured.UNLEARNT) if made.looks >= DROPOUT_FROM
        else measured.NO_DROPOUT
    )  # fmt: skip
    return Choice(
        component="dropout", value=f"{share:g}" if share else "off",
        because="given" if given
        else f"photos are learnt by heart where {BY_HEART}",
        expects=NOT_MEASURED if given else expects,
    )  # fmt: skip
