"""What `bench fit` and `bench plan` share: by which rules a scene is opened, and what is said of it."""

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.reference.types.protocol import Protocol
    from splatproof.reference.types.scene import Scene

Points = Literal["scene", "triangulated"]
"""Where the sparse points come from that training starts from."""


def scene_rules(name: str, width: int | None, points: Points | None, strict: bool) -> "Protocol":
    """The protocol of that name with what the command line says of it, under a name that says so.

    Args:
        name: Name of a protocol, or the path of a .toml file.
        width: Width of the images in pixels; None: the protocol's.
        points: Where sparse points come from; None: as the protocol says.
        strict: Whether a scene that names photos which are not there is refused; False: as the protocol says.
    Raises: UsageError for a protocol that there is not, or a width below 1.
    """
    from splatproof.metrics.protocol_files import load_protocol, resized

    rules = resized(load_protocol(name), width)
    if points is not None and points != rules.points:
        rules = replace(rules, points=points, name=f"{rules.name}-{points}")
    return replace(rules, strict=True) if strict else rules


def tell_left_out(scene: "Scene") -> None:
    """Say which photos take no part, and why: all reasons, an example each."""
    reasons: dict[str, list[str]] = {}
    for name, reason in scene.left_out:
        reasons.setdefault(reason.partition(": ")[0], []).append(name)
    for reason, names in reasons.items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        output.log(f"left out: {names[0]}{more}: {reason}")
