"""Runs docs/tutorial.md and writes what each block prints below it: `python docs/tools/run_tutorial.py`."""

import contextlib
import io
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from splatproof.base.files import write_text

DOCS = Path(__file__).parents[1]
PAGE = DOCS / "tutorial.md"
BLOCK = re.compile(r"```python\n(?P<code>.*?)```\n\n```text\n(?P<printed>.*?)```", re.DOTALL)


def blocks(page: str) -> list[tuple[str, str]]:
    """Code and what it printed, in order."""
    return [(found["code"], found["printed"]) for found in BLOCK.finditer(page)]


def outputs(page: str, folder: Path) -> Iterator[str]:
    """What each block prints, run in one namespace.

    Args:
        page: The page's text.
        folder: Working folder of the blocks.
    """
    names: dict[str, object] = {}
    with contextlib.chdir(folder):
        for code, _ in blocks(page):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(code, str(PAGE), "exec"), names)  # noqa: S102
            yield printed.getvalue()


def with_outputs(page: str, printed: Iterator[str]) -> str:
    """The page with other outputs.

    Args:
        page: The page's text.
        printed: What each block prints, in order.
    """
    return BLOCK.sub(
        lambda found: f"```python\n{found['code']}```\n\n```text\n{next(printed)}```", page
    )


def main() -> None:
    """Run the page, rewrite it and its picture."""
    os.environ.pop("MLFLOW_TRACKING_URI", None)
    page = PAGE.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        text = with_outputs(page, outputs(page, Path(folder)))
        shutil.copyfile(Path(folder) / "tutorial.png", DOCS / "images" / "tutorial.png")
    write_text(PAGE, text)


if __name__ == "__main__":
    main()
