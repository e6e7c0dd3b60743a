"""Make the example of docs/compare.md: python docs/tools/make_compare_page.py RUNS

Trains method 3dgs on the courtyard as it is and without its SSIM term, three seeds each, the two sides turn by
turn, in RUNS/before and RUNS/after (resumable), and writes docs/compare_before.json, docs/compare_after.json, the
two pictures and the example in docs/compare.md. Without RUNS the example is written again from the committed files.
For times to be judged the machine must have nothing else to do.
"""

import contextlib
import io
import re
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from splatproof.cli.baseline import save
from splatproof.cli.compare import compare
from splatproof.suites.runner import run_suite
from splatproof.suites.suite_files import load_suite

DOCS = Path(__file__).resolve().parents[1]
SIDES = ("before", "after")
FILES = {side: DOCS / f"compare_{side}.json" for side in SIDES}
PICTURES = {"3dgs": "compare_crop.png", "profile": "compare_profile.png"}
"""Names in docs/images/ by what the names of the report's first such pictures contain."""
EXAMPLE = re.compile(r"(<!-- example: make_compare_page.py -->\n```\n).*?(\n```)", re.DOTALL)


def train(runs: Path) -> None:
    """Run both sides, seed by seed in turns.

    Args:
        runs: Folder for both.
    """
    quick = load_suite("quick")
    ours = [case for case in quick.cases if case.scene_name == "courtyard"]
    for case in sorted(ours, key=lambda case: case.seed):
        settings: Any = case.settings
        changed = replace(case, settings=replace(settings, dssim=0.0))
        for side, one in zip(SIDES, (case, changed), strict=True):
            print(f"{side}: {case.label}", file=sys.stderr)
            run_suite(replace(quick, cases=(one,)), runs / side)


def example() -> str:
    """What `bench compare docs/compare_before.json docs/compare_after.json` prints."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        compare(str(FILES["before"]), str(FILES["after"]))
    lines = [line.rstrip() for line in said.getvalue().splitlines()]
    return "\n".join(lines).strip().replace(f"{DOCS}/", "docs/")


def draw(runs: Path) -> None:
    """Write the report's crop and profile to docs/images/.

    Args:
        runs: Folder of both sides.
    """
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        compare(*(str(runs / side) for side in SIDES), markdown=Path(folder) / "pr.md")
        drawn = sorted((Path(folder) / "pr_pictures").iterdir())
        for part, name in PICTURES.items():
            shutil.copy(next(path for path in drawn if part in path.name), DOCS / "images" / name)


def main(runs: Path | None) -> None:
    """Make the committed files and the example.

    Args:
        runs: Folder of both sides; None: the committed files stay as they are.
    """
    if runs:
        train(runs)
        for side, path in FILES.items():
            with contextlib.redirect_stdout(io.StringIO()):
                save(path.stem, str(runs / side), folder=DOCS, replace=True)
        draw(runs)
    page = DOCS / "compare.md"
    text = page.read_text(encoding="utf-8")
    page.write_text(EXAMPLE.sub(lambda m: m[1] + example() + m[2], text), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else None)
