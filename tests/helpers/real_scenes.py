"""Real scenes for tests: found as `bench` finds them, or the test is skipped with the reason."""

from pathlib import Path

from splatproof.datasets.catalogue.registry import find_scene
from splatproof.testing.runs import skip_without


def real_scene(name: str) -> Path:
    """Folder of a real scene such as "brighton_beach"; skips the calling test where it is absent."""
    skip_without(name)
    return find_scene(name)
