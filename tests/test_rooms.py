"""Imports point one way between the rooms (docs/architecture.md)."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAY_IMPORT = {
    "base": set(),
    "reference": set(),
    "metrics": {"reference"},
    "datasets": {"reference"},
    "methods": {"reference", "datasets"},
    "suites": {"reference", "metrics", "datasets", "methods"},
    "reports": {"reference", "metrics"},
}


def forbidden_imports(source: str, room: str) -> list[str]:
    """Modules of other rooms that `source` imports although `room` may not."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    allowed = MAY_IMPORT[room] | {room, "base", "_ext", "__version__"}
    ours = [name.split(".") for name in names if name.split(".")[0] == "splatproof"]
    return [".".join(parts) for parts in ours if len(parts) < 2 or parts[1] not in allowed]


@pytest.mark.parametrize("room", sorted(MAY_IMPORT))
def test_room_imports_only_what_it_may(room):
    files = list((ROOT / "src/splatproof" / room).rglob("*.py"))
    assert files
    bad = {str(path.relative_to(ROOT)): forbidden_imports(path.read_text(), room) for path in files}
    assert not {name: found for name, found in bad.items() if found}


@pytest.mark.parametrize(
    "source",
    [
        "from splatproof.methods import registry",
        "import splatproof.suites.runner",
        "def f():\n    from splatproof import reports",
    ],
)
def test_the_check_sees_a_wrong_import(source):
    assert forbidden_imports(source, "metrics")


def test_the_check_lets_a_right_import_pass():
    assert not forbidden_imports("from splatproof.reference.types.camera import Camera", "metrics")
