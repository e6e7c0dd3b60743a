"""Make hashes.txt, every pinned package with the hashes of its files: python docs/tools/make_hashes.py UV

UV is the program of that name (pip install uv), which asks the package index. Arguments after it go to uv:
`--find-links FOLDER` for the CPU build of torch, which PyPI does not have. PyPI's own build is not listed: pip would
take it before a file in a folder, and it needs packages of CUDA that are not pinned.
"""

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


def main(uv: str, *options: str) -> None:
    """Write the file.

    Args:
        uv: The program.
        options: Its further options.
    """
    extras = [word for extra in EXTRAS for word in ("--extra", extra)]
    with tempfile.NamedTemporaryFile("w", suffix=".in") as build:
        build.write(BUILD)
        build.flush()
        command = [
            uv, "pip", "compile", "pyproject.toml", build.name, *extras, "-c", "constraints.txt", "--generate-hashes",
            "--no-header", "--no-annotate", "--quiet", "--python", sys.executable, *options,
        ]  # fmt: skip
        locked = subprocess.run(command, cwd=ROOT, check=True, text=True, stdout=subprocess.PIPE)
    (ROOT / "hashes.txt").write_text(HEAD + locked.stdout)


if __name__ == "__main__":
    main(*sys.argv[1:])
