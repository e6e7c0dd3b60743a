"""Results into tables: one a scene and protocol, and one of means where the scene set is complete."""

import math
from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from splatproof.reference.types.result import Result
from splatproof.reports import comparable, run_data
from splatproof.reports.columns import Column, columns
from splatproof.reports.ranking import ranked
from splatproof.reports.statistics import summarise
from splatproof.reports.table import Row, Table


def build_tables(results: Iterable[Result]) -> list[Table]:
    """Every table that the results allow; two protocols never meet in one.

    Protocols of the same name but with other rules are different protocols. Rows are ordered and
    ranked by the protocol's first metric; the rank counts the rows that are better by the paired
    bootstrap, so rows that it cannot tell apart share one. A row needs three seeds to be ranked.

    Args:
        results: Of any suites, scenes, methods, seeds and protocols; failed ones included.
    Returns: For each suite and protocol first the means over scenes, where the suite has several
        scenes, then its scenes by name.
    Raises: DataError where a protocol names no metric.
    """
    tables = []
    by_protocol = _group(results, lambda r: (r.suite, r.protocol, _rules_key(r)))
    names = _group(by_protocol, lambda key: key[:2])
    for key, group in by_protocol.items():
        warnings = []
        if len(names[key[:2]]) > 1:
            warnings = [f"protocol {key[1]} has other rules in another table of this report"]
        labels = _labels(group)
        scenes = [
            _scene_table(scene, labels, warnings)
            for _, scene in _group(group, lambda r: r.scene).items()
        ]
        declared = sorted({name for result in group for name in result.suite_scenes})
        if len(declared) > 1:
            tables.append(_mean_table(scenes, declared, warnings))
        tables += scenes
    return tables


def _group(items: Iterable[Any], key: Any) -> dict[Any, list[Any]]:
    """Items by their key, keys sorted."""
    groups: dict[Hashable, list[Any]] = defaultdict(list)
    for item in items:
        groups[key(item)].append(item)
    return {name: groups[name] for name in sorted(groups)}  # type: ignore[type-var]


def _rules_key(result: Result) -> str:
    return run_data.digest(result.protocol_rules)


def _labels(results: Sequence[Result]) -> dict[str, str]:
    """Label of every result by `case_key`: the method, and what sets its settings apart.

    Settings set a row apart only where some scene has one method with several; a suite may give
    every scene its own settings and still mean one row.
    """
    labels = {}
    for method, own in _group(results, lambda r: r.row).items():
        scenes = _group(own, lambda r: r.scene).values()
        several = any(len({run_data.digest(r.settings) for r in scene}) > 1 for scene in scenes)
        flat = {run_data.case_key(r): dict(run_data.flatten(r.settings)) for r in own}
        names = {name: None for values in flat.values() for name in values}
        odd = [n for n in names if len({str(values.get(n)) for values in flat.values()}) > 1]
        for key, values in flat.items():
            parts = ", ".join(f"{name}={values.get(name)}" for name in odd)
            labels[key] = f"{method} ({parts})" if several else method
    return labels


def _scene_table(results: list[Result], labels: dict[str, str], warnings: list[str]) -> Table:
    """The table of one scene under one protocol."""
    first = results[0]
    shown = columns(first.protocol_rules, results)
    finished = [result for result in results if not result.error]
    faults = comparable.truth_faults(finished)
    rows, allowed = [], set()
    for label, group in _group(results, lambda r: labels[run_data.case_key(r)]).items():
        done = sorted((r for r in group if not r.error), key=lambda r: r.seed)
        why = comparable.unranked_reason(done, first.protocol_rules)
        if not why and faults:
            why = "unranked: not comparable"
        if not why:
            allowed.add(label)
        notes = [why, *(f"seed {r.seed} failed: {r.error}" for r in group if r.error)]
        cells = {c.key: summarise([c.value(r) for r in done]) for c in shown if done}
        cells = {key: cell for key, cell in cells.items() if not math.isnan(cell.mean)}
        note = "; ".join(text for text in notes if text)
        rows.append(Row(label=label, results=tuple(done), cells=cells, seeds=len(done), note=note))
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


def _mean_table(scenes: list[Table], declared: list[str], warnings: list[str]) -> Table:
    """Means over scenes; a row that lacks a declared scene gets none.

    A seed's value is the mean of its scenes' values, over the seeds that every scene has.
    """
    first, rows, allowed = scenes[0], [], set()
    shown = tuple(c for c in first.columns if all(c.key in _keys(table) for table in scenes))
    same_truth = all(table.comparable for table in scenes)
    parts = [(row.label, table.scene, row.results) for table in scenes for row in table.rows]
    for label, own in _group(parts, lambda part: part[0]).items():
        found = {scene: results for _, scene, results in own if results}
        row = _mean_row(label, found, declared, shown)
        why = row.note or comparable.unranked_reason(range(row.seeds), first.rules)
        if not why and not same_truth:
            why = "unranked: a scene's rows are not comparable"
        if not why:
            allowed.add(label)
        rows.append(replace(row, note=why))
    everything = [result for row in rows for result in row.results]
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
    label: str,
    found: dict[str, tuple[Result, ...]],
    declared: list[str],
    shown: tuple[Column, ...],
) -> Row:
    """The row of a method's means, or of the reason why there are none."""
    results = tuple(result for scene in sorted(found) for result in found[scene])
    missing = [scene for scene in declared if scene not in found]
    if missing:
        note = f"no mean: lacks {', '.join(missing)}"
        return Row(label=label, results=results, cells={}, seeds=0, note=note)
    seeds = sorted(set.intersection(*({r.seed for r in own} for own in found.values())))
    if not seeds:
        note = "no mean: its scenes share no seed"
        return Row(label=label, results=results, cells={}, seeds=0, note=note)
    results = tuple(result for result in results if result.seed in seeds)
    cells = {c.key: summarise(_seed_means(c, results, seeds)) for c in shown}
    cells = {key: cell for key, cell in cells.items() if not math.isnan(cell.mean)}
    return Row(label=label, results=results, cells=cells, seeds=len(seeds))


def _mixed_settings(rows: Sequence[Row]) -> list[str]:
    """A warning for every row whose scenes were not run with the same settings."""
    return [
        f"{row.label}: its settings differ between the scenes of this mean"
        for row in rows
        if row.cells and len({run_data.digest(result.settings) for result in row.results}) > 1
    ]


def _keys(table: Table) -> set[str]:
    return {column.key for column in table.columns}


def _seed_means(column: Column, results: Sequence[Result], seeds: list[int]) -> list[float]:
    return [float(np.mean([column.value(r) for r in results if r.seed == seed])) for seed in seeds]
