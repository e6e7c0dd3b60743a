"""What was expected of the city methods, and what their numbers say of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

Row = Mapping[str, Any]
Outcome = Literal["confirmed", "refuted", "not measured"]
SAME = 0.1
"""dB of PSNR up to which two rows count as equal; seeds move it by less (StitchGS: 0.02 dB)."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """An expectation and its outcome."""

    claim: str
    outcome: Outcome
    numbers: tuple[str, ...]
    """One line a scene and K."""


def expectations(rows: Sequence[Row]) -> tuple[Verdict, ...]:
    """Each expectation against the means over seeds, scene by scene and K by K.

    An expectation is confirmed if it holds wherever it was measured, and refuted otherwise.
    """
    groups = dict.fromkeys((row["scene"], suffix(row["row"])) for row in rows if row["blocks"] > 1)
    return (
        _verdict(
            "ODBP's blocks differ less in training time (max / mean) than those of grid, "
            "camera-balanced and point-density partitions at equal K.",
            rows, groups, _times,
        ),
        _verdict(
            "SIS + GCR: Seam PSNR at least 1 dB above the hard merge of the same blocks, and a "
            "lower BPD L1.",
            rows, groups, _seams,
        ),
        _verdict(
            "Compression: at least 3 times smaller than the .ply, at most 0.2 dB lost.",
            rows, groups, _bytes,
        ),
        _verdict(
            f"odbp+stitch is not worse than either parent in PSNR (by more than {SAME} dB).",
            rows, groups, _parents,
        ),
    )  # fmt: skip


def suffix(row: str) -> str:
    """Part of a row's variant that says K: "k8" of stitchgs@k8-hard, "" of stitchgs@hard."""
    first = row.partition("@")[2].split("-")[0]
    return first if first[:1] == "k" and first[1:].isdigit() else ""


Check = Callable[[Callable[[str, str], float]], tuple[bool, str] | None]
"""check(value of a row by its plain name and key, nan where there is none)."""


def _verdict(claim: str, rows: Sequence[Row], groups: Mapping, check: Check) -> Verdict:
    held, lines = [], []
    for scene, k in groups:

        def value(row: str, key: str, scene: str = scene, k: str = k) -> float:
            return mean(rows, scene, named(row, k), key)

        found = check(value)
        if found is not None:
            held.append(found[0])
            count = max(r["blocks"] for r in rows if r["scene"] == scene and suffix(r["row"]) == k)
            lines.append(f"{scene}, K = {count}: {found[1]}: {'holds' if found[0] else 'fails'}")
    outcome: Outcome = "not measured" if not held else "confirmed" if all(held) else "refuted"
    return Verdict(claim=claim, outcome=outcome, numbers=tuple(lines))


def named(row: str, k: str) -> str:
    """A row's name among those of K: ("stitchgs@hard", "k8") is stitchgs@k8-hard."""
    if not k:
        return row
    method, _, variant = row.partition("@")
    return f"{method}@{k}-{variant}" if variant else f"{method}@{k}"


def mean(rows: Sequence[Row], scene: str, row: str, key: str) -> float:
    """Mean over seeds; nan where the row or the value is missing."""
    own = [r["values"].get(key, math.nan) for r in rows if (r["scene"], r["row"]) == (scene, row)]
    return sum(own) / len(own) if own else math.nan


def _times(value: Callable[[str, str], float]) -> tuple[bool, str] | None:
    key, ours = "seconds_max_over_mean", value("dpgs-partition", "seconds_max_over_mean")
    others = {n: value(n, key) for n in ("citygaussian", "vastgaussian", "blockgaussian")}
    if math.isnan(ours) or any(map(math.isnan, others.values())):
        return None
    listing = ", ".join(f"{name} {other:.2f}" for name, other in others.items())
    return ours < min(others.values()), f"dpgs-partition {ours:.2f}, {listing}"


def _seams(value: Callable[[str, str], float]) -> tuple[bool, str] | None:
    after = "stitchgs@gcr"
    if math.isnan(value(after, "seam_psnr")):
        after = "stitchgs"
    psnr = [value(row, "seam_psnr") for row in ("stitchgs@hard", after)]
    bpd = [value(row, "bpd_l1") for row in ("stitchgs@hard", after)]
    if any(map(math.isnan, (*psnr, *bpd))):
        return None
    gain = psnr[1] - psnr[0]
    text = (f"Seam PSNR {psnr[0]:.2f} to {psnr[1]:.2f} dB ({gain:+.2f}), "
            f"BPD L1 {bpd[0]:.4f} to {bpd[1]:.4f}")  # fmt: skip
    return gain >= 1 and bpd[1] < bpd[0], text


def _bytes(value: Callable[[str, str], float]) -> tuple[bool, str] | None:
    before, after = value("stitchgs@gcr", "psnr"), value("stitchgs", "psnr")
    ratio = value("stitchgs", "ply_bytes") / value("stitchgs", "packed_bytes")
    if any(map(math.isnan, (before, after, ratio))):
        return None
    return ratio >= 3 and before - after <= 0.2, (
        f"{ratio:.1f} times smaller, PSNR {before:.2f} to {after:.2f} dB"
    )


def _parents(value: Callable[[str, str], float]) -> tuple[bool, str] | None:
    ours = value("odbp+stitch", "psnr")
    parents = {name: value(name, "psnr") for name in ("dpgs-partition", "stitchgs")}
    if any(map(math.isnan, (ours, *parents.values()))):
        return None
    listing = ", ".join(f"{name} {other:.2f}" for name, other in parents.items())
    return ours >= max(parents.values()) - SAME, f"odbp+stitch {ours:.2f} dB, {listing}"
