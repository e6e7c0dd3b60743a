"""docs/first_model.md from docs/first_model.json: what a stranger typed, what was printed, how long it took."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

PROGRESS = re.compile(r"\d+/\d+ .*left$|\d+/\d+$")
"""A line of progress, of which only the last of a row is shown."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One command of a trial."""

    command: str
    seconds: float
    """Wall time; of `bench view` until the first sharp picture stands in the browser."""
    lines: tuple[str, ...]
    """What it printed, stdout and stderr as they came."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A set of photos, from its folder to a model in the browser."""

    name: str
    photos: str
    """What was photographed, and how."""
    steps: tuple[Step, ...]
    pictures: tuple[str, ...]
    """Screenshots below docs/images/first_model."""


@dataclass(frozen=True, kw_only=True)
class Record:
    """All trials, and the set-up that they share."""

    machine: str
    setup: tuple[Step, ...]
    trials: tuple[Trial, ...]


def shortened(lines: Sequence[str]) -> list[str]:
    """Lines in which each row of progress is its last line, with how many came before it.

    Args:
        lines: As they were printed.
    """
    kept: list[str] = []
    row: list[str] = []
    for line in [*lines, ""]:
        if PROGRESS.search(line):
            row.append(line)
            continue
        if len(row) > 1:
            many = len(row) - 1
            kept.append(f"[{many} line{'s' if many > 1 else ''} of progress]")
        kept += row[-1:]
        row = []
        kept.append(line)
    return kept[:-1]


def total(record: Record, trial: Trial) -> float:
    """Seconds of all commands of a trial, the set-up among them.

    Args:
        record: With the set-up.
        trial: One of its trials.
    """
    return sum(step.seconds for step in (*record.setup, *trial.steps))


def page(record: Record, words: str) -> str:
    """The page.

    Args:
        record: What happened.
        words: What stands before the transcripts.
    """
    rows = [
        f"| {trial.name} | {trial.photos} | {len(record.setup) + len(trial.steps)} | "
        f"{sum(step.seconds for step in trial.steps):.0f} s | {total(record, trial):.0f} s |"
        for trial in record.trials
    ]
    table = [
        "| photos | what they show | commands | ingest, fit, view | with the set-up |",
        "|---|---|---|---|---|", *rows,
    ]  # fmt: skip
    parts = [
        words, "\n".join(table), f"Machine: {record.machine}.", "## Set-up, once",
        *map(_shown, record.setup),
    ]  # fmt: skip
    for trial in record.trials:
        parts += [f"## {trial.name}", f"{trial.photos}.", *map(_shown, trial.steps)]
        parts += [f"![{_alt(trial, one)}](images/first_model/{one})" for one in trial.pictures]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _shown(step: Step) -> str:
    """A command, its lines, its seconds."""
    lines = "\n".join([f"$ {step.command}", *shortened(step.lines), f"[{step.seconds:.0f} s]"])
    return f"```text\n{lines}\n```"


def _alt(trial: Trial, picture: str) -> str:
    return f"{trial.name}: {picture.removesuffix('.jpg').partition('_')[2].replace('_', ' ')}"
