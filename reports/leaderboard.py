"""Results into tables: one a scene and protocol, and one of means where the scene set is complete."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from splatproof.reference.types.result import Result
from splatproof.reports import comparable, run_data
from splatproof.reports.columns import Column, columns
from splatproof.reports.frames import (
    SETTINGS,
    cases_of,
    count_distinct,
    groups,
    records,
    results_frame,
    rows_where,
)
from splatproof.reports.ranking import ranked
from splatproof.reports.statistics import Summary, summarise
from splatproof.reports.table import Row, Table

Found = Mapping[str, Result]
"""Results by `case` of the frame: rows of tables carry them for their curves and pictures."""


def build_tables(results: Iterable[Result]) -> list[Table]:
    """Every table that the results allow; two protocols never meet in one.

    All numbers are read from `results_frame`. Protocols of the same name but with other rules are
    different protocols. Rows are ordered and ranked by the protocol's first metric; the rank counts
    the rows that are better by the paired bootstrap, so rows that it cannot tell apart share one. A
    row needs three seeds to be ranked.

    Args:
        results: Results of any suites, scenes, methods, seeds and protocols; failed ones included.
            Where several are of one case, the last counts.
    Returns: For each suite and protocol first the means over scenes, where the suite has several
        scenes, then its scenes by name; means that no row has yet come last.
    Raises: DataError where a protocol names no metric.
    """
    found = {run_data.case_key(result): result for result in results}
    frame, tables = results_frame(found.values()), []
    for _, suite in groups(frame, "suite"):
        for protocol, named in groups(suite, "protocol"):
            warnings = []
            if count_distinct(named, "rules_sha256") > 1:
                warnings = [f"protocol {protocol} has other rules in another table of this report"]
            for _, same in groups(named, "rules_sha256"):
                tables += _protocol_tables(same, found, warnings)
    return tables


def _protocol_tables(images: pd.DataFrame, found: Found, warnings: list[str]) -> list[Table]:
    """The tables of one suite under one protocol: of means where it has several scenes, of each."""
    labels = _labels(images)
    labelled = images.assign(label=[labels[case] for case in images["case"]])
    scenes = [_scene_table(scene, found, warnings) for _, scene in groups(labelled, "scene")]
    declared = sorted({scene for case in labels for scene in found[case].suite_scenes})
    if len(declared) < 2:
        return scenes
    means = _mean_table(scenes, declared, warnings)
    # nobody opens a page to see that there is nothing yet
    return [means, *scenes] if any(row.cells for row in means.rows) else [*scenes, means]


def _labels(images: pd.DataFrame) -> dict[str, str]:
    """Label of every case: the method, and what sets its settings apart.

    Settings set a row apart only where some scene has one method with several; a suite may give
    every scene its own settings and still mean one row.
    """
    names = [str(name) for name in images.columns if str(name).startswith(SETTINGS)]
    labels = {}
    for method, own in groups(cases_of(images), "row"):
        several = any(count_distinct(one, "settings_sha256") > 1 for _, one in groups(own, "scene"))
        odd = [name for name in names if len(set(map(str, own[name]))) > 1]
        for case in records(own, ["case", *odd]):
            parts = ", ".join(f"{name.removeprefix(SETTINGS)}={case[name]}" for name in odd)
            labels[case["case"]] = f"{method} ({parts})" if several else method
    return labels


def _scene_table(images: pd.DataFrame, found: Found, warnings: list[str]) -> Table:
    """The table of one scene under one protocol."""
    first = found[images["case"].iloc[0]]
    shown = columns(first.protocol_rules, [found[case] for case in cases_of(images)["case"]])
    finished, _ = _by_end(images)
    faults = comparable.truth_faults(finished)
    rows, allowed = [], set()
    for label, own in groups(images, "label"):
        done, failed = _by_end(own)
        done = done.sort_values(by=["seed", "image"], kind="stable")
        cases = cases_of(done)
        why = comparable.unranked_reason(len(cases), first.protocol_rules)
        if not why and faults:
            why = "unranked: not comparable"
        if not why:
            allowed.add(label)
        cells = _cells(shown, {c.key: c.values(cases) for c in shown})
        why = why or _undefined(cells, shown)
        told = records(cases_of(failed), ["seed", "error"])
        notes = [why, *(f"seed {case['seed']} failed: {case['error']}" for case in told)]
        rows.append(
            Row(
                label=label,
                results=tuple(found[case] for case in cases["case"]),
                scores=done,
                cells=cells,
                seeds=len(cases),
                note="; ".join(text for text in notes if text),
            )
        )
    table = Table(
        suite=first.suite,
        scene=first.scene,
        protocol=first.protocol,
        rules=first.protocol_rules,
        columns=shown,
        rows=tuple(rows),
        warnings=(*warnings, *faults, *comparable.environment_notes(finished)),
        comparable=not faults,
    )
    return ranked(table, allowed)


def _by_end(images: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Rows of finished and of failed cases."""
    done = (images["error"] == "").to_numpy(dtype=bool)
    return rows_where(images, done), rows_where(images, ~done)


def _cells(shown: Sequence[Column], values: Mapping[str, np.ndarray]) -> dict[str, Summary]:
    """Summary of each column's values, one a seed; no cell where a value is undefined.

    Args:
        shown: The table's columns.
        values: Values of the seeds by the columns' keys; empty: there is no seed.
    """
    cells = {c.key: summarise(values[c.key].tolist()) for c in shown if values[c.key].size}
    return {key: cell for key, cell in cells.items() if not math.isnan(cell.mean)}


def _undefined(cells: Mapping[str, Summary], shown: Sequence[Column]) -> str:
    """Why a row of enough seeds has no rank: the metric that ranks is undefined in one; empty where it is not."""
    if not shown or shown[0].key in cells:
        return ""
    return f"unranked: {shown[0].key} is undefined in a seed"


def _mean_table(scenes: list[Table], declared: list[str], warnings: list[str]) -> Table:
    """Means over scenes; a row that lacks a declared scene gets none.

    A seed's value is the mean of its scenes' values, over the seeds that every scene has.
    """
    first, rows, allowed = scenes[0], [], set()
    shown = tuple(c for c in first.columns if all(c.key in _keys(table) for table in scenes))
    same_truth = all(table.comparable for table in scenes)
    for label in sorted({row.label for table in scenes for row in table.rows}):
        parts = [row for table in scenes for row in table.rows if row.label == label]
        row = _mean_row(label, parts, declared, shown)
        why = row.note or comparable.unranked_reason(row.seeds, first.rules)
        if not why and not same_truth:
            why = "unranked: a scene's rows are not comparable"
        if not why:
            allowed.add(label)
        rows.append(replace(row, note=why or _undefined(row.cells, shown)))
    everything = pd.concat([row.scores for row in rows])
    table = Table(
        suite=first.suite,
        scene="",
        protocol=first.protocol,
        rules=first.rules,
        columns=shown,
        rows=tuple(rows),
        warnings=(*warnings, *_mixed_settings(rows), *comparable.environment_notes(everything)),
        comparable=same_truth,
    )
    return ranked(table, allowed)


def _mean_row(
    label: str, parts: Sequence[Row], declared: list[str], shown: tuple[Column, ...]
) -> Row:
    """The row of a method's means, or of the reason why there are none.

    Args:
        label: What the row is called.
        parts: The method's rows in the tables of scenes, by the scenes' names.
        declared: Scenes of which none may be missing.
        shown: The table's columns.
    """
    scores = pd.concat([row.scores for row in parts])
    results = tuple(result for row in parts for result in row.results)
    scenes = set(scores["scene"])
    missing = [scene for scene in declared if scene not in scenes]
    by_scene = [set(own["seed"]) for _, own in groups(scores, "scene")]
    seeds = set.intersection(*by_scene) if by_scene else set()
    note = f"no mean: lacks {', '.join(missing)}" if missing else ""
    if not missing and not seeds:
        note = "no mean: its scenes share no seed"
    if note:
        return Row(label=label, results=results, scores=scores, cells={}, seeds=0, note=note)
    shared = rows_where(scores, scores["seed"].isin(sorted(seeds)).to_numpy())
    cases = cases_of(shared).sort_values(by=["seed", "scene"])
    means = {c.key: c.values(cases).reshape(len(seeds), -1).mean(axis=1) for c in shown}
    return Row(
        label=label,
        results=tuple(result for result in results if result.seed in seeds),
        scores=shared,
        cells=_cells(shown, means),
        seeds=len(seeds),
    )


def _mixed_settings(rows: Sequence[Row]) -> list[str]:
    """A warning for every row whose scenes were not run with the same settings."""
    return [
        f"{row.label}: its settings differ between the scenes of this mean"
        for row in rows
        if row.cells and count_distinct(row.scores, "settings_sha256") > 1
    ]


def _keys(table: Table) -> set[str]:
    return {column.key for column in table.columns}
