"""Our docstrings as reStructuredText: sections become fields, code stays code, nothing else is markup."""

import re
from collections.abc import Iterator, Sequence

SECTION = re.compile(r"(Args|Returns|Raises|Source|Warns):\s*(.*)")
ENTRY = re.compile(r" {4}(\*{0,2}\w+): (.*)")
CODE = re.compile(r"`([^`]+)`")
MARKUP = re.compile(r"([*|\\_])")


def as_rest(lines: Sequence[str]) -> list[str]:
    """The lines of a docstring as Sphinx reads them.

    Args:
        lines: The docstring, without common indentation.
    """
    return [*_rest(list(lines)), ""]


def _rest(lines: list[str]) -> Iterator[str]:
    section = ""
    for line in lines:
        if line.startswith(">>>"):
            section = ""
            yield ""
            yield line
        elif found := SECTION.fullmatch(line):
            section, text = found[1], found[2]
            if section != "Args":
                yield ""
                yield f":{section.lower()}: {_plain(text)}"
        elif section == "Args" and (entry := ENTRY.fullmatch(line)):
            yield f":param {entry[1].lstrip('*')}: {_plain(entry[2])}"
        elif section and line.startswith(" "):
            yield f"    {_plain(line.strip())}"
        elif section and line:
            section = ""
            yield ""
            yield _plain(line)
        else:
            yield line if line.startswith("- ") and _plain(line) == line else _text(line)


def _text(line: str) -> str:
    """A line outside sections, its indentation kept where it continues a list."""
    bullet = "- " if line.lstrip().startswith("- ") else ""
    space = line[: len(line) - len(line.lstrip())]
    return space + bullet + _plain(line.lstrip().removeprefix(bullet))


def _plain(text: str) -> str:
    """Text with its code marked as code, and every other sign of markup meaning itself."""
    parts = CODE.split(text)
    return "".join(
        f"``{part}``" if index % 2 else MARKUP.sub(r"\\\1", part)
        for index, part in enumerate(parts)
    )
