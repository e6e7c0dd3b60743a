"""Whether depths are completed before training, and virtual Gaussians fill what few photos do not show."""

from splatproof.methods.auto.facts import SceneFacts
from splatproof.methods.auto.planner import Choice
from splatproof.methods.auto.settings import AutoSettings

FEW = 12
"""Photos up to which it is told that nothing is completed: with more nobody would expect it."""


def planned_completion(asked: AutoSettings, facts: SceneFacts) -> tuple[bool, tuple[Choice, ...]]:
    """Complete depths only where that is asked for: nothing that is measured before tells where it pays.

    Args:
        asked: The budget; `completed` may be fixed.
        facts: What was measured.

    Source: ours; what is done: StratoSplat, Sec. 3.
    """
    if asked.completed is not None:
        return asked.completed, (_choice(asked.completed, "given"),)
    if facts.views > FEW:
        return False, ()
    return False, (_choice(False, "from few photos it gains on one scene and loses on another"),)


def _choice(done: bool, because: str) -> Choice:
    return Choice(
        component="completed depths",
        value="of each photo, and virtual Gaussians (as method stratosplat's)" if done else "none",
        because=because,
    )
