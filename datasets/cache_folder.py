"""Where made and downloaded things are kept."""

import os
from pathlib import Path

ELSEWHERE = "set SPLATPROOF_CACHE to a folder that can be written"
"""What to do where the cache cannot be written."""


def cache_folder() -> Path:
    """SPLATPROOF_CACHE, else splatproof below XDG_CACHE_HOME, else ~/.cache/splatproof."""
    named = os.environ.get("SPLATPROOF_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    # the XDG specification: a relative path is to be ignored
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "splatproof"
