"""A case's own folder: what it leaves there, and what of it another run of the same case goes on with."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path

from splatproof.base.files import read_json, write_text
from splatproof.base.folders import SUFFIX
from splatproof.suites.environment import git_commit, package_version
from splatproof.suites.marks import FOLDER as MARKS
from splatproof.suites.records import RECORD_NAME
from splatproof.suites.same_model import CASE_NAME, CURVE, TRAINED

TRACEBACK = "failure.txt"
"""File of a case that failed, beside its record."""
OURS = (
    RECORD_NAME, TRAINED, CURVE, TRACEBACK,
    "renders", "truth", "masks", "errors", "seams", "blocks", "model", "checkpoint", MARKS, CASE_NAME,
)  # fmt: skip
"""Everything that a case leaves in its folder; last, by what the folder is known to be a case's."""


def clear(folder: Path) -> None:
    """Remove everything that a case leaves in its folder, and nothing else."""
    for name in OURS:
        for path in (folder / name, folder / (name + SUFFIX)):
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


def prepare(
    folder: Path, made_of: Mapping[str, object], origin: Mapping[str, object], *, resume: bool
) -> str:
    """Leave in the folder only what belongs to this very case, and no record.

    Args:
        folder: The case's own folder; made if it is not there.
        made_of: All that what lies there must have been made of to be gone on with; its "key" among it.
        origin: What the key was made of: it only explains what the key means, by which errors name what differs.
        resume: Whether to go on with what is there.
    Returns: The code by which the case was begun, where that is another; else "".
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, code = folder / CASE_NAME, git_commit() or package_version("splatproof")
    before = read_json(path) if path.exists() else {}
    same = {name: before.get(name) for name in made_of} == made_of
    begun = any((folder / name).exists() for name in (TRAINED, "checkpoint"))
    by = before.get("code", code)  # an earlier release does not say it
    if not (same and begun and resume):
        if before:  # what a kill leaves of it is known as a case's, and goes on as none
            write_text(path, json.dumps(before | {"key": ""}) + "\n")
        clear(folder)
        write_text(path, json.dumps({**made_of, "origin": origin, "code": code}) + "\n")
        by = code
    for name in (RECORD_NAME, TRACEBACK):
        (folder / name).unlink(missing_ok=True)
    return by if by != code else ""
