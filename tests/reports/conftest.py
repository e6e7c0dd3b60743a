"""One small suite in a store, shared by the tests of the page and of the command."""

import shutil
from pathlib import Path

import pytest

from helpers import case_folders
from helpers.empty_store import lay_empty_store
from splatproof.reports.store import StoredResult, read_results, sync


@pytest.fixture(scope="session")
def migrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty store whose tables exist."""
    return lay_empty_store(tmp_path_factory.mktemp("empty"))


@pytest.fixture(scope="session")
def suite_folder(migrated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Case folders of two scenes, three methods and three seeds, in a store beside them."""
    out = tmp_path_factory.mktemp("suite")
    shutil.copy(migrated, out / "mlflow.db")
    assert sync(list(case_folders.suite(out)), f"sqlite:///{out}/mlflow.db") == []
    return out


@pytest.fixture(scope="session")
def stored(suite_folder: Path) -> list[StoredResult]:
    """What the store of `suite_folder` gives back."""
    return read_results(f"sqlite:///{suite_folder}/mlflow.db")
