"""A comparison as Markdown for a pull request: the verdict on top, details folded."""

from collections.abc import Sequence

from splatproof.reports.comparing import wording
from splatproof.reports.comparing.aggregates import Aggregate
from splatproof.reports.comparing.compare import Comparison
from splatproof.reports.text import escaped, table_line

LOUD = {"worse": "**worse**", "better": "**better**"}


def markdown(
    found: Comparison, aggregates: Sequence[Aggregate], pictures: Sequence[tuple[str, str]]
) -> str:
    """The comparison as a Markdown document of GitHub's dialect.

    Args:
        found: What was compared.
        aggregates: What is said of whole suites beside the means.
        pictures: Pairs (what a picture shows, its path as seen from the document).
    """
    line = escaped(wording.verdict_line(found))
    blocks = [
        f"### {line}",
        f"BASE `{found.base}`, NEW `{found.new}`. {escaped(wording.method_line(found))}.",
    ]
    changed = [one for one in wording.ordered(found) if one.verdict in LOUD]
    if changed:
        blocks.append(_table(wording.HEADINGS, [wording.texts(one) for one in changed]))
    if counters := wording.counters_shown(found):
        table = _table(wording.COUNTERS, [wording.counter_texts(one) for one in counters])
        more = any(one.verdict == "worse" for one in counters)
        blocks.append(table if more else _folded(f"Counters ({len(counters)} differ)", table))
    if found.differing:
        rows = [[d.kind, d.name, d.base, d.new, d.where] for d in found.differing]
        blocks += ["What differed:", _table(("", "name", "BASE", "NEW", "where"), rows)]
    elif found.compared:
        blocks.append("Commit, settings, data and environment are the same on both sides.")
    said = wording.remarks(found)
    loud = [f"- {escaped(text)}" for text in said[: len(found.failures)]]
    if loud:
        blocks.append("\n".join(loud))
    if pictures:
        shown = [f"![{escaped(what)}]({path.replace(' ', '%20')})" for what, path in pictures]
        blocks.append(_folded("Pictures", "\n\n".join(shown)))
    judged = [one for one in wording.ordered(found) if one.verdict != "not judged"]
    if len(judged) > len(changed):
        rows = [[*wording.texts(one), one.reason] for one in judged]
        every = _table((*wording.HEADINGS, "why"), rows)
        blocks.append(_folded(f"All {len(judged)} comparisons", f"{every}\n\n{wording.LEGEND}"))
    if aggregates:
        rows = [wording.aggregate_texts(one) for one in aggregates]
        blocks.append(_folded("Whole suites", _table(wording.AGGREGATES, rows)))
    quiet = [f"- {escaped(text)}" for text in said[len(found.failures) :]]
    if quiet:
        blocks.append(_folded(f"Not compared or not judged ({len(quiet)})", "\n".join(quiet)))
    return "\n\n".join(blocks) + "\n"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [table_line(headings), table_line([":---"] * len(headings))]
    lines += [table_line([LOUD.get(cell, escaped(cell)) for cell in row]) for row in rows]
    return "\n".join(lines)


def _folded(title: str, content: str) -> str:
    """Content that is shown on a click; GitHub wants empty lines around it."""
    return f"<details><summary>{title}</summary>\n\n{content}\n\n</details>"
