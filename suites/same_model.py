"""Cases that differ in the rules of scoring alone: their model is trained once and taken over."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError
from splatproof.base.files import read_json, read_text, write_text
from splatproof.base.folders import new_folder
from splatproof.methods.contracts.reconstruction import Origin, describe, write_description
from splatproof.suites.case_keys import case_key
from splatproof.suites.suite_files import Case

CASE_NAME = "case.json"
"""File that says what the case in its folder is made of."""
TRAINED, CURVE = "trained.json", "curve.jsonl"
"""Files of what training cost, there once it has ended, and of its course."""
SAID_AGAIN = ("format", "version", "kind", "origin", "arrays_sha256", "versions")
"""What every model.json says, whatever kind of model it describes."""


def training_key(case: Case, backend: str) -> str:
    """Hash of what a case's model depends on: `case_key` without the rules of scoring.

    Args:
        case: What is run.
        backend: Name of the rasterizer that runs it.
    Returns: SHA-256 in hexadecimal.
    """
    plain = replace(
        case.protocol, name="", source="", rounding="round", region="full", appearance="none",
        metrics=(), parts=(), colour_fit=(),
    )  # fmt: skip
    return case_key(replace(case, protocol=plain), backend)


def take_model(
    folder: Path, others: Sequence[tuple[Path, str]], data: Mapping[str, str], origin: Origin
) -> bool:
    """Copy the model, its curve and its costs from the first case that has trained the same.

    Args:
        folder: The case's own folder.
        others: Folders of cases with the same `training_key`, and each one's `case_key`: a folder that
            holds another case, of settings of before, is passed over.
        data: Facts of the scene's files; a case of other files is passed over.
        origin: What the copy says of where it comes from.
    Returns: Whether there was one.
    """
    for other, key in others:
        if not (other / TRAINED).is_file():
            continue
        made = made_of(other)
        if (made.get("key"), made.get("data")) != (key, data):
            continue
        with new_folder(folder / "model") as copy:
            shutil.copytree(other / "model", copy, dirs_exist_ok=True)
            told = describe(copy)
            facts = {name: told[name] for name in told.keys() - SAID_AGAIN}
            write_description(copy, told["kind"], origin, facts)
        shutil.copyfile(other / CURVE, folder / CURVE)
        spent = json.loads(read_text(other / TRAINED))
        spent["facts"]["trained in"] = made["case"]
        write_text(folder / TRAINED, json.dumps(spent))
        return True
    return False


def made_of(folder: Path) -> dict[str, Any]:
    """What an earlier run says that the case in this folder is made of; {} where there is none."""
    try:
        return dict(read_json(folder / CASE_NAME))
    except (DataError, ValueError, TypeError):
        return {}
