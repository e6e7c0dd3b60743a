"""What is said to who trains for fewer steps than the release's schedule is made for."""

from typing import Any

SHORTEST = 7_000
"""Steps of the shortest run that the release reports (Kerbl et al. 2023, Tab. 1: Ours-7K)."""


def short_run(settings: Any) -> str:
    """A line about a short run with the release's density control; empty where there is none.

    Args:
        settings: Settings of any method.
    """
    from splatproof.methods.training.density import Density
    from splatproof.methods.training.schedules import shrink

    steps, density = getattr(settings, "iterations", SHORTEST), getattr(settings, "density", None)
    usual = type(density)() if isinstance(density, Density) else None
    if steps >= SHORTEST or usual is None or density != usual:
        return ""
    first, last = (round(step * shrink(steps)) for step in (usual.start, usual.stop))
    return (
        f"{steps} steps: density control, made for 30,000, is squeezed into steps {first} to {last}; "
        "`bench fit auto` chooses settings for this scene, this machine and the seconds that you give it"
    )
