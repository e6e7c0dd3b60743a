"""Cases that differ in how they are scored alone are trained once."""

import json
import shutil
from dataclasses import asdict
from pathlib import Path

from splatproof.base.files import write_text
from splatproof.base.folders import new_folder
from splatproof.suites.suite_files import Case, key_of

SCORING = (
    "name", "source", "rounding", "region", "appearance", "metrics", "parts", "colour_fit",
)  # fmt: skip
"""Rules of a protocol that neither the training views nor their photos depend on."""
LEFT = ("model", "curve.jsonl", "trained.json")
"""What the end of a training leaves in a case's folder, the last of which says that it has ended."""


def training_key(case: Case, backend: str) -> str:
    """Hash of everything that a case's model depends on, apart from data, code and machine.

    Args:
        case: What is run.
        backend: Name of the rasterizer that trains it.
    Returns: SHA-256 in hexadecimal.
    """
    rules = {name: rule for name, rule in asdict(case.protocol).items() if name not in SCORING}
    made_of = {**vars(case), "settings": asdict(case.settings), "protocol": rules}
    made_of.pop("variant")  # a name and nothing more
    return key_of(backend=backend, **made_of)


def taken_over(folder: Path, name: str) -> str:
    """Copy into a case's folder the model that a case of the same training has left beside it.

    Args:
        folder: The case's folder, <scene>/<row>/<protocol>/seed<k>, with its case file in it and nothing
            trained yet.
        name: Name of the case file, a JSON object; of equal "training" and "data" is the same training.
    Returns: Name of the protocol under which it was trained; empty: no such case has ended.
    """
    own = json.loads((folder / name).read_text(encoding="utf-8"))
    for other in sorted(folder.parents[1].glob(f"*/{folder.name}")):
        if other == folder or not all((other / part).exists() for part in (name, *LEFT)):
            continue
        found = json.loads((other / name).read_text(encoding="utf-8"))
        if all(found.get(key) == own[key] for key in ("training", "data")):
            _copy(other, folder)
            return other.parent.name
    return ""


def _copy(source: Path, folder: Path) -> None:
    """Copy what a training left; what says that it has ended comes last."""
    shutil.rmtree(folder / "model", ignore_errors=True)
    with new_folder(folder / "model") as model:
        shutil.copytree(source / "model", model, dirs_exist_ok=True)
    for name in LEFT[1:]:
        write_text(folder / name, (source / name).read_text(encoding="utf-8"))
