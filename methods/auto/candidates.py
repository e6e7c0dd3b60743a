"""Settings that compete in short trainings, and which of them win."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.measured import UNEXPOSED
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.threedgs.settings import Settings

LEAST_EXPOSURE = 0.02
"""Spread of the photos' brightness, natural logarithm, from which exposures are tried."""
WORTH = 0.3
"""Decibels that a candidate has to gain in the probe over the usual value: a probe is short and small, and
on courtyard preferred by 0.3 dB what a whole run loses 0.9 dB with."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A value that competes in the probe."""

    setting: str
    """Name of the setting, see `AutoSettings`."""
    value: float | str
    because: str
    """Why it may be better here."""
    without: str = NOT_MEASURED
    """What going without it has gained elsewhere."""


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
        setting="exposure", value="gain", without=str(UNEXPOSED),
        because=f"photos differ by {100 * math.expm1(facts.exposure):.0f} % in brightness",
    )]  # fmt: skip


def compete(
    settings: Settings,
    tried: Sequence[Candidate],
    score: Callable[[Settings, int], tuple[float, ...]],
    beats: Callable[[Sequence[float], Sequence[float], float], bool],
    left: Callable[[int], bool],
) -> tuple[Settings, tuple[Choice, ...]]:
    """Try candidates one after the other, each against the best so far; one that wins both once more, by other draws.

    Draws alone move what a candidate gains by 0.3 dB (exposures of seneca, six seeds: -0.3 to +0.4 dB, and the run of
    that +0.4 ended 0.5 dB below the others): it has to win by both trainings together, if there is time for them.

    Args:
        settings: The usual ones.
        tried: What competes.
        score: PSNR of each held-out view under some settings, by the draws of an attempt (0 or 1).
        beats: Whether scores are better than others by so many decibels.
        left: Whether there is time for so many more trainings.

    Returns: The settings with what won, and a choice for each setting that competed.
    """
    told: dict[str, list[str]] = {}
    expects = {one.setting: one.without for one in tried}
    # one training alone says nothing, two hardly more
    best = score(settings, 0) if tried and left(3) else ()
    for one in tried if best else ():
        if not left(1):
            break
        change: dict[str, Any] = {one.setting: one.value}
        other = replace(settings, **change)
        found = score(other, 0)
        pair, times = (found, best), ""
        if beats(*pair, WORTH) and left(2):
            pair, times = (found + score(other, 1), best + score(settings, 1)), ", twice"
        gain = sum(a - b for a, b in zip(*pair, strict=True)) / len(pair[0])
        line = f"{one.value}: {gain:+.2f} dB on {len(best)} held-out training views{times}"
        told.setdefault(one.setting, []).append(line)
        if beats(*pair, WORTH):
            settings, best = other, found
            expects[one.setting] = f"{gain:+.2f} dB in the probe"
    return settings, tuple(
        Choice(
            component=name.replace("_", " "), value=str(getattr(settings, name)),
            because="probe: " + "; ".join(told[name])
            if name in told
            else "usual; no time to probe",
            expects=expects[name],
        )
        for name in expects
    )  # fmt: skip


def unopposed(asked: AutoSettings, settings: Settings, facts: SceneFacts) -> Choice:
    """The exposure where nothing competed with it.

    Args:
        asked: The budget; `exposure` may be fixed.
        settings: What has been chosen.
        facts: What was measured.
    """
    if asked.exposure is not None:
        why = "given"
    elif math.isnan(facts.exposure):
        why = "too few shared points say whether photos differ in brightness"
    elif facts.exposure <= LEAST_EXPOSURE:
        why = (
            f"photos differ by {100 * math.expm1(facts.exposure):.1f} % in brightness; gains are tried from "
            f"{100 * math.expm1(LEAST_EXPOSURE):.0f} % on"
        )
    else:
        why = "usual; not probed"
    return Choice(
        component="exposure", value=settings.exposure, because=why,
        expects=str(UNEXPOSED) if settings.exposure == "off" else NOT_MEASURED,
    )  # fmt: skip
