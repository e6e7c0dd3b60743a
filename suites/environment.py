"""Where a result was made: versions, commit, machine, threads, SIMD level."""

import datetime
import hashlib
import os
import platform
import subprocess
import uuid
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("splatproof", "torch", "numpy", "pycolmap", "opencv-contrib-python-headless")
"""Packages whose version can change a number."""


def environment(backend: str) -> dict[str, str]:
    """Everything about this process that a result should say.

    Args:
        backend: Name of the rasterizer in use.
    Returns: Versions, commit, machine, threads and SIMD level by name.
    """
    import torch

    return {
        "python": platform.python_version(),
        **{name: package_version(name) for name in PACKAGES},
        "commit": git_commit(),
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cores": str(usable_cores()),
        "threads": str(torch.get_num_threads()),
        "simd": simd_level(),
        "backend": backend,
    }


def boot() -> str:
    """Short hash that runs on the same machine since its last start share, and no others.

    It says nothing of the machine but that. Where the system gives no such number, it is made of the
    network address alone.
    """
    given = Path("/proc/sys/kernel/random/boot_id")
    text = given.read_text() if given.exists() else str(uuid.getnode())
    return hashlib.sha256(text.strip().encode()).hexdigest()[:12]


def now() -> str:
    """This moment in UTC as ISO 8601 writes it, to the millisecond."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")


def package_version(name: str) -> str:
    """Version of an installed package, "" when it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def git_commit() -> str:
    """Commit of the checkout that this code runs from, with -dirty if files differ; "" elsewhere.

    An installed copy may lie inside somebody's own repository, whose commit is not ours.
    """
    return commit_of(Path(__file__).resolve())


def commit_of(file: Path) -> str:
    """Commit of the checkout that keeps a file, with -dirty if any of its files differ; "" elsewhere.

    Nothing is written there: `git describe --dirty` writes the index, and a kill then leaves a lock
    that stops the user's next commit.

    Args:
        file: Any file.
    """
    try:
        _git(file.parent, "ls-files", "--error-unmatch", file.name)
        asked = ("--porcelain=v2", "--branch", "--no-ahead-behind", "--untracked-files=no")
        told = _git(file.parent, "status", *asked)
    except (OSError, subprocess.SubprocessError):
        return ""
    head, *rest = told.splitlines()
    commit = head.removeprefix("# branch.oid ")
    if commit == "(initial)":  # nothing is committed yet
        return ""
    differs = any(not line.startswith("# ") for line in rest)
    return f"{commit}-dirty" if differs else commit


def _git(folder: Path, *words: str) -> str:
    """What git prints. Raises: OSError, SubprocessError where it fails or takes long."""
    command = ["git", "-C", str(folder), "--no-optional-locks", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True)
    return done.stdout.strip()


def cpu_model() -> str:
    """Name of the processor as the system gives it."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def simd_level() -> str:
    """Instruction set that the native kernels chose on this machine; "" where they are not built."""
    try:
        from splatproof import _ext
    except ImportError:
        return ""
    return _ext.simd_level()


def machine(backend: str) -> dict[str, str]:
    """`environment`, and memory, compiler and GPU: what a time depends on. No host name."""
    import torch

    said = environment(backend)
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        gigabytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
        said["memory"] = f"{gigabytes:.0f} GiB"
    if said["simd"]:
        from splatproof import _ext

        said["compiler"] = _ext.compiler()
    if backend == "cuda" and torch.cuda.is_available():
        said["gpu"] = torch.cuda.get_device_name()
        said["gsplat"] = package_version("gsplat")
    return said
