"""Whether Gaussians move: where LiDAR sweeps say that something does."""

from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.planner import Choice
from splatproof.methods.auto.settings import LACKING, AutoSettings
from splatproof.methods.dynamic.terms import require_sweeps
from splatproof.methods.dynamic.times import clock_of
from splatproof.reference.types.scene import Scene

LEAST_MOVING = 0.001
"""Share of the LiDAR's returns that must lie on things in motion before Gaussians may move. A choice: street, the one
drive at hand, has 0.015, and no drive was tried in which nearly nothing moves."""


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
    given = [name for name in LACKING if getattr(asked, name) is not None]
    if given:
        return False, (
            _choice(False, f"{', '.join(given)} is given, which what moves does not have"),
        )
    return True, (_choice(True, told),)


def _choice(moves: bool, because: str) -> Choice:
    return Choice(
        component="motion",
        value="Gaussians that move (as method pvg's)" if moves else "none",
        because=because,
    )
