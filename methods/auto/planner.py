"""From facts, a machine's speed and a budget to settings, each with its reason."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.auto.base import Base
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.speed import Speed
from splatproof.methods.auto.steps import most_steps, steps_in, training_seconds
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.cost import training_memory_mb
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density, Pace
from splatproof.methods.training.resolution import Resolution

LEAST_SHORT_SIDE = 80
"""Pixels that the short side of a shrunk photo keeps: with fewer, what is learnt of it has to be unlearnt
(brighton_beach at 250 px loses 0.6 dB where it starts at a quarter; one seed)."""
FULL_FROM = 0.3
"""Share of the steps from which on photos have their full size."""
PIXELS_A_GAUSSIAN = 25
"""Pixels of all training photos together for each Gaussian, at least: with fewer it learns noise. Held-out training
photos of brighton_beach at 250 px, one seed: 25 pixels a Gaussian 19.2 dB after 3,000 steps, 3 pixels 18.3 dB
after as many, 7 pixels 18.8 dB after 1,500."""
PIXELS_A_POINT = 4
"""Pixels of one photo for each point that training starts from at most. Held-out training photos of seneca at 400 px,
1,000 steps, one seed: from 30,000 points 25.2 dB with 49,000 Gaussians, from all 62,785 (and twice the will to
grow) 25.3 dB with 129,000; caliterra loses 0.7 dB where it starts from 12,000 points of 24,715."""
GROWTH = Density(start=1500, gradient=4e-4, reset_interval=0, least_interval=100)
"""Density control of a run without opacity resets, which cost a short run more than they mend."""
PACE: Pace = "free"
"""How fast the number of Gaussians may come to its cap. Held-out training photos, two seeds: an even pace gains 0.2 to 0.8
dB in the tunnel and loses 0.5 to 0.9 dB on courtyard; with twice the will to grow, +0.3 to +0.4 and -0.5 to -0.6."""
WIDEST = 0.5
"""Largest scale as a share of the distance to the nearest training camera, see `ScaleBound`. Held-out training photos
of courtyard, three folds: a half gains 0.1 to 0.4 dB, a quarter and one between -0.4 and +0.2; one or two folds of six
other scenes: a half between -0.3 and +0.3."""
DROPOUT = 0.2
"""Share of the Gaussians that a step leaves out, against photos learnt by heart."""
DROPOUT_FROM = 60
"""How often each photo has to be looked at, as planned, for that to pay. Suite auto, test photos: at 250 looks dropout
gains 0.8 dB on brighton_beach at 250 px, at 150 it gains 0.6 there at 500 px, at 130 it gains 0.7 on courtyard and at 110
loses 0.1 in the tunnel (a seed each); at 30 it loses 0.6, 0.0 and 0.3 dB on caliterra, at 15 0.4 and 0.6 on seneca."""
LEAST_EXPOSURE = 0.02
"""Spread of the photos' brightness, natural logarithm, from which exposures are tried."""
RANDOM_POINTS = 10_000
"""Points that training starts from where structure from motion left none: drawn in sight of the cameras."""
LEAST_GAUSSIANS = 1000
"""Gaussians that a plan allows however few pixels there are."""
HEAD_BYTES, VIEW_BYTES = 4096, 64
"""Bytes of a saved model beside its Gaussians, and of each photo's exposure, at most."""
MEMORY_SHARE = 0.8
"""Share of the free memory that a plan takes: the estimate is right to a quarter."""
WORTH = 0.3
"""Decibels that a candidate has to gain in the probe over the usual value: a probe is short and small, and
on courtyard preferred by 0.3 dB what a whole run loses 0.9 dB with."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One thing that was chosen, and why."""

    component: str
    """What was chosen about training, e.g. "resolution"."""
    value: str
    """What it is, for people."""
    because: str
    """The measured fact behind it, or that it was given."""
    expects: str = ""
    """What it is expected to gain or save; "" where nothing was measured of it."""


@dataclass(frozen=True, kw_only=True)
class AutoPlan:
    """Settings for one scene, machine and budget, and the reasons."""

    settings: Settings
    base: Base
    """Method whose model is trained: `splatproof.methods.auto.base` says what follows of the settings."""
    choices: tuple[Choice, ...]
    seconds: float
    """Wall seconds that training is expected to take."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A value that competes in the probe."""

    setting: str
    """Name of the setting, see `AutoSettings`."""
    value: float | str
    because: str
    """Why it may be better here."""


def usual(asked: AutoSettings, facts: SceneFacts) -> Settings:
    """Settings before anything has competed: what is asked for, and what facts alone decide.

    Args:
        asked: The budget, and what is fixed.
        facts: What was measured.
    """
    return usual_for(asked, facts.width, facts.height)


def usual_for(asked: AutoSettings, width: int, height: int) -> Settings:
    """Settings that the size of the photos decides, and what is asked for.

    Args:
        asked: The budget, and what is fixed.
        width: Pixels of a photo.
        height: Pixels of a photo.
    """
    return Settings(
        iterations=asked.steps or 1000,
        sh_degree=3 if asked.sh_degree is None else asked.sh_degree,
        sh_interval=0,
        random_background=True,
        opacity_weight=0.01 if asked.opacity_weight is None else asked.opacity_weight,
        dropout=DROPOUT if asked.dropout is None else asked.dropout,
        widest=WIDEST if asked.widest is None else asked.widest,
        exposure=asked.exposure or "off",
        random_points=RANDOM_POINTS,
        dense_cell=asked.dense_cell or 0.0,
        most_points=max(1, width * height // PIXELS_A_POINT)
        if asked.most_points is None
        else asked.most_points,
        resolution=Resolution(coarsest=coarsest(width, height), full_from=FULL_FROM)
        if asked.coarsest is None
        else Resolution(coarsest=asked.coarsest, full_from=FULL_FROM),
        density=GROWTH if asked.gradient is None else replace(GROWTH, gradient=asked.gradient),
    )  # fmt: skip


def coarsest(width: int, height: int) -> float:
    """Largest power of two up to 8 by which photos can be shrunk and still show something.

    Args:
        width: Pixels of a photo.
        height: Pixels of a photo.
    """
    room = min(width, height) / LEAST_SHORT_SIDE
    return float(2 ** max(0, min(3, math.floor(math.log2(max(room, 1))))))


def candidates(asked: AutoSettings, facts: SceneFacts) -> list[Candidate]:
    """What competes with the usual settings, most promising first; nothing that is fixed.

    Only what short trainings can judge. How much is to be held back (opacity weight, dropout) they cannot:
    300 steps never learn photos by heart, so they liked none of it best, and a minute of brighton_beach at
    250 px without dropout then lost 0.7 dB to half a minute with the usual one.

    Args:
        asked: The budget, and what is fixed.
        facts: What was measured.
    """
    if asked.exposure is not None or not facts.exposure > LEAST_EXPOSURE:  # not known: nan
        return []
    return [Candidate(
        setting="exposure", value="gain",
        because=f"photos differ by {100 * math.expm1(facts.exposure):.0f} % in brightness",
    )]  # fmt: skip


def compete(
    settings: Settings,
    tried: Sequence[Candidate],
    score: Callable[[Settings], tuple[float, ...]],
    beats: Callable[[Sequence[float], Sequence[float], float], bool],
    left: Callable[[], bool],
) -> tuple[Settings, tuple[Choice, ...]]:
    """Try candidates one after the other, each against the best so far.

    Args:
        settings: The usual ones.
        tried: What competes.
        score: PSNR of each held-out view under some settings.
        beats: Whether scores are better than others by so many decibels.
        left: Whether there is time for one more.

    Returns: The settings with what won, and a choice for each setting that competed.
    """
    told: dict[str, list[str]] = {}
    best = score(settings) if tried and left() else ()
    for one in tried if best else ():
        if not left():
            break
        found = score(replace(settings, **{one.setting: one.value}))
        gain = sum(a - b for a, b in zip(found, best, strict=True)) / len(best)
        line = f"{one.value}: {gain:+.2f} dB on {len(best)} held-out training views"
        told.setdefault(one.setting, []).append(line)
        if beats(found, best, WORTH):
            settings, best = replace(settings, **{one.setting: one.value}), found
    return settings, tuple(
        Choice(
            component=name.replace("_", " "), value=str(getattr(settings, name)),
            because="probe: " + "; ".join(told[name])
            if name in told
            else "usual; no time to probe",
        )
        for name in dict.fromkeys(one.setting for one in tried)
    )  # fmt: skip


def most_gaussians(
    asked: AutoSettings, facts: SceneFacts, degree: int, free: float
) -> tuple[int, str]:
    """Cap on the number of Gaussians, and why.

    Args:
        asked: The budget.
        facts: What was measured.
        degree: Degree of the harmonics.
        free: Megabytes of this machine's memory that are free.
    """
    pixels = facts.views * facts.width * facts.height
    shown = (
        pixels // PIXELS_A_GAUSSIAN,
        f"all photos together have {pixels:,} pixels, {PIXELS_A_GAUSSIAN} a Gaussian",
    )
    most, why = min([shown, *_room(asked, facts, degree, free)])
    return max(1 if asked.megabytes else LEAST_GAUSSIANS, most), why


def _room(
    asked: AutoSettings, facts: SceneFacts, degree: int, free: float
) -> list[tuple[int, str]]:
    """Gaussians that fit into the file and into memory, and why; nothing where neither has a bound."""
    bounds = []
    if asked.megabytes:
        room = asked.megabytes * MEBIBYTE - HEAD_BYTES - VIEW_BYTES * facts.views
        fit = room / (4 * (11 + 3 * (degree + 1) ** 2))
        bounds.append((int(fit), f"what {asked.megabytes:g} MB hold"))
    if math.isfinite(free):
        none, one = (training_mb(facts, count, degree) for count in (0, 1))
        room = max(0.0, MEMORY_SHARE * free - none) / (one - none)
        bounds.append((int(room), f"what training may hold of {free:,.0f} MB of free memory"))
    return bounds


def bounded(asked: AutoSettings, settings: Settings, facts: SceneFacts, free: float) -> Settings:
    """Settings whose start has no more points than file and memory hold Gaussians: nothing takes the others away later.

    A file that holds fewer Gaussians than there are points gets harmonics of the highest degree with which it holds as many,
    or none. 1,500 steps, one seed, degrees 3, 2, 1 and 0: caliterra at 400 px in 0.5 MB 26.3, 27.1, 28.2 and 29.1 dB, in 2 MB 29.5,
    30.3, 31.1 and 31.9; brighton_beach at 250 px in 0.5 MB 21.0, 21.2, 21.0 and 21.7, in 2 MB, which hold all points, 22.4, 22.4,
    21.9 and 21.3.

    Args:
        asked: The budget.
        settings: What has been chosen.
        facts: What was measured.
        free: Megabytes of this machine's memory that are free.
    """
    points = min(facts.points, settings.most_points or facts.points)
    if asked.megabytes and asked.sh_degree is None:
        fitting = (
            degree for degree in range(settings.sh_degree, 0, -1)
            if _room(asked, facts, degree, math.inf)[0][0] >= points
        )  # fmt: skip
        settings = replace(settings, sh_degree=next(fitting, 0))
    fewest = 1 if asked.megabytes else LEAST_GAUSSIANS
    room = [max(fewest, most) for most, _ in _room(asked, facts, settings.sh_degree, free)]
    allowed = [] if settings.most_points is None else [settings.most_points]
    return replace(settings, most_points=min([*allowed, *room], default=None))


def training_mb(facts: SceneFacts, gaussians: int, degree: int) -> float:
    """Peak memory of a training process, 2^20 bytes.

    Args:
        facts: Number and size of the photos.
        gaussians: Number of Gaussians at the end.
        degree: Degree of the harmonics.
    """
    return training_memory_mb(
        float(gaussians), image_bytes=float(min(facts.image_bytes, Run.image_bytes)),
        pixels=float(facts.width * facts.height), sh_degree=degree,
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
    )  # fmt: skip


def plan(
    asked: AutoSettings,
    facts: SceneFacts,
    settings: Settings,
    choices: Sequence[Choice],
    speed: Speed,
    seconds: float,
    free: float = math.inf,
    base: Base = "3dgs",
) -> AutoPlan:
    """Number of Gaussians and of steps for the seconds that are left.

    Args:
        asked: The budget, and what is fixed.
        facts: What was measured.
        settings: What has been chosen.
        choices: Why.
        speed: How fast this machine trains such photos.
        seconds: Wall seconds that training may take.
        free: Megabytes of this machine's memory that are free; inf: not known, memory bounds nothing.
        base: What is trained.
    """
    most, why = most_gaussians(asked, facts, settings.sh_degree, free)
    if base == "stratosplat" and facts.points > most:
        most, why = facts.points, "one for each completed point"
    pace = asked.pace or PACE
    settings = replace(settings, density=replace(settings.density, most=most, pace=pace))
    told = list(choices)
    if math.isfinite(free):
        wanted, _ = most_gaussians(asked, facts, settings.sh_degree, math.inf)
        told.append(blocks(training_mb(facts, wanted, settings.sh_degree), free))
    start = min(facts.points, settings.most_points or facts.points)
    told.append(Choice(
        component="points", value=f"{start:,} of {facts.points:,}",
        because=f"a photo has {facts.width * facts.height:,} pixels",
    ))  # fmt: skip
    chosen = any(choice.component == "resolution" for choice in choices)
    if settings.resolution.coarsest > 1 and not chosen:
        share = settings.resolution.relative_pixels(1000)
        told.append(Choice(
            component="resolution", value=f"from 1/{settings.resolution.coarsest:g} of the photos' size",
            because=f"the shorter side keeps {LEAST_SHORT_SIDE} pixels",
            expects=f"{100 * (1 - share):.0f} % fewer pixels",
        ))  # fmt: skip
    told.append(Choice(
        component="Gaussians", value=f"at most {most:,}" + (", at an even pace" if pace == "even" else ""),
        because=why,
    ))  # fmt: skip
    told.append(Choice(
        component="largest scale",
        value=f"{settings.widest:g} of the distance to the nearest camera" if settings.widest else "no bound",
        because="given" if asked.widest is not None
        else "a wider Gaussian is drawn wrongly from beside it: one can veil a photo that nobody trained on",
    ))  # fmt: skip
    degree = settings.sh_degree
    told.append(Choice(
        component="harmonics", value=f"degree {degree}",
        because="given" if asked.sh_degree is not None
        else "of a higher one the file holds fewer Gaussians than there are points" if degree < 3
        else "colours may change with the direction they are seen from",
        expects=f"{4 * (11 + 3 * (degree + 1) ** 2)} bytes a Gaussian",
    ))  # fmt: skip
    if base != "pvg":
        told.append(Choice(
            component="opacity term", value=f"{settings.opacity_weight:g}" if settings.opacity_weight else "off",
            because="given" if asked.opacity_weight is not None
            else "what no photo needs shall fade" if settings.opacity_weight else "resets do its work",
        ))  # fmt: skip
    if asked.steps is None:
        count = steps_in(seconds, settings, facts, speed)
        bound, enough = most_steps(settings, facts.views, base)
        reason = (
            f"{seconds:.0f} s are left; a step takes {1e3 * speed.step(float(start)):.1f} ms at full size "
            f"with {start:,} points"
        )
        if count > bound:
            count, reason = bound, enough
    else:
        count, reason = asked.steps, "given"
    if asked.db:
        told.append(Choice(
            component="end", value=f"at {asked.db:g} dB, or with the last step",
            because="given; measured on training photos that are kept back",
        ))  # fmt: skip
    looks = count * settings.views_per_step / facts.views
    settings = replace(settings, iterations=count)
    told.append(Choice(
        component="steps", value=f"{count:,}", because=reason, expects=f"each photo {looks:.0f} times",
    ))  # fmt: skip
    if base == "3dgs":
        if asked.dropout is None and looks < DROPOUT_FROM:
            settings = replace(settings, dropout=0.0)
        told.append(Choice(
            component="dropout", value=f"{settings.dropout:g}" if settings.dropout else "off",
            because="given" if asked.dropout is not None
            else f"photos are learnt by heart where each is looked at {DROPOUT_FROM} times or more",
        ))  # fmt: skip
    return AutoPlan(
        settings=settings, base=base, choices=tuple(told),
        seconds=training_seconds(settings, facts, speed, count),
    )  # fmt: skip
