"""Docstrings explain every parameter, and their first sentences say what they are about."""

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "src" / "splatproof"
ROOMS = sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))
"""All folders of the package: the links to the rooms, base and cli."""
DANGLING = re.compile(r"(Of|By)\b")
SECTION = re.compile(r"(\w+):")
ENTRY = re.compile(r" {4}\*{0,2}(\w+): (\S.*)")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def public_functions(body: list[ast.stmt]) -> Iterator[Function]:
    """Functions of a module, and methods of its public classes, that a caller uses by name.

    Constructors count; the parameters of other special methods are the language's.
    """
    for node in body:
        if isinstance(node, Function) and (node.name[0] != "_" or node.name == "__init__"):
            yield node
        if isinstance(node, ast.ClassDef) and node.name[0] != "_":
            yield from public_functions(node.body)


def parameters(function: Function) -> list[str]:
    """Names of a function's parameters, without self and cls and without stars."""
    takes = function.args
    every = [*takes.posonlyargs, *takes.args, takes.vararg, *takes.kwonlyargs, takes.kwarg]
    return [one.arg for one in every if one is not None and one.arg not in ("self", "cls")]


def documented(docstring: str) -> dict[str, str]:
    """Name and first line of each entry of the section `Args:`; empty without that section."""
    entries, inside = {}, False
    for line in docstring.splitlines():
        if section := SECTION.match(line):
            inside = section[1] == "Args"
        elif inside and (entry := ENTRY.match(line)):
            entries[entry[1]] = entry[2]
    return entries


def wrong_arguments(source: str) -> list[str]:
    """What `Args:` lacks in functions of two or more parameters, and entries of no parameter."""
    found = []
    for function in public_functions(ast.parse(source).body):
        takes, says = parameters(function), documented(ast.get_docstring(function) or "")
        missing = [name for name in takes if name not in says] if len(takes) > 1 else []
        unknown = [name for name in says if name not in takes]
        found += [f"{function.name}: {name} is not documented" for name in missing]
        found += [f"{function.name} has no parameter {name}" for name in unknown]
    return found


def docstrings(source: str) -> list[str]:
    """Strings that stand alone: the docstrings of module, classes, functions and attributes."""
    lone = (node.value for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Expr))
    texts = (node.value for node in lone if isinstance(node, ast.Constant))
    return [inspect.cleandoc(text) for text in texts if isinstance(text, str)]


def dangling(source: str) -> list[str]:
    """First lines, of docstrings and of entries of `Args:`, that begin with "Of" or "By"."""
    whole = docstrings(source)
    lines = [*whole, *(entry for text in whole for entry in documented(text).values())]
    return [line.splitlines()[0] for line in lines if DANGLING.match(line)]


def faults(check, room: str) -> dict[str, list[str]]:
    """What the check finds in each file of a room; files without a finding are left out."""
    files = list((PACKAGE / room).resolve().rglob("*.py"))
    assert files
    found = {str(path.relative_to(ROOT)): check(path.read_text()) for path in files}
    return {name: texts for name, texts in found.items() if texts}


@pytest.mark.parametrize("room", ROOMS)
def test_every_parameter_is_documented(room):
    assert not faults(wrong_arguments, room)


@pytest.mark.parametrize("room", ROOMS)
def test_no_docstring_begins_with_a_dangling_word(room):
    assert not faults(dangling, room)


SCALE = '''
def scale(length, factor, *others):
    """Longer.

    It is a product.

    Args:
        length: Metres,
            counted along: the road.
        factor: Above 0.
        *others: Further factors.
    Returns: Metres.
    """
'''


@pytest.mark.parametrize(
    "source",
    [
        SCALE.replace("        factor: Above 0.\n", ""),
        SCALE.replace("factor: Above 0.", "factor:"),
        SCALE.replace("        *others: Further factors.\n", ""),
        SCALE.replace("(length", "(length, /, width"),
        SCALE.replace("*others)", "*others, unit)"),
        SCALE.replace("*others)", "*others, **units)"),
        SCALE.replace("length,", "size,"),
        SCALE.replace("Args:", "Arguments:"),
        SCALE.replace("    Args:", "    Args:\n    Raises: Never."),
        SCALE.replace("length, factor, *others", "*others"),
        "async " + SCALE.replace("factor:", "share:").strip(),
        "class Road:" + SCALE.replace("def scale(", "def __init__(self, lanes, ").replace("\n", "\n    "),
        "def scale(length, factor): ...",
    ],
)  # fmt: skip
def test_the_check_sees_an_undocumented_parameter(source):
    assert wrong_arguments(source)


@pytest.mark.parametrize(
    "source",
    [
        SCALE,
        "class Road:" + SCALE.replace("(length", "(self, length").replace("\n", "\n    "),
        "def scale(length): ...",
        "def _scale(length, factor): ...",
        "class _Road:\n    def scale(self, length, factor): ...",
        "class Road:\n    def scale(self, length): ...",
        "class Road:\n    def __exit__(self, kind, error, trace): ...",
        "def scale(length):\n    def grow(one, two): ...",
    ],
)
def test_the_check_asks_for_no_more(source):
    assert not wrong_arguments(source)


@pytest.mark.parametrize(
    "source",
    [
        '"""Of the road."""',
        'WIDTH = 3\n"""Of a lane."""',
        'class Road:\n    """By its name."""',
        'class Road:\n    width: float\n    """Of a lane."""',
        'def scale(length):\n    """\n    Of a road."""',
        'def _scale(length):\n    """By a factor."""',
        SCALE.replace("Metres,", "Of the road,"),
    ],
)
def test_the_check_sees_a_dangling_word(source):
    assert dangling(source)


@pytest.mark.parametrize(
    "source",
    ['"""Offset of the road."""', 'NAME = "Of the road"', SCALE, SCALE.replace("It is", "By far")],
)
def test_the_check_of_words_lets_others_pass(source):
    assert not dangling(source)
