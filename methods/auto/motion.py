"""Whether Gaussians move: where LiDAR sweeps say that something does."""

from splatproof.methods.auto.choices import NOT_MEASURED, Choice
from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.measured import MOVING
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.dynamic.terms import require_sweeps
from splatproof.methods.dynamic.times import clock_of
from splatproof.reference.types.scene import Scene

LEAST_MOVING = 0.002
"""Share of the LiDAR's returns that must lie on things in motion before Gaussians may move. Of the world street's
drives, seeds 0 to 3, those in which nothing moves have up to 0.0005 of 12 frames (lamps and twigs that beams miss)
and up to 0.001 of 40, with one walker 0.0002 to 0.004, with one car 0.005 and more. Real sweeps were not at hand."""


def planned_motion(
    scene: Scene, asked: AutoSettings, facts: SceneFacts
) -> tuple[bool, tuple[Choice, ...]]:
    """Whether Gaussians move, and why; nothing is said of a scene of one moment.

    Args:
        scene: As a method gets it.
        asked: The budget; `motion` may be fixed.
        facts: What was measured.

    Raises: DataError if motion is asked for and a view has no time, or no training view a sweep.

    Source: ours; what moves, from sweeps: `splatproof.methods.dynamic.sweep_motion`.
    """
    if asked.motion is not None:
        if asked.motion:
            clock_of(scene)
            require_sweeps(scene, "motion = False, or leave it out,")
        return asked.motion, (_choice(asked.motion, "given"),)
    if facts.moments < 2:
        return False, ()
    told = f"{100 * facts.moving:.2f} % of the LiDAR's returns lie on things in motion"
    if facts.moving < LEAST_MOVING:
        seen = told if facts.swept else "no LiDAR sweep tells what moves"
        return False, (_choice(False, seen),)
    if asked.megabytes:
        return False, (
            _choice(False, "megabytes is given, and Gaussians that move have no such bound"),
        )
    given = asked.against_motion()
    if given:
        return False, (
            _choice(False, f"{', '.join(given)} is given, which what moves does not have"),
        )
    return True, (_choice(True, told),)


def _choice(moves: bool, because: str) -> Choice:
    return Choice(
        component="motion",
        value="Gaussians that move (as method pvg's)" if moves else "none",
        because=because, expects=str(MOVING) if moves else NOT_MEASURED,
    )  # fmt: skip
