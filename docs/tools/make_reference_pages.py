"""Writes a page for each metric and method, from the registries and docs/words; Sphinx calls it."""

import math
import tomllib
from pathlib import Path
from typing import Any

from setting_tables import table

from splatproof.base.files import write_text
from splatproof.methods.contracts.method import Method
from splatproof.methods.registry import METHODS
from splatproof.metrics.registry import BUILT_IN, Metric
from splatproof.metrics.scene_registry import SCENE_METRICS, SceneMetric

DOCS = Path(__file__).parents[1]
WORDS = DOCS / "words"


def words(name: str) -> dict[str, Any]:
    """What docs/words/NAME.toml says."""
    return tomllib.loads((WORDS / f"{name}.toml").read_text(encoding="utf-8"))


def page_name(name: str) -> str:
    """File name of a metric's or method's page; every other character than letters becomes "-"."""
    return "".join(c if c.isalnum() or c in "_-" else "-" for c in name)


def metric_page(metric: Metric, said: dict[str, Any], plot: str) -> str:
    """The page of a metric of images.

    Args:
        metric: What the registry knows.
        said: `about` and `traps`.
        plot: File name of its plot beside the page; empty: there is none.
    """
    lines = [
        f"# {metric.name}", said["about"],
        f"**Definition.** {metric.source}.",
        f"**Range.** {_range(metric)}",
        "**Masks.** " + ("Only pixels that count are looked at." if metric.masked else
                         "It has no masked form: a protocol that masks a scene with it is refused."),
        f"**Call.** `splatproof.metrics.{metric.name}(image, target, mask=None)`, see [the API](../api.md).",
        "## Traps", "\n".join(f"- {trap}" for trap in said["traps"]),
    ]  # fmt: skip
    if plot:
        lines += [
            "## How it answers",
            f"![{metric.name} against the size of four faults]({plot})",
            (
                "One picture (the courtyard, 240 x 176 pixels) with four faults of growing size: white noise of "
                "0.05 times the size, a blur (standard deviation) and a shift of so many pixels, and "
                "brightness raised by 10 % times the size."
            ),
        ]
    return "\n\n".join(lines) + "\n"


def scene_metrics_page(families: list[dict[str, Any]]) -> str:
    """The page of all metrics of whole scenes.

    Args:
        families: Title, `starts` of the names, `about` and `traps` of each.
    """
    lines = ["# Metrics of a whole scene", "Values that no single pair of images gives."]
    for family in families:
        lines += [f"## {family['title']}", family["about"]]
        rows = [
            f"| `{m.name}` | {_range(m).rstrip('.')} | {m.source.replace('|', chr(92) + '|')} |"
            for m in SCENE_METRICS.values()
            if m.name.startswith(tuple(family["starts"]))
        ]
        lines += ["\n".join(["| name | range | source |", "|---|---|---|", *rows])]
        lines += ["\n".join(f"- {trap}" for trap in family["traps"])]
    return "\n\n".join(lines) + "\n"


def method_page(method: Method, said: dict[str, str]) -> str:
    """The page of a method.

    Args:
        method: What the registry knows.
        said: `paper`, `built` and `missing`.
    """
    place = method.settings.__module__
    lines = [
        f"# {method.name}", f"{method.description[0].upper()}{method.description[1:]}.",
        f"**Paper.** {said['paper']}.",
        f"**What is implemented.** {said['built']}",
        f"**What is not.** {said['missing']}",
        f"```sh\nbench fit {method.name} SCENE --out OUT\n```",
        "## Settings",
        (f"Flags of `bench fit {method.name}`, keys of a suite's table `[cases.settings.{_key(method.name)}]` (with "
        f"`_` for `-`), fields of `{place}.{method.settings.__name__}`. Steps are those of a whole run; a shorter "
        "one shrinks them in proportion."),
        table(method.settings),
    ]  # fmt: skip
    return "\n\n".join(lines) + "\n"


def pages(plots: dict[str, str]) -> dict[str, str]:
    """Every page by its path below docs/.

    Args:
        plots: File name of each metric's plot.
    """
    said, families = words("metrics"), words("scene_metrics")["families"]
    about = words("methods")
    found = {
        f"metrics/{page_name(name)}.md": metric_page(metric, said[name], plots.get(name, ""))
        for name, metric in BUILT_IN.items()
    }
    found["metrics/scene.md"] = scene_metrics_page(families)
    found |= {
        f"methods/{page_name(name)}.md": method_page(method, about[name])
        for name, method in METHODS.items()
    }
    for folder, title, names in (
        ("metrics", "Metrics", [*BUILT_IN, "scene"]), ("methods", "Methods", [*METHODS])
    ):  # fmt: skip
        listed = "\n".join(page_name(name) for name in names)
        found[f"{folder}/index.md"] = (
            f"# {title}\n\n{_INTRO[folder]}\n\n```{{toctree}}\n{listed}\n```\n"
        )
    return found


def write_pages(plots: dict[str, str]) -> None:
    """Write the pages that have changed below docs/metrics and docs/methods; no other page stays there.

    Args:
        plots: File name of each metric's plot.
    """
    made = pages(plots)
    for folder in ("metrics", "methods"):
        for path in (DOCS / folder).glob("*.md"):
            if str(path.relative_to(DOCS)) not in made:
                path.unlink()
    for place, text in made.items():
        path = DOCS / place
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(exist_ok=True)
            write_text(path, text)


_INTRO = {
    "metrics": "Each has one exact name, and two definitions never share a column. Images are height x width x 3 in "
    "[0, 1]. A protocol names the metrics that are taken under it; `bench protocols` lists them.",
    "methods": "`bench fit METHOD SCENE --out OUT`; each page says what of the paper is there and what is not.",
}


def _range(metric: Metric | SceneMetric) -> str:
    low, high = metric.range
    ends = f"{'(' if math.isinf(low) else '['}{low:g}, {high:g}{')' if math.isinf(high) else ']'}"
    better = {True: "higher is better", False: "lower is better", None: "neither way is better"}
    return f"{ends}{' ' + metric.unit if metric.unit else ''}, {better[metric.higher_is_better]}."


def _key(name: str) -> str:
    return name if name.replace("-", "").replace("_", "").isalnum() else f'"{name}"'
