"""Facts of a scene in words."""

import math

from splatproof.base.memory import MEBIBYTE
from splatproof.methods.auto.facts import SceneFacts


def told(facts: SceneFacts, points: int) -> list[tuple[str, str, str]]:
    """(what, how much, what follows of it) of each fact, for people.

    Args:
        facts: What was measured.
        points: Number of points that the scene has of its own.
    """

    def known(value: float, text: str) -> str:
        return "not known" if math.isnan(value) else text

    return [
        ("photos", f"{facts.views} of {facts.width} x {facts.height} pixels",
         f"{facts.image_bytes / MEBIBYTE:,.0f} MB in memory"),
        ("points", f"{points:,}" if points else "none",
         f"{100 * facts.bare:.0f} % of the photos' cells of 16 x 16 pixels show none"),
        ("overlap", known(facts.coverage, f"each place in {facts.coverage:.1f} photos"),
         known(facts.track, f"a point was found in {facts.track:.1f} of them; a photo has "
                            f"{facts.neighbours:.0f} neighbours")),
        ("baselines", known(facts.angle, f"{facts.angle:.0f} degrees"),
         "median over points of the widest angle between two rays"),
        ("directions", f"{math.degrees(math.acos(min(1.0, max(-1.0, facts.down)))):.0f} degrees",
         "that a photo looks away from straight down, at most"),
        ("detail", f"{facts.detail:.1f} of 255", "what a photo loses when it is halved"),
        ("noise", f"{facts.noise:.1f} of 255", "below it no training can tell right from wrong"),
        ("exposure", known(facts.exposure, f"{100 * math.expm1(facts.exposure):.1f} %"),
         "spread of the photos' brightness on shared points"),
        ("moments", str(facts.moments) if facts.moments else "not known",
         f"{100 * facts.moving:.2f} % of the LiDAR's returns lie on things in motion" if facts.swept
         else "several times, no LiDAR: what moves is not known (methods pvg and hdgs)" if facts.moments > 1
         else "nothing says that anything moves"),
    ]  # fmt: skip
