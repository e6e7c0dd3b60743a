"""Every target, and the program that reads inputs for them."""

import sys
from pathlib import Path

from fuzz.serving import Build, serve
from fuzz.targets_files import FILES
from fuzz.targets_models import MODELS
from fuzz.targets_scenes import SCENES

TARGETS: dict[str, Build] = {**SCENES, **MODELS, **FILES}
"""What builds each target in an empty folder."""

if __name__ == "__main__":
    serve(Path(sys.argv[1]), TARGETS)
