"""Make docs/licences.md: python docs/tools/make_licences_page.py

From what the installed packages say of themselves, at the versions that constraints.txt pins, in an environment
that `make test` has set up.
"""

import importlib.metadata
import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "licences.md"
READ = {"huey": "MIT", "embreex": "BSD-2-Clause", "skops": "MIT"}
"""Licences of packages whose metadata name none, read in the licence files that they bring."""
COPYLEFT = re.compile(r"GPL|GNU|Affero|SSPL|Commons Clause|BUSL|proprietary|unknown", re.IGNORECASE)
"""What no package may be under that the product needs to run."""
TEXT = """# Licences

Made by `python docs/tools/make_licences_page.py` from what the packages say of themselves, at the versions that
[constraints.txt](../constraints.txt) pins; a test compares. splatproof itself is under the Apache License 2.0, so
nothing that it needs to run may ask for more than naming its authors: a test fails for a package under a licence of
the GPL's kind among those. `plyfile` is such a one; tests alone use it, to hold our own reading of .ply files
against. What wheels of compiled packages carry inside (FFmpeg in `av`, for one) is not looked into.

## Needed to run

{run}

## Development, tests, documentation and extras alone

{rest}

## Needed to build

{build}: in an environment of the build's own, so not among what was asked.
"""


def pinned() -> dict[str, str]:
    """Version of each package that constraints.txt pins, by its normalised name."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {canonicalize_name(name): version.split()[0] for name, version in pairs}


def needed() -> set[str]:
    """Normalised names of all packages that the product needs to run on this machine."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        ask = tomllib.load(file)["project"]["dependencies"]
    found: set[str] = set()
    while ask:
        wanted = Requirement(ask.pop())
        name = canonicalize_name(wanted.name)
        asks = wanted.marker is None or wanted.marker.evaluate({"extra": ""})
        if asks and name not in found:
            found.add(name)
            ask += importlib.metadata.requires(name) or []
    return found


def licence(name: str) -> str | None:
    """What a package says of its licence; None where it is not installed.

    Args:
        name: Normalised name.
    """
    try:
        told = importlib.metadata.metadata(name)
    except importlib.metadata.PackageNotFoundError:
        return None
    if name in READ:
        return READ[name]
    fields = told.json
    lines = [line for line in fields.get("classifier", []) if line.startswith("License")]
    classes = " / ".join(line.split("::")[-1].strip() for line in lines)
    return str(fields.get("license_expression") or classes or fields.get("license") or "unknown")


def page() -> str:
    """The page's text."""
    run, versions = needed(), pinned()
    known = {name: licence(name) for name in versions}
    groups: dict[bool, list[str]] = {True: [], False: []}
    for name, told in sorted(known.items()):
        if told is not None:
            groups[name in run].append(f"| {name} | {versions[name]} | {told} |")
    head = ["| package | version | licence |", "|---|---|---|"]
    absent = ", ".join(sorted(name for name, told in known.items() if told is None))
    tables = {key: "\n".join(head + lines) for key, lines in groups.items()}
    return TEXT.format(run=tables[True], rest=tables[False], build=absent)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
