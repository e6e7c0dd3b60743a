"""Settings before anything has competed: what is asked for, and what the size of the photos decides."""

import math
from dataclasses import replace

from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density, Pace
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.schedules import Rates

LEAST_SHORT_SIDE = 80
"""Pixels that the short side of a shrunk photo keeps: with fewer, what is learnt of it has to be unlearnt
(brighton_beach at 250 px loses 0.6 dB where it starts at a quarter; one seed)."""
FULL_FROM = 0.3
"""Share of the steps from which on photos have their full size."""
PIXELS_A_POINT = 4
"""Pixels of one photo for each point that training starts from at most. Held-out training photos of seneca at 400 px,
1,000 steps, one seed: from 30,000 points 25.2 dB with 49,000 Gaussians, from all 62,785 (and twice the will to
grow) 25.3 dB with 129,000; caliterra loses 0.7 dB where it starts from 12,000 points of 24,715."""
GROWTH = Density(start=1500, gradient=4e-4, reset_interval=0, least_interval=100)
"""Density control of a run without opacity resets, which cost a short run more than they mend."""
SPLITTING = 4.0
"""Sum of absolute gradients from which a large Gaussian is split, in pulls from which a small one is cloned (AbsGS: 2), where photos
are of one light and not learnt by heart. Held-out training photos, as many steps, seeds in order: +0.5 and +0.3 dB on
caliterra (44 looks), +0.9, +0.2 and +0.4 on courtyard (45), +0.4 and +0.5 on city (40), +0.3 and +0.6 on street without motion (38),
SSIM +0.007 to +0.018, for 1.1 to 1.5 times as many Gaussians. Looked at 136 and 80 times
it gains 0.0 and 0.0 on courtyard and 0.3 and 0.3 on city by the step, but in the same minute, test photos, three seeds, -0.2 and 0.0."""
ONE_LIGHT = 0.126
"""Spread of the photos' brightness, natural logarithm, up to which they count as of one light. Where it is larger a Gaussian is
pulled to and fro for other reasons than detail, and splitting by that gains nothing: +0.1 and -0.3 dB on seneca (0.128 to 0.136, by the size of its
photos), -0.3 and -0.3 in the tunnel (0.232), -0.1 and -0.1 on brighton_beach at 250 px (0.155); caliterra, which gains by it, has 0.122 to
0.124, made worlds in daylight less than 0.01. On all their photos, not 24, caliterra has 0.116 and seneca 0.120: these two it hardly tells apart."""
PACE: Pace = "free"
"""How fast the number of Gaussians may come to its cap. Held-out training photos, two seeds: an even pace gains 0.2 to 0.8
dB in the tunnel and loses 0.5 to 0.9 dB on courtyard; with twice the will to grow, +0.3 to +0.4 and -0.5 to -0.6."""
WIDEST = 0.5
"""Largest scale as a share of the distance to the nearest training camera, see `ScaleBound`. Held-out training photos
of courtyard, three folds: a half gains 0.1 to 0.4 dB, a quarter and one between -0.4 and +0.2; one or two folds of six
other scenes: a half between -0.3 and +0.3."""
WIDEST_AT_POINTS = 0.2
"""The same on start points where learning is `QUICKER`, whose faint wide Gaussians hang over a city as fog. The made city looked at
57 times, suite unseen, three seeds, with both bounds on shape, with neither and with the release's rates: 20.6, 19.0 and
20.5 dB of what photos show, FLIP 0.330, 0.398 and 0.327. Test photos of a minute lose 0.2 dB on seneca and 0.3 on caliterra."""
THICKEST = 0.03
"""Largest extent along the ray to the nearest training camera as a share of its length, see `ThicknessBound`. Held-out
training photos, as many steps: +0.1, -0.3 and +0.5 dB on seneca, -0.2, 0.0 and +0.1 on caliterra, +0.2 and +0.2 on
courtyard, +0.1 and +0.2 on brighton_beach at 250 px, +0.2 and +0.6 in the tunnel, +0.2 on city, -0.4 on street without motion (a
seed each); a third of it gains between -0.4 and +0.4."""
DROPOUT = 0.2
"""Share of the Gaussians that a step leaves out, against photos learnt by heart."""
DROPOUT_FROM = 60
"""How often each photo has to be looked at, as planned, for that to pay. Suite auto, test photos: at 250 looks dropout
gains 0.8 dB on brighton_beach at 250 px, at 150 it gains 0.6 there at 500 px, at 130 it gains 0.7 on courtyard and at 110
loses 0.1 in the tunnel (a seed each); at 30 it loses 0.6, 0.0 and 0.3 dB on caliterra, at 15 0.4 and 0.6 on seneca."""
MANY_PHOTOS = 25
"""Training photos from which on none is learnt by heart, however often each is looked at: see `learnt_by_heart`. What
`by_larger_steps` gains in PSNR and SSIM, held-out training photos, as many steps, seeds in order. Many photos: tunnel (35, looked at 71 times)
+2.9 dB and +0.017, (114) +2.2, +1.4 and +0.012, +0.007; seneca (120, 67) +0.5 and +0.012; caliterra (55, 73) +0.3, -0.1 and +0.013, +0.014; city
(25, 160) 0.0, 0.0 and +0.012, +0.010. Few: courtyard (20, 130) -0.4, 0.0 and +0.008, +0.011; brighton_beach at 500 px (15, 80) -0.4 and +0.005, (167)
-0.6, -0.6 and -0.008, -0.010, at 250 px (15, 250) -0.7 and -0.013; aerial-sparse/town (9, 333) -0.6 and -0.002."""
QUICKER = 4.0
"""Factor on the learning rates of everything but positions and opacities where photos are not
learnt by heart. Held-out training photos, as many steps, one seed: seneca (11 looks) 24.3 dB with the release's rates, 25.1,
25.2, 25.7 and 25.7 with 2, 3, 4 and 6 times these, 25.1 with 8 times; with 4, city (40 looks) +1.3 dB for half as many Gaussians again,
caliterra (44) +0.3, courtyard (45) -0.1 and SSIM +0.02, brighton_beach at 500 px (47) +0.05; the tunnel, looked at 143 times, -1.2, and city at 160
-0.6, before what else `by_larger_steps` has today, see `MANY_PHOTOS`."""
SETTLE = 0.1
"""Factor on learning rates that are not the release's, at the last step. Seneca with 3 times the rates: 24.8 dB where they
stay, 25.2 where they settle; the release's rates lose 0.3 dB where they settle."""
RANDOM_POINTS = 10_000
"""Points that training starts from where structure from motion left none: drawn in sight of the cameras."""


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
        widest_at_points=asked.widest_at_points or 0.0,
        thickest=THICKEST if asked.thickest is None else asked.thickest,
        exposure=asked.exposure or "off",
        rates=quicker(1.0 if asked.rates is None else asked.rates),
        random_points=RANDOM_POINTS,
        dense_cell=asked.dense_cell or 0.0,
        most_points=max(1, width * height // PIXELS_A_POINT)
        if asked.most_points is None
        else asked.most_points,
        resolution=Resolution(coarsest=coarsest(width, height), full_from=FULL_FROM)
        if asked.coarsest is None
        else Resolution(coarsest=asked.coarsest, full_from=FULL_FROM),
        density=growth(asked),
    )  # fmt: skip


def growth(asked: AutoSettings) -> Density:
    """Density control before a cap is known.

    Args:
        asked: What is fixed.
    """
    pull = GROWTH.gradient if asked.gradient is None else asked.gradient
    return replace(GROWTH, gradient=pull, split_gradient=asked.split_gradient or 0.0)


def learnt_by_heart(looks: float, photos: int) -> bool:
    """Whether a training learns what its photos show and no other would: few of them, looked at often.

    Args:
        looks: How often each photo is looked at.
        photos: Number of training photos.
    """
    return looks >= DROPOUT_FROM and photos < MANY_PHOTOS


def by_larger_steps(settings: Settings, asked: AutoSettings, exposure: float) -> Settings:
    """Settings of a training that does not learn photos by heart: nothing needs to be dropped out, and larger steps get
    further; they need narrower bounds. Detail has to come soon.

    Args:
        settings: As of one that does.
        asked: What is fixed.
        exposure: Spread of the photos' brightness, natural logarithm; nan: not known.
    """
    pull = settings.density.gradient
    splits = asked.split_gradient is None and exposure <= ONE_LIGHT and math.isfinite(pull)
    foggy = asked.widest_at_points is None and (asked.rates is None or asked.rates > 1)
    return replace(
        settings,
        dropout=0.0 if asked.dropout is None else settings.dropout,
        widest_at_points=WIDEST_AT_POINTS if foggy else settings.widest_at_points,
        rates=quicker(QUICKER) if asked.rates is None else settings.rates,
        density=replace(settings.density, split_gradient=SPLITTING * pull)
        if splits
        else settings.density,
    )


def quicker(factor: float) -> Rates:
    """Learning rates of everything but positions and opacities times a factor, which settle in the end.

    Args:
        factor: >= 0; 1: the release's rates, which stay as they are.
    """
    if factor == 1:
        return Rates()
    usual_rates = Rates()
    scaled = {
        name: factor * getattr(usual_rates, name)
        for name in ("sh_dc", "sh_rest", "log_scales", "quaternions")
    }
    return Rates(**scaled, settle=SETTLE)


def coarsest(width: int, height: int) -> float:
    """Largest power of two up to 8 by which photos can be shrunk and still show something.

    Args:
        width: Pixels of a photo.
        height: Pixels of a photo.
    """
    room = min(width, height) / LEAST_SHORT_SIDE
    return float(2 ** max(0, min(3, math.floor(math.log2(max(room, 1))))))
