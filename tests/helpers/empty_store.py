"""An empty MLflow store whose tables exist: making them takes seconds, writing them nothing."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from splatproof.reports.mlflow_client import open_client


def lay_empty_store(folder: Path) -> Path:
    """Write an empty store into a folder.

    Args:
        folder: Where `bench` would make one; it is made where it is missing.
    Returns: Its file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "mlflow.db"
    file.write_bytes(_made())
    return file


@cache
def _made() -> bytes:
    """The file that is made once a process."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "mlflow.db"
        open_client(f"sqlite:///{file}")
        return file.read_bytes()
