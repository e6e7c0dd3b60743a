"""Settings of a method as a Markdown table, from the dataclasses and the docstrings of their fields."""

import ast
import dataclasses
import inspect
import itertools
import typing
from collections.abc import Iterator


def setting_rows(kind: type, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Name (nested ones with dots), default and description of every setting.

    Args:
        kind: Dataclass of settings.
        prefix: Start of the names, with its dot.
    """
    words, kinds = field_docs(kind), typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        default = field.default
        if default is dataclasses.MISSING:
            assert field.default_factory is not dataclasses.MISSING, f"{kind}.{field.name}"
            default = field.default_factory()
        name = f"{prefix}{field.name}"
        if dataclasses.is_dataclass(default):
            yield from setting_rows(type(default), f"{name}.")
        else:
            yield name, _shown(default, kinds[field.name]), words.get(field.name, "")


def field_docs(kind: type) -> dict[str, str]:
    """The docstring below each field, those of base classes where a class says none itself."""
    found: dict[str, str] = {}
    for owner in reversed(kind.__mro__):
        if not dataclasses.is_dataclass(owner):
            continue
        tree = ast.parse(inspect.getsource(inspect.getmodule(owner) or owner))
        (body,) = [
            node.body
            for node in ast.walk(tree)
            if isinstance(node, ast.ClassDef) and node.name == owner.__name__
        ]
        for line, after in itertools.pairwise(body):
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
                text = _docstring(after)
                found |= {line.target.id: text} if text else {}
    return found


def table(kind: type) -> str:
    """The settings as Markdown."""
    rows = [
        f"| `--{name.replace('_', '-')}` | {default} | {_cell(text)} |"
        for name, default, text in setting_rows(kind)
    ]
    return "\n".join(["| setting | default | what it is |", "|---|---|---|", *rows])


def _docstring(node: ast.stmt) -> str:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return " ".join(str(node.value.value).split())
    return ""


def _shown(value: object, kind: object) -> str:
    options = typing.get_args(kind) if typing.get_origin(kind) is typing.Literal else ()
    among = f" of {', '.join(f'`{one}`' for one in options)}" if len(options) > 1 else ""
    return f"`{value}`{among}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
