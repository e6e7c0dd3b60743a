"""hashes.txt is constraints.txt with hashes: a version that is changed in one is changed in the other."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
BUILD = {"cmake", "ninja"}
"""What compiles, which pip fetches by itself in the set-up without hashes."""


def versions(text: str) -> dict[str, str]:
    """Versions, less what a build adds ("+cpu"), by the packages' normalised names (PEP 503)."""
    pins = re.findall(r"^([\w.-]+)==([^\s;\\+]+)", text, re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pins}


def test_hashes_are_of_the_pinned_versions():
    hashed = versions((ROOT / "hashes.txt").read_text())
    pinned = versions((ROOT / "constraints.txt").read_text())
    assert {name: version for name, version in hashed.items() if name not in BUILD} == pinned
    assert BUILD <= hashed.keys()


def test_every_package_has_hashes():
    text = "\n".join(
        line for line in (ROOT / "hashes.txt").read_text().splitlines() if line[:1] != "#"
    )
    blocks = re.split(r"\n(?=\S)", text)
    assert len(blocks) == len(versions(text))
    assert [
        block for block in blocks if not re.search(r"--hash=sha256:[0-9a-f]{64}\b", block)
    ] == []
