"""Two sides compared as the page shows them: a verdict for each scene and metric."""

import math
from typing import Any

from splatproof.reports.comparing.compare import Compared, compare
from splatproof.reports.comparing.corrections import TOLD
from splatproof.reports.comparing.sides import Side as Cases
from splatproof.reports.dashboard.history_data import CaseOf
from splatproof.reports.dashboard.index import Index
from splatproof.reports.dashboard.numbers import plain_value, short
from splatproof.reports.dashboard.sides import Side


def comparison_payload(one: Side, other: Side, index: Index, case_of: CaseOf) -> dict[str, Any]:
    """The verdicts of `comparing.compare` on two sides.

    Args:
        one: What is compared with.
        other: What is judged.
        index: The store, for the tables that pictures are shown in.
        case_of: Reads what a comparison needs of a run.
    """
    sides = [
        Cases(label=s.label, cases=tuple(case_of(run.run) for run in s.runs)) for s in (one, other)
    ]
    found = compare(*sides)
    tables = {
        brief["scene"]: brief["id"]
        for brief in (table["brief"] for table in index.tables)
        if (brief["suite"], brief["protocol"], brief["rules"])
        == (one.suite, one.protocol, one.rules)
    }
    rows = [_row(compared, one, other, tables) for compared in found.compared]
    return {
        "rows": rows,
        "correction": TOLD[found.correction].format(alpha=found.alpha)
        + f", over {found.tests} comparisons.",
        "notes": [
            *(f"{fault.what}: {fault.why}" for fault in found.not_comparable),
            *(f"{fail.case} fails on {'A' if fail.on == 'BASE' else 'B'} alone: {fail.error}"
              for fail in found.failures),
            *found.remarks,
        ],
        "differed": [[f"{d.kind}: {d.name}" if d.name != d.kind else d.kind,
                      plain_value(d.base), plain_value(d.new)] for d in found.differing],
        "runs": [[run.run for run in side.runs] for side in (one, other)],
    }  # fmt: skip


def _row(compared: Compared, one: Side, other: Side, tables: dict[str, str]) -> dict[str, Any]:
    group, measure, found = compared.group, compared.measure, compared.estimate
    low, high = (
        found.interval(compared.level) if found and compared.level is not None
        else (math.nan, math.nan)
    )  # fmt: skip
    first = [
        next((run.run for run in side.runs if run.numbers.scene == group.scene), None)
        for side in (one, other)
    ]
    difference = found.mean if found else compared.new_mean - compared.base_mean
    return {
        "scene": group.scene,
        "metric": measure.metric,
        "unit": measure.unit,
        "digits": measure.digits,
        "relative": measure.relative,
        "verdict": compared.verdict,
        "reason": compared.reason,
        "a": short(compared.base_mean),
        "b": short(compared.new_mean),
        "mean": short(difference),
        "low": short(low),
        "high": short(high),
        "p": short(compared.corrected_p),
        "detectable": short(compared.detectable),
        "images": compared.images,
        "seeds": list(compared.seeds),
        "table": tables.get(group.scene),
        "runs": first,
    }
