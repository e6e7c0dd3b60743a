"""One line of a plan: what was chosen, why, and what it is expected to bring."""

from dataclasses import dataclass

NOT_MEASURED = "not measured"
"""What a plan expects of a choice that nobody has tried against another."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One thing that was chosen, and why."""

    component: str
    """What was chosen about training, e.g. "resolution"."""
    value: str
    """What it is, for people."""
    because: str
    """The measured fact behind it, or that it was given."""
    expects: str = NOT_MEASURED
    """What it is expected to gain or save: computed by this plan, or measured on other scenes, see
    `splatproof.methods.auto.measured`."""
