"""Where made and downloaded things are kept."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """SPLATPROOF_CACHE, else splatproof below XDG_CACHE_HOME, else ~/.cache/splatproof."""
    named = os.environ.get("SPLATPROOF_CACHE")
    if named:
        return Path(named)
    base = os.environ.get("XDG_CACHE_HOME")
    # the XDG specification: a relative path is to be ignored
    root = Path(base) if base and Path(base).is_absolute() else Path.home() / ".cache"
    return root / "splatproof"
