"""The store of `helpers.dashboard_store`, and the dashboard's files over it."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers import dashboard_store
from helpers.dashboard_server import serving
from helpers.generated_store import write_store
from splatproof.reports.dashboard.cache import Cache
from splatproof.reports.dashboard.site import Site


@pytest.fixture(scope="session")
def store_uri(migrated: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("dashboard_store")
    shutil.copy(migrated, out / "mlflow.db")
    return write_store(out, dashboard_store.cases(), dashboard_store.write)


@pytest.fixture(scope="session")
def site(store_uri: str) -> Site:
    return Site(store_uri, Cache(None), ())


@pytest.fixture(scope="session")
def port(site: Site) -> Iterator[int]:
    with serving(site) as number:
        yield number
