"""`bench protocols`: the rules by which views are made, held out and scored."""

import sys
from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.reference.types.protocol import Protocol

PIPED_WIDTH = 200
"""Characters a line where stdout is no terminal."""


def protocols(
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[PROTOCOL]")] = None,
) -> None:
    """List the protocols that `--protocol` takes, or show every rule of one.

    With --json each protocol is a line with all its rules.

    Args:
        name: Name of a protocol, or the path of a .toml file. Without it all are listed.
    """
    from splatproof.metrics.protocol_files import load_protocol, protocol_names

    chosen = [load_protocol(one) for one in ([name] if name else protocol_names())]
    if output.wants_json():
        for protocol in chosen:
            output.print_record(asdict(protocol))
        return
    table = _rules(chosen[0]) if name else _listed(chosen)
    width = None if sys.stdout.isatty() else PIPED_WIDTH
    Console(highlight=False, markup=False, width=width).print(table)


def _listed(chosen: "list[Protocol]") -> Table:
    """A line a protocol."""
    table = Table(box=None, pad_edge=False)
    for column in ("name", "held out", "size", "scored by", "from"):
        table.add_column(column, overflow="fold")
    for protocol in chosen:
        table.add_row(
            protocol.name, held_out(protocol), size(protocol), ", ".join(protocol.metrics),
            protocol.source,
        )  # fmt: skip
    return table


def _rules(protocol: "Protocol") -> Table:
    """A line a rule: those that are not as usual first."""
    table = Table(box=None, pad_edge=False, title=f"protocol {protocol.name}", title_justify="left")
    for column in ("rule", "value", "usual"):
        table.add_column(column, overflow="fold")
    rows = [
        (field.name, getattr(protocol, field.name), field.default)
        for field in fields(protocol)
        if field.name != "name"
    ]
    for rule, value, usual in sorted(rows, key=lambda row: row[1] == row[2]):
        given = "" if value == usual or rule == "source" else str(usual)
        table.add_row(rule, str(value), given)
    return table


def held_out(protocol: "Protocol") -> str:
    """Which views are scored, in words.

    Args:
        protocol: Its split rules count.
    """
    if protocol.scored == "training":
        return "nothing: training views are scored"
    if protocol.test_folder:
        return f"all views of {protocol.test_folder}/"
    if protocol.test_names:
        return ", ".join(protocol.test_names)
    rest = f"all but {protocol.train_views} training views" if protocol.train_views else "nothing"
    unit = "moment" if protocol.hold_unit == "time" else "view"
    start = f" from number {protocol.hold_first}" if protocol.hold_first else ""
    share = f", or the next that training photos show {100 * protocol.least_seen:g} % of"
    near = share if protocol.least_seen else ""
    return f"every {protocol.hold}th {unit}{start}{near}" if protocol.hold else rest


def size(protocol: "Protocol") -> str:
    """How large images are made, in words.

    Args:
        protocol: Its size rules count.
    """
    if protocol.width is not None:
        return f"{protocol.width} px wide"
    if protocol.max_width is not None:
        return f"at most {protocol.max_width} px wide"
    return "as the photos" if protocol.factor == 1 else f"1/{protocol.factor:g} of the photos"
