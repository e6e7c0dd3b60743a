"""What a run depends on, as text beside its checkpoints, and what differs where two are not one run."""

import json

from splatproof.base.differing import differences

PARTS = ("scene", "training views or points", "settings", "seed", "background", "backend", "device")
"""What `run_key` holds, in its order; what else a method depends on comes behind."""


def what_differs(before: object, now: str) -> str:
    """The parts of two keys that differ, settings by their names.

    Args:
        before: The key that was stored.
        now: The key of this run.
    """
    old, new = _parts(before), _parts(now)
    said = differences(old, new)
    return said or "in a way that its key does not name"


def with_special(key: str, *special: str) -> str:
    """A run's key that also holds what the model depends on besides.

    Args:
        key: As `run_key` made it.
        special: Names of contents, such as hashes.
    """
    return json.dumps([*json.loads(key), *special])


def _parts(key: object) -> dict[str, object]:
    """A key by the names of its parts; digests as they are."""
    try:
        values = json.loads(str(key))
    except ValueError:
        return {"key": key}
    if not isinstance(values, list) or len(values) < len(PARTS):
        return {"key": key}
    named: dict[str, object] = dict(zip(PARTS, values, strict=False))
    if len(values) > len(PARTS):
        named["the rest"] = values[len(PARTS) :]
    return named
