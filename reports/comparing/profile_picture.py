"""A performance profile as a picture."""

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from splatproof.reports.comparing.aggregates import Aggregate

BASE, NEW = "#6b7280", "#1d4ed8"


def draw_profile(one: Aggregate) -> bytes:
    """A PNG of both sides' profiles: how many scores gain at least so much on BASE's mean of their image.

    Args:
        one: The aggregate; a metric that is compared by ratios is drawn in logarithms.
    """
    figure = Figure(figsize=(6.4, 3.6), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    profile = one.profile
    for shares, colour, name in ((profile.base, BASE, "BASE"), (profile.new, NEW, "NEW")):
        axes.step(profile.thresholds, shares[0], where="mid", color=colour, label=name)
        axes.fill_between(
            profile.thresholds, shares[1], shares[2], step="mid", color=colour, alpha=0.18, linewidth=0
        )  # fmt: skip
    axes.axvline(0, color="black", linewidth=0.6, linestyle=":")
    unit = (
        " (logarithm)"
        if one.measure.relative
        else f" [{one.measure.unit}]"
        if one.measure.unit
        else ""
    )
    axes.set_xlabel(f"gain in {one.measure.metric} on BASE's mean of the same image{unit}")
    axes.set_ylabel("share of runs x images")
    axes.set_ylim(0, 1)
    axes.set_xlim(profile.thresholds[0], profile.thresholds[-1])
    axes.set_title(
        f"{one.suite}/{one.protocol}, {one.row}: {one.scores} scores, {one.scenes} scene"
        + "s" * (one.scenes > 1),
        fontsize=10,
    )
    axes.legend(frameon=False)
    axes.grid(alpha=0.25)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
