"""Protocols as small TOML files: one rule a key, the name is the file's."""

import dataclasses
from pathlib import Path

from splatproof.base.errors import UsageError
from splatproof.base.inside import checked_name
from splatproof.base.names import unknown
from splatproof.base.typed_toml import build, read_toml
from splatproof.metrics.registry import find_metric
from splatproof.reference.types.protocol import Protocol

FOLDER = Path(__file__).parent / "protocols"
"""Where the protocols that come with the package are."""
KEYS = tuple(field.name for field in dataclasses.fields(Protocol) if field.name != "name")


def protocol_names() -> list[str]:
    """Names of the protocols that come with the package, sorted."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def load_protocol(name_or_path: str | Path) -> Protocol:
    """The protocol of that name, or the one in a file of your own.

    Args:
        name_or_path: One of `protocol_names()`, or the path of a .toml file whose keys are the
            fields of Protocol except the name, which is the file's; `source` must be among them.
    Raises: UsageError naming the file, key, value and what was expected.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = FOLDER / f"{name_or_path}.toml"
        if str(name_or_path) not in protocol_names():
            raise unknown(
                "protocol (a name as `bench protocols` lists them, or the path of a .toml file)",
                str(name_or_path),
                protocol_names(),
            )
    rules = read_toml(path)
    return protocol_from_rules(path.stem, rules, str(path))


def resized(protocol: Protocol, width: int | None) -> Protocol:
    """The protocol with images of another width, under a name that says so.

    Args:
        protocol: Any.
        width: Width in pixels; None: the protocol as it is.
    Raises: UsageError for a width below 1.
    """
    if width is None:
        return protocol
    if width < 1:
        raise UsageError(f"--width {width}: expected pixels, 1 or more")
    name = f"{protocol.name}-{width}px"
    return dataclasses.replace(protocol, name=name, width=width, max_width=None, factor=1.0)


def protocol_from_rules(name: str, rules: dict[str, object], where: str) -> Protocol:
    """Check the rules one by one and make a protocol of them.

    Args:
        name: Name of the protocol.
        rules: Key to value, as read from TOML.
        where: Name of the file, for errors.
    Raises: UsageError on an unknown key, a wrong type or value, or rules that contradict.
    """
    if "name" in rules:
        raise unknown(where, "name", KEYS)
    checked_name(name, f"{where}: its name becomes a folder", UsageError, nested=False)
    protocol = build(Protocol, rules | {"name": name}, where)
    for key, folder in (("images", protocol.images), ("test_folder", protocol.test_folder)):
        if folder:
            checked_name(folder, f"{where}: {key}", UsageError)
    _check(protocol, where)
    return protocol


def _check(protocol: Protocol, where: str) -> None:
    """Refuse values that no rule can mean."""
    sizes = [
        name
        for name, given in (
            ("width", protocol.width is not None),
            ("factor", protocol.factor != 1),
            ("max_width", protocol.max_width is not None),
        )
        if given
    ]
    other = protocol.test_names or protocol.test_folder
    problems = [
        (not protocol.source.strip(), "source is empty; say where the rules come from"),
        (not protocol.images, "images is empty; name the folder of the source images"),
        (len(sizes) > 1, f"both {' and '.join(sizes)} are given; choose one"),
        (protocol.width is not None and protocol.width < 1, f"width is {protocol.width}, not >= 1"),
        (
            protocol.max_width is not None and protocol.max_width < 1,
            f"max_width is {protocol.max_width}, not >= 1",
        ),
        (not 1 <= protocol.factor < float("inf"), f"factor is {protocol.factor}, not >= 1"),
        (
            bool(protocol.test_folder and protocol.test_names),
            "both test_folder and test_names are given; choose one",
        ),
        (protocol.hold < 0, f"hold is {protocol.hold}, expected 0 (none) or more"),
        (protocol.hold_first < 0, f"hold_first is {protocol.hold_first}, expected 0 or more"),
        (
            not 0 <= protocol.least_seen <= 1,
            f"least_seen is {protocol.least_seen}, expected a share from 0 to 1",
        ),
        (
            protocol.least_seen > 0
            and (not protocol.hold or protocol.hold_unit != "view" or bool(other)),
            (
                "least_seen chooses among views that `hold` counts: leave test_names and test_folder out, "
                "set hold above 0 and hold_unit to 'view'"
            ),
        ),
        (protocol.train_views < 0, f"train_views is {protocol.train_views}, expected 0 or more"),
        *(
            (
                first < 0 or (last != -1 and last < first),
                f"clips: {scene!r} goes from {first} to {last}, not forward from 0 (-1: to the end)",
            )
            for scene, first, last in protocol.clips
        ),
        (
            protocol.appearance in ("half", "exposure") and protocol.region != "right_half",
            f"appearance {protocol.appearance!r} looks at the left half: region is "
            + f"{protocol.region!r}, expected 'right_half'",
        ),
        (not protocol.metrics, "metrics is empty; name at least one"),
        (
            not all(0 <= value <= 1 for value in protocol.background),
            f"background is {protocol.background}, expected three numbers in [0, 1]",
        ),
    ]
    problems += [
        (len(set(names)) < len(names), f"{key} names one twice: {', '.join(names)}")
        for key, names in (
            ("metrics", protocol.metrics),
            ("test_names", protocol.test_names),
            ("sensors", protocol.sensors),
            ("clips", tuple(scene for scene, _, _ in protocol.clips)),
            ("colour_fit", protocol.colour_fit),
            ("parts", protocol.parts),
        )
    ]
    for wrong, message in problems:
        if wrong:
            raise UsageError(f"{where}: {message}")
    for metric in protocol.metrics:
        try:
            find_metric(metric)
        except UsageError as error:
            raise UsageError(f"{where}: metrics: {error}") from error
