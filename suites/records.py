"""The record of a case on disk: <case folder>/record.json, written whole or not at all."""

from pathlib import Path

from splatproof.base.errors import DataError
from splatproof.base.files import read_text, write_text
from splatproof.reference.types.result import Result
from splatproof.reference.types.result_json import result_from_json, result_to_json

RECORD_NAME = "record.json"


def write_record(folder: str | Path, result: Result) -> None:
    """Write <folder>/record.json as one line of JSON; a kill leaves the old one or the new one.

    Args:
        folder: Folder of the case.
        result: What came out of it.
    Raises: DataError naming the field that could not be read again: a method may have said it otherwise.
    """
    folder, text = Path(folder), result_to_json(result)
    result_from_json(text, f"record of method {result.method}")
    write_text(folder / RECORD_NAME, text + "\n")


def read_record(folder: str | Path) -> Result:
    """The result in <folder>/record.json.

    Raises: DataError naming the file and the fault when it is missing, damaged or of another version.
    """
    folder = Path(folder)
    path = folder / RECORD_NAME
    if not path.exists():
        raise DataError(f"{path}: no record. Expected the folder of a case that has ended")
    return result_from_json(read_text(path), str(path))


def read_finished(folder: Path) -> list[Result]:
    """The results of all finished cases below a folder, by path; damaged and failed records are none.

    Hidden folders are left out: they hold what was replaced.
    """
    return [result for result in read_ended(folder) if not result.error]


def read_ended(folder: Path) -> list[Result]:
    """As `read_finished`, with those that failed."""
    found = []
    for path in sorted(folder.rglob(RECORD_NAME)):
        if any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        try:
            found.append(read_record(path.parent))
        except DataError:
            continue
    return found
