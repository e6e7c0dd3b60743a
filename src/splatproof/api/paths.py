"""Where a trained model lies; imports nothing heavy."""

from pathlib import Path


def model_path(given: Path) -> Path:
    """The model that a path means: itself, or its model/ where it is what `bench fit` calls OUT."""
    inner = given / "model"
    return inner if (inner / "model.json").is_file() else given
