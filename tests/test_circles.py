"""No circle of imports between files, and none between folders, imports inside functions included.

A circle that works only because an import was moved into a function still means that neither file can
be understood without the other, so the whole text is searched. Imports for type checkers count as
well: who reads a file follows them all the same.
"""

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "src" / "splatproof"
ROOMS = (
    "reference",
    "metrics",
    "datasets",
    "methods",
    "suites",
    "reports",
    "base",
    "cli",
    "api",
    "viewing",
)


def our_modules() -> dict[str, str]:
    """The text of each of our modules by its dotted name; a package's is that of its __init__."""
    paths = [*PACKAGE.glob("*.py")]
    for room in ROOMS:
        paths += (PACKAGE / room).rglob("*.py")
    found = {}
    for path in paths:
        name = ".".join(("splatproof", *path.relative_to(PACKAGE).with_suffix("").parts))
        found[name] = path.read_text(encoding="utf-8")
    return found


def file_imports(modules: Mapping[str, str]) -> dict[str, set[str]]:
    """Which of these modules each of them imports, wherever in its text.

    Args:
        modules: Text by dotted name; a package's name ends in ".__init__".
    """
    known = {name.removesuffix(".__init__"): name for name in modules}
    return {
        name: {known[target] for target in _targets(text, known) if known[target] != name}
        for name, text in modules.items()
    }


def _targets(text: str, known: Mapping[str, str]) -> Iterator[str]:
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if whole in known or node.module in known:
                    yield whole if whole in known else node.module


def folder_imports(files: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Which folders the files of each folder import from; a folder is not its own subfolder."""
    found: dict[str, set[str]] = {}
    for name, imported in files.items():
        here = name.rpartition(".")[0]
        there = {other.rpartition(".")[0] for other in imported} - {here}
        found[here] = found.get(here, set()) | there
    return found


def circles(imports: Mapping[str, set[str]]) -> set[frozenset[str]]:
    """Largest sets of at least two names that can all be reached from one another."""
    reached = {name: _reached(name, imports) for name in imports}
    found = {
        frozenset({name, *(other for other in reached[name] if name in reached.get(other, ()))})
        for name in imports
    }
    return {members for members in found if len(members) > 1}


def _reached(start: str, imports: Mapping[str, set[str]]) -> set[str]:
    seen, waiting = set[str](), [start]
    while waiting:
        new = imports.get(waiting.pop(), set()) - seen
        seen |= new
        waiting += new
    return seen


@pytest.fixture(scope="module")
def ours() -> dict[str, set[str]]:
    """What our modules import, read once."""
    return file_imports(our_modules())


def test_no_circle_between_files(ours):
    assert not circles(ours)


def test_no_circle_between_folders(ours):
    assert not circles(folder_imports(ours))


def test_all_modules_are_looked_at(ours):
    assert {name.split(".")[1] for name in ours if name.count(".") > 1} == set(ROOMS)
    assert "splatproof.base.files" in ours["splatproof.base.tensor_files"]


@pytest.mark.parametrize(
    "back",
    [
        "from splatproof.room.a import x",
        "import splatproof.room.a",
        "def f():\n    from splatproof.room import a",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from splatproof.room.a import T",
    ],
)
def test_a_circle_of_files_is_seen(back):
    modules = {
        "splatproof.room.a": "from splatproof.room.b import y",
        "splatproof.room.b": "import splatproof.room.c as c",
        "splatproof.room.c": back,
        "splatproof.room.d": "from splatproof.room import a, b, c",
    }
    wanted = frozenset({"splatproof.room.a", "splatproof.room.b", "splatproof.room.c"})
    assert circles(file_imports(modules)) == {wanted}
    modules["splatproof.room.c"] = "from splatproof.elsewhere import a"
    assert not circles(file_imports(modules))


def test_a_circle_through_a_package_is_seen():
    modules = {
        "splatproof.room.__init__": "from splatproof.room.a import x",
        "splatproof.room.a": "from splatproof.room import y",
    }
    assert len(circles(file_imports(modules))) == 1


def test_a_circle_of_folders_is_seen_where_files_have_none():
    modules = {
        "splatproof.room.top": "from splatproof.room.inner.one import x",
        "splatproof.room.inner.one": "",
        "splatproof.room.inner.two": "from splatproof.room.low import x",
        "splatproof.room.low": "",
    }
    files = file_imports(modules)
    assert not circles(files)
    assert circles(folder_imports(files)) == {
        frozenset({"splatproof.room", "splatproof.room.inner"})
    }
    modules["splatproof.room.inner.two"] = "from splatproof.room.inner import one"
    assert not circles(folder_imports(file_imports(modules)))
