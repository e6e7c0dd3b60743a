"""`bench baseline`: frozen results as small files in the repository."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.reports.comparing.cases import CaseRecord

FOLDER = Path("baselines")


def save(
    name: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")],
    side: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUNS|STORE")],
    *,
    suite: tuple[str, ...] = (),
    folder: Path = FOLDER,
    replace: bool = False,
) -> None:
    """Freeze results in a file that `bench compare` takes as a side, to be committed.

    The file holds each case's scores (rounded to six digits), settings, rules, environment and hashes,
    and no picture: a few tens of kB a suite. The same results give the same bytes.

    Args:
        name: What the baseline is called; the file is FOLDER/NAME.json.
        side: A folder of runs or a tracking store, as `bench compare` takes them: WHERE[@COMMIT][#ROW].
        suite: Suites that are kept. Without it: all.
        folder: Where baselines are saved.
        replace: Replace the baseline of this name.
    """
    from splatproof.reports.comparing import baselines
    from splatproof.reports.comparing.opening import open_side

    path = baselines.path_of(name, folder)
    if path.exists() and not replace:
        raise UsageError(f"{path}: exists; give --replace to freeze other results under this name")
    found = open_side(side, folder=folder, suites=suite)
    if all(case.measured.error for case in found.cases):
        raise UsageError(f"{found.label}: all {len(found.cases)} cases failed; nothing to hold to")
    baselines.write(path, found.cases)
    for remark in found.remarks:
        output.warn(remark)
    output.emit(*_told(name, path, found.cases))


def list_saved(*, folder: Path = FOLDER) -> None:
    """List saved baselines: suites, cases, the commits that they were measured at, and size.

    Args:
        folder: Where baselines are saved.
    """
    from splatproof.reports.comparing import baselines

    names = baselines.names(folder)
    if not names:
        output.log(f"no baseline in {folder}/; `bench baseline save NAME RUNS` makes one")
    for name in names:
        path = baselines.path_of(name, folder)
        output.emit(*_told(name, path, baselines.read(path, name).cases))


def _told(name: str, path: Path, cases: "tuple[CaseRecord, ...]") -> tuple[dict[str, object], str]:
    """A baseline for machines and for people."""
    from splatproof.reports.comparing.sides import short_commit

    suites = sorted({case.suite for case in cases})
    commits = sorted({short_commit(case.commit) for case in cases if case.commit})
    failed = sum(bool(case.measured.error) for case in cases)
    size = path.stat().st_size
    record: dict[str, object] = {"name": name, "file": str(path), "suites": suites}
    record |= {"cases": len(cases), "failed": failed, "commits": commits, "bytes": size}
    text = f"{name}: {', '.join(suites)}; {len(cases)} cases"
    text += f", {failed} failed" if failed else ""
    text += f"; commit {', '.join(commits) or 'unknown'}; {size / 1000:.0f} kB"
    return record, f"{text} ({path})"


def bands(
    side: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUNS|STORE")],
    *,
    suite: tuple[str, ...] = (),
    folder: Path = FOLDER,
) -> None:
    """Measure the noise of each metric from seeds that repeat the same case.

    Prints the standard deviation from seed to seed, pooled over rows and scenes, which is what a noise
    band should be, beside the band that is declared. Of times, memory and sizes it is a share of the
    value.

    Args:
        side: Results of at least two seeds, as `bench compare` takes them: WHERE[@COMMIT][#ROW].
        suite: Suites that are looked at. Without it: all.
        folder: Where the names of saved baselines are looked up.
    """
    from splatproof.reports.comparing.bands import load_bands, repeated
    from splatproof.reports.comparing.opening import open_side

    found = open_side(side, folder=folder, suites=suite)
    declared = load_bands()
    names = dict.fromkeys(name for case in found.cases for name in sorted(case.measured.values))
    relative = {n: n in declared and declared[n].relative or n in RATIOS for n in names}
    measured = repeated(found.cases, relative)
    if not measured:
        raise UsageError(f"{found.label}: no case was repeated with another seed; run two or more")
    for one in measured:
        band = declared.get(one.metric)
        record = {"metric": one.metric, "relative": one.relative, "deviation": one.deviation}
        record |= {"groups": one.groups, "freedom": one.freedom}
        text = f"{one.metric}: {one.deviation:.3g}{' of the value' if one.relative else ''}"
        text += f" ({one.freedom} degrees of freedom in {one.groups} groups)"
        text += f"; declared {band.value:g} {band.unit}" if band else "; no band declared"
        output.emit(record | {"declared": band.value if band else None}, text)


RATIOS = ("train_seconds", "render_ms", "cpu_seconds", "peak_memory_mb", "disk_mb", "primitives")
"""What is compared by ratios."""
