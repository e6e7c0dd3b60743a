"""Make hashes.txt, every pinned package with the hashes of its files: python docs/tools/make_hashes.py UV

UV is the program of that name (pip install uv), which asks the package index. Arguments after it go to uv:
`--find-links FOLDER` for a CPU build of torch, which the index of PyPI does not have.
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXTRAS = ("dev", "distributed", "docs")
"""What `make setup-dev` installs."""
BUILD = "scikit-build-core>=1.0\nnanobind>=2.4\ncmake\nninja\n"
"""What compiles the native code (pyproject.toml), which pip would else fetch by itself."""
HEAD = """# Every package of `make setup-locked` and the sha256 of all its files, for Linux, Python 3.11 and torch's CPU build.
# Made by docs/tools/make_hashes.py from constraints.txt; not to be edited by hand.
"""
TORCH = re.compile(r"^(torch==[\d.]+)(?:\+\w+)? \\\n((?:    --hash=\S+(?: \\)?\n)+)", re.MULTILINE)


def main(uv: str, *options: str) -> None:
    """Write the file.

    Args:
        uv: The program.
        options: Its further options.
    """
    with tempfile.TemporaryDirectory() as folder:
        build = Path(folder) / "build.in"
        build.write_text(BUILD)
        extras = [word for extra in EXTRAS for word in ("--extra", extra)]
        locked = _compiled(
            uv, "pyproject.toml", str(build), *extras, "-c", "constraints.txt", *options
        )
        found = TORCH.search(locked)
        assert found, "torch is not among them"
        build.write_text(found[1])
        official = TORCH.search(_compiled(uv, str(build), "--no-deps"))
        assert official, "the index has no such torch"
    hashes = sorted(set(re.findall(r"--hash=\S+", found[2] + official[2])))
    lines = " \\\n    ".join([found[1], *hashes])
    (ROOT / "hashes.txt").write_text(HEAD + TORCH.sub(lambda _: lines + "\n", locked))


def _compiled(uv: str, *arguments: str) -> str:
    options = (
        "--generate-hashes",
        "--no-header",
        "--no-annotate",
        "--quiet",
        "--python",
        sys.executable,
    )
    command = [uv, "pip", "compile", *arguments, *options]
    return subprocess.run(command, cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE).stdout


if __name__ == "__main__":
    main(*sys.argv[1:])
