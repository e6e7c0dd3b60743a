"""Results as one pandas table, a row an image: what leaderboards read, and anyone in a notebook."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, cast

import numpy as np
import pandas as pd
from jaxtyping import Bool

from splatproof.reference.types.result import ImageScore, Result
from splatproof.reports import run_data
from splatproof.reports.store import StoredResult

CASE, SETTINGS, FACTS, ENVIRONMENT, SECONDS, COUNTERS = (
    "case.", "settings.", "facts.", "environment.", "seconds.", "counters.",
)  # fmt: skip
"""Starts of the names of columns that hold the same value in all rows of a case."""


def results_frame(stored: Iterable[StoredResult | Result]) -> pd.DataFrame:
    """Every scored image as a row, with all that is known of it and of the case that it is from.

    Columns, in this order:

    - suite, scene, method, variant, row (method@variant), protocol, seed: what was run. `case` hashes
      them with all settings and rules, which `settings_sha256` and `rules_sha256` hash alone.
    - image, truth_sha256, valid_share, and every per-image metric by its name (psnr, ...).
    - case.psnr, ...: the case's own value of every metric, so the mean over its images or the value
      of the whole scene (case.seam_psnr pools pixels, case.psnr_of_mean_mse is no mean of images).
    - train_seconds, cpu_seconds, seconds.load and other stages, render_ms (of a frame), primitives,
      bytes_on_disk, peak_memory_mb (2^20 bytes), counters.pairs and other counters: what the case
      cost.
    - error, split_sha256, model_sha256, settings.*, facts.* (of the scene), environment.*: by their
      dotted names, None where a case has none of that name.

    A mean over rows weighs each image once, so a case by its number of images. To look at cases, take
    `frame.drop_duplicates("case")`.

    Args:
        stored: Results of `reports.store.read_results`, or as `suites.records` reads them.
    Returns: Rows in the order of the results and their images; numbers that a case does not have are
        nan. A case without images, such as a failed one, has one row without image and scores.
    Source: ours.
    """
    results = [one.result if isinstance(one, StoredResult) else one for one in stored]
    images = [_images(result) for result in results]
    numbers = [number for number, own in enumerate(images) for _ in own]
    scores = [image for own in images for image in own]
    named = [dict(_named(result)) for result in results]
    parts = [
        pd.DataFrame([_identity(r) for r in results], columns=IDENTITY).iloc[numbers],
        pd.DataFrame(scores, columns=["image", "truth_sha256", "valid_share", *_metrics(results)]),
        pd.DataFrame([_numbers(r) for r in results]).iloc[numbers],
        _objects(named).iloc[numbers],
    ]
    return pd.concat([part.reset_index(drop=True) for part in parts], axis=1)


IDENTITY = [
    "suite", "scene", "method", "variant", "row", "protocol", "seed", "case", "settings_sha256",
    "rules_sha256",
]  # fmt: skip
"""Columns that say which case a row is from."""


def cases_of(frame: pd.DataFrame) -> pd.DataFrame:
    """The first row of each case: for what all rows of a case share.

    Args:
        frame: What `results_frame` gives, or some of its rows.
    """
    return frame.drop_duplicates("case")


# pandas types the results of its indexing too widely to be checked; these say what they are


def rows_where(frame: pd.DataFrame, chosen: Bool[np.ndarray, " n"]) -> pd.DataFrame:
    """Some rows of a frame.

    Args:
        frame: Any frame.
        chosen: True for each row that is kept.
    """
    return frame[chosen]


def groups(frame: pd.DataFrame, by: str) -> list[tuple[str, pd.DataFrame]]:
    """Each value of a column, sorted, and the rows that have it; rows without a value are left out.

    Args:
        frame: Any frame.
        by: Name of a column of text.
    """
    return [(str(value), own) for value, own in frame.groupby(by)]


def records(frame: pd.DataFrame, names: Sequence[str]) -> list[dict[str, Any]]:
    """Each row as a mapping.

    Args:
        frame: Any frame.
        names: Columns that are taken.
    """
    return cast(list[dict[str, Any]], frame[list(names)].to_dict(orient="records"))


def count_distinct(frame: pd.DataFrame, name: str) -> int:
    """Number of different values in a column; a missing one is one more.

    Args:
        frame: Any frame.
        name: Name of the column.
    """
    return int(frame[name].nunique(dropna=False))


def _identity(result: Result) -> dict[str, object]:
    return {
        "suite": result.suite,
        "scene": result.scene,
        "method": result.method,
        "variant": result.variant,
        "row": result.row,
        "protocol": result.protocol,
        "seed": result.seed,
        "case": run_data.case_key(result),
        "settings_sha256": run_data.digest(result.settings),
        "rules_sha256": run_data.digest(result.protocol_rules),
    }


def _images(result: Result) -> list[dict[str, object]]:
    """Scores of each image; one empty row where there is none."""
    return [_image(image) for image in result.images] or [{}]


def _image(image: ImageScore) -> dict[str, object]:
    return {
        "image": image.name,
        "truth_sha256": image.truth_sha256,
        "valid_share": image.valid_share,
        **image.metrics,
    }


def _metrics(results: Sequence[Result]) -> list[str]:
    """Names of all per-image metrics, in the order in which they come first."""
    return list(dict.fromkeys(n for r in results for image in r.images for n in image.metrics))


def _numbers(result: Result) -> dict[str, float]:
    return {
        **{CASE + name: value for name, value in result.metrics.items()},
        "train_seconds": result.training_seconds,
        "cpu_seconds": result.cpu_seconds,
        **{SECONDS + stage: seconds for stage, seconds in result.stages.items()},
        "render_ms": result.render_ms,
        "primitives": result.primitives,
        "bytes_on_disk": result.bytes_on_disk,
        "peak_memory_mb": result.peak_memory_mb,
        **{COUNTERS + name: count for name, count in result.counters.items()},
    }


def _named(result: Result) -> Iterable[tuple[str, object]]:
    yield "error", result.error
    yield "split_sha256", result.split_sha256
    yield "model_sha256", result.model_sha256
    yield from run_data.flatten(result.settings, SETTINGS)
    yield from run_data.flatten(result.scene_facts, FACTS)
    yield from run_data.flatten(result.environment, ENVIRONMENT)


def _objects(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Values as they are, so that 7000 does not become 7000.0 where another case has none."""
    names = dict.fromkeys(name for row in rows for name in row)
    return pd.DataFrame(
        {name: pd.Series([row.get(name) for row in rows], dtype=object) for name in names}
    )
