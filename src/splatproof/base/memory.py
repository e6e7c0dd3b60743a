"""What memory this process has used and how much the machine has left."""

import os
import resource
import sys
from pathlib import Path

MEBIBYTE = 2**20


def peak_memory_mb() -> float:
    """Peak resident memory of this process in 2^20 bytes.

    Linux hands the parent's peak down to a new process in ru_maxrss, so VmHWM is read there.
    """
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
