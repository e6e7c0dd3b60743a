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
    """Memory that new work may take without swapping, in 2^20 bytes.

    Linux tells (MemAvailable); elsewhere all of the machine's memory is what is known.
    """
    information = Path("/proc/meminfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) / 1024
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / MEBIBYTE


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
