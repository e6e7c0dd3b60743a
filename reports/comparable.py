"""Whether the rows of a table may be compared: truth, split, and where they were measured."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from splatproof.reports.frames import ENVIRONMENT, FACTS, cases_of, count_distinct, groups, records

DATA = ("model_sha256", "cameras_sha256", "photos_sha256", "files_sha256")
"""Facts of a scene that name its files, and nothing of code or machine."""
OF_PLACES = (
    "python", "splatproof", "torch", "numpy", "pycolmap", "opencv-contrib-python-headless", "commit",
    "platform", "cpu", "cores", "threads", "simd", "backend", "memory", "compiler", "gpu", "gsplat",
)  # fmt: skip
"""What the environment of a record says of machine and code. It also keeps what methods tell of their own
work, such as a plan, which differs from seed to seed and makes nothing incomparable."""
WEIGHTS = "weights of "
"""How the environment names the file of a metric's network, which has to be the same one, too."""
OF_METHODS = ("gradients by",)
"""What a method tells that times of one row depend on, and that may differ between rows."""
PLAN = "plan: "
"""How the environment names what a method chose by itself: a plan of another seed may take another path."""
MIN_SEEDS = 3
"""A row with fewer seeds is shown but not ranked."""


def truth_faults(images: pd.DataFrame) -> list[str]:
    """Why the scores of one scene must not be compared; empty when they may be.

    Args:
        images: Rows of `results_frame`: finished cases of one scene under one protocol.
    Returns: One line a kind of fault, naming an example: other test images, other pixels of the
        same image, another split, other files under the scene's name.
    """
    facts = [name for name in DATA if FACTS + name in images]
    named = ["case", "row", "scene", "seed", "split_sha256", *(FACTS + name for name in facts)]
    cases = records(cases_of(images), named)
    truths = {
        case: dict(zip(own["image"], own["truth_sha256"], strict=True))
        for case, own in groups(images.dropna(subset=["image"]), "case")
    }
    faults = []
    for case in cases[1:]:
        hashes = truths.get(cases[0]["case"], {}), truths.get(case["case"], {})
        faults += [
            f"{text}, so no row of {case['scene']} is ranked: {_name(cases[0])} and {_name(case)}"
            for text in _faults(cases[0], case, hashes, facts)
        ]
    return faults[:3]


def _faults(
    one: Mapping[Any, Any],
    other: Mapping[Any, Any],
    hashes: tuple[dict[str, str], dict[str, str]],
    facts: list[str],
) -> list[str]:
    odd = sorted(hashes[0].keys() ^ hashes[1].keys())
    if odd:
        return [f"test images differ ({odd[0]} was scored in one only)"]
    changed = sorted(name for name in hashes[0] if hashes[0][name] != hashes[1][name])
    if changed:
        return [f"truth pixels differ in {len(changed)} images, e.g. {changed[0]}"]
    if one["split_sha256"] != other["split_sha256"]:
        return ["the training images differ"]
    pairs = {name: (one[FACTS + name], other[FACTS + name]) for name in facts}
    files = [name for name, pair in pairs.items() if None not in pair and pair[0] != pair[1]]
    return [f"the scene's files differ ({', '.join(files)})"] if files else []


def _name(case: Mapping[Any, Any]) -> str:
    return f"{case['row']} seed {case['seed']}"


def environment_notes(cases: pd.DataFrame) -> list[str]:
    """A line naming what differs between the machines and versions that results come from.

    Args:
        cases: Rows of `results_frame`.
    """
    told = [str(c).removeprefix(ENVIRONMENT) for c in cases if str(c).startswith(ENVIRONMENT)]
    names = [n for n in told if n in OF_PLACES + OF_METHODS or n.startswith(WEIGHTS)]
    odd = [name for name in names if _differs(cases, name)]
    if not odd:
        return []
    where = f"measured in different environments (other {', '.join(odd)})"
    return [f"{where}: times and memory are not comparable between them"]


def _differs(cases: pd.DataFrame, name: str) -> bool:
    """Whether a value of the environment differs where methods do not bring the difference."""
    if name in OF_METHODS:
        chosen = [str(c) for c in cases if str(c).startswith(ENVIRONMENT + PLAN)]
        unplanned = cases.loc[cases[chosen].isna().all(axis=1), :]
        return any(
            count_distinct(own, ENVIRONMENT + name) > 1 for _, own in groups(unplanned, "row")
        )
    return count_distinct(cases, ENVIRONMENT + name) > 1


def unranked_reason(seeds: int, rules: dict[str, object]) -> str:
    """Why a row is not ranked, whatever the other rows are; empty when it may be.

    Args:
        seeds: Number of finished seeds behind the row.
        rules: Rules of their protocol.
    """
    if rules.get("appearance") == "oracle":
        return "unranked: oracle appearance"
    if seeds < MIN_SEEDS:
        return f"unranked: {seeds} seed{'' if seeds == 1 else 's'}"
    return ""
