"""docs/claims.md: what of five papers and of ourselves holds here, findings against a paper first."""

import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from splatproof.reports.claims.claim import HOUSE
from splatproof.reports.findings.finding import Finding
from splatproof.reports.statistics import MISSED
from splatproof.reports.verdicts import SETTLED, Verdict

ORDER: tuple[Verdict, ...] = (
    "contradicted", "no difference", "direction only", "undecided", "holds", "too short to judge",
    "not testable here",
)  # fmt: skip
"""Verdicts, what goes against a claim first and what says nothing last."""
AGAINST: tuple[Verdict, ...] = ("contradicted", "no difference", "direction only")
UNJUDGED: tuple[Verdict, ...] = ("too short to judge", "not testable here")
OURS = "this project"
"""What the page calls HOUSE."""
assert set(ORDER) == set(get_args(Verdict))


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A picture that a suite's page shows."""

    path: str
    """Relative to the page."""
    caption: str


@dataclass(frozen=True, kw_only=True)
class Sources:
    """What the page may link to."""

    pictures: Mapping[str, Sequence[Shown]]
    """Pictures of each suite that has a page, by its name; the page is SUITE.md."""
    charts: Sequence[Shown]
    """Charts of the page itself."""
    machines: Sequence[str]
    """Where it was measured."""


def render_page(found: Sequence[Finding], sources: Sources) -> str:
    """The whole page.

    Args:
        found: Every claim with what came of it.
        sources: Pictures and pages that are linked.
    """
    papers = list(dict.fromkeys(one.paper for one in found if one.paper != HOUSE))
    papers = [*sorted(papers), *([HOUSE] if any(one.paper == HOUSE for one in found) else [])]
    against = sorted(
        (one for one in found if one.verdict in AGAINST),
        key=lambda one: (one.paper == HOUSE, ORDER.index(one.verdict)),
    )
    parts = [
        "# Claims, and what became of them\n",
        f"{_in_words(found)}\n",
        summary(found, papers),
        ABOUT.format(
            rows=", ".join(_files(found)) or "none yet",
            machines="; ".join(sources.machines) or "nothing yet",
            settled=SETTLED,
            missed=round(100 * MISSED),
        ),
        "## What came out against its claim, papers first\n",
        _table(against, sources) if against else "Nothing so far.\n",
        *(f"![{shown.caption}]({shown.path})\n\n{shown.caption}\n" for shown in sources.charts),
        *(_paper(name, [one for one in found if one.paper == name], sources) for name in papers),
    ]
    return "\n".join(parts).rstrip() + "\n"


def _files(found: Sequence[Finding]) -> list[str]:
    """Where the rows are kept that claims were judged by."""
    return sorted({f"{one.suite}.json" for one in found if one.suite and one.runs})


def summary(found: Sequence[Finding], papers: Iterable[str]) -> str:
    """How many claims of each paper have which verdict, as a Markdown table.

    Args:
        found: Every claim with what came of it.
        papers: Papers in the order of the lines.
    """
    counts = Counter((one.paper, one.verdict) for one in found)
    lines = [
        "| of | claims | " + " | ".join(ORDER) + " |",
        "|---|---:" + "|---:" * len(ORDER) + "|",
    ]
    for paper in papers:
        own = [counts[paper, verdict] for verdict in ORDER]
        cells = [str(n) if n else "" for n in own]
        lines.append(f"| {_title(paper)} | {sum(own)} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _title(paper: str) -> str:
    return OURS if paper == HOUSE else paper


def _paper(name: str, found: Sequence[Finding], sources: Sources) -> str:
    """One paper: a table of what was measured, and what is missing for the rest."""
    measured = [one for one in found if one.verdict != "not testable here"]
    rest = [one for one in found if one.verdict == "not testable here"]
    parts = [f"## {_title(name)[0].upper()}{_title(name)[1:]}\n"]
    if measured:
        ordered = sorted(measured, key=lambda one: ORDER.index(one.verdict))
        parts.append(_table(ordered, sources))
    if rest:
        parts.append("Not testable here, by what is missing:\n")
        groups = itertools.groupby(sorted(rest, key=_missing), key=_missing)
        parts.append("\n".join(_group(reason, list(own)) for reason, own in groups) + "\n")
    return "\n".join(parts)


def _missing(one: Finding) -> str:
    return one.reason


def _group(reason: str, found: Sequence[Finding]) -> str:
    lines = [f"- **{reason}**"]
    for one in found:
        asked = f": {one.asked}" if one.asked else ""
        rows = f", {_experiment(one)}" if one.suite else ""
        source = f" ({_source(one)})" if one.source else ""
        lines.append(f"  - {one.text}{asked}{source}{rows}")
    return "\n".join(lines)


def _table(found: Sequence[Finding], sources: Sources) -> str:
    lines = [
        "| verdict | claim | printed or asked | here, 95 % interval | seeds | why | pictures |",
        "|---|---|---:|---:|---:|---|---|",
    ]
    for one in found:
        claim = "<br>".join(filter(None, (f"**{one.text}**", _source(one), _experiment(one))))
        verdict = one.verdict if one.verdict in UNJUDGED else f"**{one.verdict}**"
        cells = (verdict, claim, one.asked, one.here,
                 str(one.seeds or ""), one.reason, _links(one, sources))  # fmt: skip
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _source(one: Finding) -> str:
    return f"{one.paper}, {one.source}" if one.source else ""


def _experiment(one: Finding) -> str:
    """What is compared, in code."""
    if one.check:
        return f"check `{one.check}`"
    rows = " − ".join(f"`{row}`" for row in one.rows)
    return f"{one.suite}: {rows}, {one.metric}" + (f", {one.protocol}" if one.protocol else "")


def _links(one: Finding, sources: Sources) -> str:
    """Pictures of the rows, and the page of their suite; of a check the chart of all checks."""
    if one.check:
        return " ".join(f"[chart]({s.path})" for s in sources.charts if "checks" in s.path)
    shown = sources.pictures.get(one.suite)
    if shown is None or not one.runs:
        return ""
    strips = [
        f"[{row}]({picture.path})"
        for row in one.rows
        for picture in shown
        if picture.caption.startswith(f"{row}, ")
    ]
    curves = [f"[curves]({s.path})" for s in shown if s.path.endswith("curves.png")]
    return " ".join([*strips, *curves, f"[{one.suite}]({one.suite}.md#pictures)"])


def _in_words(found: Sequence[Finding]) -> str:
    """What of the papers' claims and of ours could be judged, in a sentence each."""
    sentences = []
    for whose, own in (
        ("the papers", [one for one in found if one.paper != HOUSE]),
        (OURS, [one for one in found if one.paper == HOUSE]),
    ):
        counts = Counter(one.verdict for one in own)
        judged = [f"{counts[v]} {v}" for v in ORDER if counts[v] and v not in UNJUDGED]
        rest = [f"{counts[v]} are {v}" for v in UNJUDGED if counts[v]]
        told = ", ".join(judged) or "none can be judged yet"
        sentences.append(
            f"Of {len(own)} claims of {whose}: **{told}**; {', '.join(rest) or 'no other'}."
        )
    return "\n".join(sentences)


ABOUT = """Made by `bench claims --page docs/claims.md` from the committed rows of the suites' pages
({rows}) and of the checks
([claims_checks.json](claims_checks.json)); a test compares. `bench claims` prints the same table, `--runs` judges other runs,
`--run` makes what is missing. Measured on {machines}. Printed effects are computed from the papers' tables
(`bench published`); scenes here are other and smaller ones: a verdict is about the effect, not about
the papers' numbers. It takes three seeds or more and a paired bootstrap over images and seeds (`reports/verdicts.py`),
over seeds alone of what has no value for each image (sizes, costs, errors of depth and surface). Scenes are those that are named, no
sample of others. Simulated with three seeds, such intervals miss the truth in 5 of 100 experiments, and in up to {missed} where images
are three to six and one of them decides; each claim is judged by itself, so that of many some err:

- **holds**: the 95 % interval excludes 0 on the claimed side and reaches half the printed effect, or reaches the bar;
  **direction only**: it excludes 0 and ends below half the printed effect; **no difference**: it contains 0;
- **contradicted**: it lies on the other side of 0, or misses the bar; **undecided**: it has both sides of the bar;
- too short to judge: fewer than three seeds, nothing was ever densified, a photo is known to have been visited fewer times than a
  suite asks for (city: 40), or a row still changed by more than {settled} dB
  (a tenth, of sizes and times) and by more than the difference of the two rows, or what parts it from the bar, with further steps, as
  rows of half and twice the steps foretell it;
- not testable here: a method, a suite, a row or an idle machine is missing.
"""
