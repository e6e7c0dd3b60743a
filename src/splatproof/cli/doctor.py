"""`bench doctor`: what this machine has, what is missing and how to get it."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from splatproof.base.errors import SplatproofError
from splatproof.cli import output

LEAST_FREE_GB = 2.0
"""Free disk below which results and made scenes may not fit; in 2^30 bytes."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    topic: str
    """Heading that it stands under."""
    name: str
    """What was looked at."""
    status: Literal["ok", "absent", "fault"]
    """absent: something optional is not there; fault: something essential is not."""
    found: str
    """What there is."""
    fix: str = ""
    """What to do about it; empty: nothing."""


def doctor(*, out: Path = Path("runs")) -> int:
    """Say what this machine has, what is missing and how to get it; exit code 3 on a fault.

    It looks at versions, processor, rasterizers, weights of learned metrics, scenes and folders.

    With --json each finding is a line: topic, name, status (ok, absent, fault), found, fix.

    Args:
        out: Folder of runs: whether it can be written, and whether its tracking store answers.
    """
    faults, topic = 0, ""
    for finding in findings(out):
        faults += finding.status == "fault"
        if not output.wants_json() and finding.topic != topic:
            topic = finding.topic
            output.print_text(topic)
        mark = {"ok": " ", "absent": "-", "fault": "!"}[finding.status]
        text = f" {mark} {finding.name:<18} {finding.found}"
        output.emit(asdict(finding), text + (f"; {finding.fix}" if finding.fix else ""))
    if faults:
        output.warn(f"{faults} fault{'s' if faults > 1 else ''} above, marked with !")
    return 3 if faults else 0


def findings(out: Path) -> Iterator[Finding]:
    """Look at everything, topic by topic.

    Args:
        out: Folder of runs.
    """
    yield from _versions()
    yield from _processor()
    yield from _backends()
    yield from _metrics()
    yield from _adapters()
    yield from _scenes()
    yield from _folders(out)


def _versions() -> Iterator[Finding]:
    from splatproof.suites.environment import environment

    said = environment("")
    for name in ("splatproof", "commit", "python", "torch", "numpy", "pycolmap", "platform"):
        yield Finding(topic="versions", name=name, status="ok", found=said[name] or "unknown")


def _processor() -> Iterator[Finding]:
    import torch

    from splatproof.suites.environment import cpu_model, simd_level, usable_cores

    said = {"cpu": cpu_model(), "cores": usable_cores(), "threads": torch.get_num_threads()}
    for name, value in said.items():
        yield Finding(topic="processor", name=name, status="ok", found=str(value))
    level = simd_level()
    yield Finding(
        topic="processor",
        name="simd",
        status="ok" if level else "fault",
        found=level or "the native kernels are not built",
        fix="" if level else "install a C++ compiler and run `pip install .`",
    )


def _backends() -> Iterator[Finding]:
    from splatproof.methods.contracts.backends import describe_backends

    for backend in describe_backends():
        absent = "fault" if backend.name == "cpu" else "absent"
        yield Finding(
            topic="backends",
            name=backend.name,
            status=absent if backend.missing else "ok",
            found="missing" if backend.missing else ", ".join(sorted(backend.capabilities)),
            fix=backend.missing,
        )


def _metrics() -> Iterator[Finding]:
    """Metrics of other packages, and the weights that any metric needs."""
    from splatproof.metrics.registry import BUILT_IN, GROUP, all_metrics

    metrics = BUILT_IN
    try:
        metrics = all_metrics()
    except SplatproofError as error:
        yield Finding(
            topic="metrics", name=GROUP, status="fault", found="not usable", fix=str(error)
        )
    for name, metric in metrics.items():
        if name not in BUILT_IN:
            yield Finding(topic="metrics", name=name, status="ok", found=metric.source)
    for metric in metrics.values():
        if metric.load_weights is None:
            continue
        try:
            found, fix = f"sha256 {metric.load_weights()}", ""
        except SplatproofError as error:
            found, fix = "missing", str(error)
        status = "absent" if fix else "ok"
        yield Finding(topic="weights", name=metric.name, status=status, found=found, fix=fix)


def _adapters() -> Iterator[Finding]:
    """Kinds of scene folders that can be opened, those of other packages included."""
    from splatproof.datasets.catalogue.opening import ADAPTERS, GROUP, all_adapters

    topic, adapters = "scene adapters", ADAPTERS
    try:
        adapters = tuple(all_adapters().values())
    except SplatproofError as error:
        yield Finding(topic=topic, name=GROUP, status="fault", found="not usable", fix=str(error))
    for adapter in adapters:
        yield Finding(topic=topic, name=adapter.name, status="ok", found=adapter.looks_for)


def _scenes() -> Iterator[Finding]:
    from splatproof.datasets.catalogue.registry import data_roots, list_scenes, locate

    for root in data_roots():
        there = root.is_dir()
        yield Finding(
            topic="data roots",
            name=str(root),
            status="ok" if there else "absent",
            found=str(root.resolve()) if there else "no such folder",
            fix="" if there else "set SPLATPROOF_DATA to the folders that hold your data",
        )
    for entry in list_scenes():
        path = locate(entry)
        if path is not None or entry.kind != "public":
            found = str(path or ("is made when first used" if entry.kind == "made" else "not here"))
            absent = path is None and entry.kind != "made"
            yield Finding(
                topic="scenes",
                name=entry.name,
                status="absent" if absent else "ok",
                found=found,
                fix=f"`bench scenes show {entry.name}` says how to get it" if absent else "",
            )


def _folders(out: Path) -> Iterator[Finding]:
    from splatproof.datasets.cache_folder import cache_folder

    yield _writable("cache", cache_folder(), "set SPLATPROOF_CACHE to a folder that can be written")
    yield _writable("runs", out, "use --out with a folder that can be written")
    yield _store(out)


def _writable(name: str, folder: Path, fix: str) -> Finding:
    """Whether a folder, or the nearest one above that exists, can be written and has room."""
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free / 2**30
    good = there.is_dir() and os.access(there, os.W_OK)
    found = f"{folder.absolute()}, {free:.0f} GB free" if good else f"{there}: cannot be written"
    if good and free < LEAST_FREE_GB:
        good, fix = False, f"make room: less than {LEAST_FREE_GB:.0f} GB are free"
    status = "ok" if good else "fault"
    return Finding(topic="folders", name=name, status=status, found=found, fix="" if good else fix)


def _store(out: Path) -> Finding:
    """Whether the tracking store answers; a file that is not there yet is made by the first run."""
    from splatproof.reports.mlflow_client import default_uri, open_client, shown_uri, sqlite_file

    try:
        uri = default_uri(out)
        file = sqlite_file(uri)
        if file is None or file.exists():
            open_client(uri)
    except SplatproofError as error:
        # Runs go on without it and keep their records on disk, so this is no fault.
        return Finding(
            topic="folders", name="tracking store", status="absent", found=str(error),
            fix="results stay on disk; `bench report` logs them later",
        )  # fmt: skip
    return Finding(topic="folders", name="tracking store", status="ok", found=shown_uri(uri))
