"""Results as a pandas table."""

from collections.abc import Iterable
from pathlib import Path

import pandas as pd

from splatproof.api.fitting import Fitted
from splatproof.base.errors import DataError
from splatproof.reference.types.result import Result
from splatproof.reports import frames
from splatproof.reports.store import StoredResult, find_cases, read_results
from splatproof.suites.records import read_record


def results_frame(
    source: str | Path | Iterable[Result | StoredResult | Fitted],
) -> pd.DataFrame:
    """Every scored image as a row, with all that is known of it and of its case.

    Columns: what was run (suite, scene, method, variant, row, protocol, seed, case), image and
    every per-image metric by its name in its own unit, `case.psnr`, ... (a case's means and values
    of whole scenes), train_seconds, render_ms, primitives, bytes_on_disk, peak_memory_mb (2^20
    bytes), `seconds.*`, `counters.*`, `settings.*`, `facts.*`, `environment.*`.

    Args:
        source: Folder of fits or runs, tracking URI ("sqlite:///runs/mlflow.db"), or results.
    Returns: Rows in the order of cases and images; numbers that a case does not have are nan. A
        failed case has one row without image and scores.
    Raises: DataError if no finished case is there or a record is damaged; MissingError if the
        tracking store does not answer.
    Source: ours.
    """
    if not isinstance(source, str | Path):
        return frames.results_frame(
            one.result if isinstance(one, Fitted) else one for one in source
        )
    if "://" in str(source):
        found: list[Result | StoredResult] = [*read_results(str(source))]
    else:
        found = [read_record(folder) for folder in find_cases(Path(source))]
    if not found:
        raise DataError(
            f"{source}: no finished case; expected a folder of `bench run` or `bench fit`, or a "
            "tracking URI such as sqlite:///runs/mlflow.db"
        )
    return frames.results_frame(found)
