"""Where a result was made: versions, commit, machine, threads, SIMD level."""

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("splatbench", "torch", "numpy", "pycolmap", "opencv-contrib-python-headless")
"""Those whose version can change a number."""


def environment(backend: str) -> dict[str, str]:
    """Everything about this process that a result should say.

    Args:
        backend: Name of the rasterizer in use.
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


def package_version(name: str) -> str:
    """Version of an installed package, "" when it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def git_commit() -> str:
    """Commit of the checkout that this code runs from, with -dirty if files differ; "" elsewhere."""
    folder = Path(__file__).resolve().parent
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        done = subprocess.run(
            [*command, "--exclude=*"], capture_output=True, text=True, timeout=20, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return ""
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
        from splatbench import _ext
    except ImportError:
        return ""
    return _ext.simd_level()
