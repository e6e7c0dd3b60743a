"""What memory this process has used, how much the machine has left, and what a file may take of it."""

import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatproof.base.errors import DataError, MissingError

MEBIBYTE = 2**20
SHARE = 0.9
"""What one file may take when it is read, of the memory that is free."""
GROWTH = 1400
"""Times its own size that a file unpacks to at most. Deflate reaches 1032 (zlib's documentation); LZW
as in TIFF 7.36 MB out of the 5.6 kB that fill its table once, 1323."""
SMALL = 64 * MEBIBYTE
"""Bytes up to which nobody asks how a file grew: what repeats itself for ever packs better yet."""

GROUPS, OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
"""Where Linux shows control groups, and says which this process is in."""
V2 = ("memory.max", "memory.current", "inactive_file", "")
V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file", "memory")
"""Files of a group's bound and use, its row of unused pages in memory.stat, and the folder of groups, by version."""

_forgotten = [0.0]
"""Largest peak of this process that `peak_within` made the system forget, in 2^20 bytes."""


def peak_memory_mb() -> float:
    """Peak resident memory of this process in 2^20 bytes.

    Linux hands the parent's peak down to a new process in ru_maxrss, so VmHWM is read there.
    """
    return max(_forgotten[0], _remembered())


@contextmanager
def peak_within(peaks: dict[str, float], name: str) -> Iterator[None]:
    """Keep the peak resident memory of this process during the `with` block, in 2^20 bytes, as peaks[name].

    Linux is asked to begin its peak anew (proc_pid_clear_refs(5)). Where that cannot be, a peak below that of the
    process's life before is not known, and nothing is kept. Nested, the inner one alone is right.

    Args:
        peaks: Peaks by name, changed in place.
        name: What the memory was taken for.
    """
    before = _remembered()
    try:
        Path("/proc/self/clear_refs").write_text("5")
        _forgotten[0], before = max(_forgotten[0], before), 0.0
    except OSError:
        pass  # no Linux, or one that does not let it
    yield
    if (peak := _remembered()) > before:
        peaks[name] = peak


def _remembered() -> float:
    """The peak as the system has it, in 2^20 bytes."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (MEBIBYTE if sys.platform == "darwin" else 1024)


def available_mb() -> float:
    """Memory that new work may take without swapping, in 2^20 bytes, at least 0.

    Linux tells (MemAvailable), and what the control groups of this process allow, as a container has them; elsewhere
    all of the machine's memory is what is known.
    """
    return max(0.0, min([_machine_mb(), *_allowed_mb()]))


def _machine_mb() -> float:
    """What is free of the machine's memory, in 2^20 bytes."""
    information = Path("/proc/meminfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) / 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / MEBIBYTE


def _allowed_mb() -> Iterator[float]:
    """What each of this process's control groups still allows, in 2^20 bytes; nothing where there are none.

    Pages of files that are not in use count as free, as in MemAvailable: a container that has read many photos holds
    them until somebody needs the memory. Source: Linux, Documentation/admin-guide/cgroup-v2.rst and cgroup-v1/memory.rst.
    """
    for line in _text(OWN_GROUPS).splitlines():
        _, kinds, own = line.split(":", 2)
        if kinds and "memory" not in kinds.split(","):
            continue
        most, used, unused, root = V1 if kinds else V2
        place = GROUPS / root / own.strip("/")
        # a container may be told a path of the machine's, and see its own group at the top
        while place.is_relative_to(GROUPS / root):
            bound, now = _text(place / most).strip(), _text(place / used).strip()
            if bound.isdigit() and now.isdigit():
                told = dict(row.split() for row in _text(place / "memory.stat").splitlines())
                yield (int(bound) - int(now) + int(told.get(unused, 0))) / MEBIBYTE
            place = place.parent


def _text(path: Path) -> str:
    """Text of a file of the system; empty where there is none, or it may not be read."""
    try:
        return path.read_text()
    except OSError:
        return ""


def check_room(what: object, needed: int) -> None:
    """Refuse what would push this machine into swapping, before it is allocated.

    Args:
        what: File that is read, for the error.
        needed: Bytes that it takes at its peak.
    Raises: MissingError where that is more than SHARE of the memory that is free.
    """
    free = available_mb()
    if needed > SHARE * free * MEBIBYTE:
        raise MissingError(
            f"{what}: takes {needed / MEBIBYTE:.0f} MB to read, more than {SHARE:.0%} of the memory "
            f"that is free ({free:.0f} MB); take a smaller file or a machine with more memory"
        )


def check_growth(what: object, unpacked: int, stored: int, *, small: int = SMALL) -> None:
    """Refuse a file that says it holds more than a file of its size can.

    Args:
        what: File that is read, for the error.
        unpacked: Bytes that it says it holds.
        stored: Bytes that it has.
        small: Bytes up to which it is not refused, where they pack no better than GROWTH says.
    Raises: DataError where it would grow more than GROWTH times and to more than `small`.
    """
    if unpacked > max(small, GROWTH * stored):
        raise DataError(
            f"{what}: says that its {stored} bytes hold {max(round(unpacked / MEBIBYTE), 1)} MB, more than "
            f"{GROWTH} times as much; it is damaged or made to fill the memory, get it again"
        )
