"""Whether depths are completed before training, and virtual Gaussians fill what few photos do not show."""

import math
from collections.abc import Callable
from dataclasses import replace

from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.measured import COMPLETED, EXPLICIT
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.usual import coarsest
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.resolution import Resolution

FEW = 12
"""Photos up to which depths are completed: nobody tried it with more, and each costs a third of a second."""
SEEN = 4.0
"""Photos that see a place, in the mean, from which on nothing is completed. SSIM of held-out photos with completed
depths less without, in a minute each, one seed: seen by 2.0 (seneca, six photos) -0.01, 2.2 (caliterra, six) +0.02, 2.5
(brighton_beach, six) +0.03, 2.8 (aerial-sparse/town, three) -0.01; suite sparse, three seeds, by 2.7 to 3.0 (houses, church,
mountain, stadium from three views) +0.01 to +0.13; by 4.8 (courtyard, six) -0.01 and 6.4 (town, seven) -0.01. Where SSIM
is level the eye still prefers completed depths: what they do not know is blurred, and not what they know besides. PSNR
prefers smears: by 0.6 dB from six photos of brighton_beach, whose trees are there with completed depths alone."""
DOWN = 0.5
"""Least cosine of a view's direction and straight down: the planes of virtual Gaussians lie along the ground. Street,
whose cameras look ahead, loses 0.07 in SSIM."""
LEAST = 100
"""Steps that completed depths need; with fewer a grey haze is left. Six photos, one seed, PSNR and SSIM after 60 and after
100 steps (without resets), and of explicit Gaussians after as many processor seconds as those 60 take: caliterra
20.2 (0.73), 23.9 (0.76) and 21.5 (0.70), brighton_beach 14.9 (0.40), 16.6 (0.46) and 11.3 (0.32)."""
ENOUGH = 300
"""Steps for which photos are made smaller where fewer fit at full size. Six photos, one seed, 200, 300, 450 and 700 steps:
caliterra 24.6, 24.8, 24.8 and 24.9 dB, brighton_beach 17.4, 17.5, 17.5 and 17.6 dB. Six photos of caliterra at 900 x 674, 250 steps
on photos of half that side: 25.5 dB, and as much with full size in the last fifth of the steps."""
RESETS_FROM = 200
"""Steps from which opacities are reset. Six photos of brighton_beach, one seed, with resets less without: 60 steps -1.2
dB, 100 steps -0.8 dB, 200 steps +0.4; 100 steps of caliterra -1.8 dB."""
DROPOUT = 0.5
"""Share of the explicit Gaussians that the last step hides, see row `stratosplat@regularised` of suite sparse."""


def planned_completion(
    asked: AutoSettings, facts: SceneFacts, *, points: int, moves: bool
) -> tuple[bool, tuple[Choice, ...]]:
    """Complete the depth of each photo where few photos from the air see each place.

    Args:
        asked: The budget; `completed` may be fixed.
        facts: What was measured.
        points: Number of the scene's own points: without any nothing says how far away anything is.
        moves: Whether Gaussians move: then nothing is completed.

    Source: ours; what is done: StratoSplat, Sec. 3.
    """
    told = f"each place is in {facts.coverage:.1f} of {facts.views} photos"
    if asked.completed is not None:
        return asked.completed, (_choice(asked.completed, "given"),)
    if moves or facts.views > FEW:
        return False, ()  # nobody would expect it
    if not points:
        return False, (_choice(False, "the scene has no point"),)
    if not facts.coverage < SEEN:
        return False, (_choice(False, told, str(EXPLICIT)),)
    if facts.down < DOWN:
        angle = math.degrees(math.acos(max(-1.0, facts.down)))
        return False, (
            _choice(False, f"a photo looks {angle:.0f} degrees away from straight down"),
        )
    if asked.megabytes:
        return False, (_choice(False, "megabytes is given, and virtual Gaussians alone take 5"),)
    return True, (_choice(True, told, f"{COMPLETED}; the pictures are better"),)


def too_slow(steps: int) -> Choice:
    """Nothing is completed after all: so few steps would leave a haze, and more of them fit without.

    Args:
        steps: Steps that fit into the seconds that are left.
    """
    return _choice(False, f"about {steps} steps would fit, and {LEAST} are needed")


def sized(
    settings: Settings, facts: SceneFacts, steps: Callable[[Settings], int]
) -> tuple[Settings, tuple[Choice, ...]]:
    """Photos as large as they can be where `ENOUGH` steps are to fit, by halves; at their own size with a choice of none.

    Args:
        settings: As `completing` left them.
        facts: Size of the photos.
        steps: How many steps fit under some settings.
    """
    whole = count = steps(settings)
    factor, most = 1.0, coarsest(facts.width, facts.height)
    while count < ENOUGH and factor < most:
        factor *= 2
        settings = replace(settings, resolution=Resolution(coarsest=factor, full_from=1.0))
        count = steps(settings)
    if factor == 1:
        return settings, ()
    return settings, (Choice(
        component="resolution", value="1/2 of the photos' size" if factor == 2 else f"from 1/{factor:g} of the photos' size to 1/2",
        because=f"at full size about {whole} steps would fit, and {ENOUGH} are wanted",
        expects=f"about {count} steps",
    ),)  # fmt: skip


def shortened(settings: Settings, steps: int) -> Settings:
    """Settings for so many steps from completed depths: in a short run nothing has time to grow back after a reset.

    Args:
        settings: As `completing` left them.
        steps: Number of steps.
    """
    if steps >= RESETS_FROM:
        return settings
    return replace(settings, density=replace(settings.density, reset_interval=0))


def _choice(done: bool, because: str, expects: str = NOT_MEASURED) -> Choice:
    return Choice(
        component="completed depths",
        value="of each photo, and virtual Gaussians (as method stratosplat's)" if done else "none",
        because=because, expects=expects,
    )  # fmt: skip


def completing(settings: Settings, asked: AutoSettings) -> Settings:
    """Settings for completed depths: as those of 3dgs were planned, but for what StratoSplat does otherwise.

    It starts with a Gaussian for every few pixels, so that density control has little to add, and its opacity resets
    are what clears away wrong depths.

    Args:
        settings: As they would be of method 3dgs.
        asked: What is fixed stays.
    """
    return replace(
        settings, sh_interval=1000, most_points=asked.most_points,
        opacity_weight=asked.opacity_weight or 0.0,
        dropout=DROPOUT if asked.dropout is None else asked.dropout,
        resolution=Resolution() if asked.coarsest is None else settings.resolution,
        density=Density(**{
            name: value for name in ("gradient", "split_gradient") if (value := getattr(asked, name)) is not None
        }),
    )  # fmt: skip
