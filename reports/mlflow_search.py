"""Our experiments and runs in an MLflow store, page by page."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from splatproof.reports.mlflow_client import store_errors

if TYPE_CHECKING:
    from mlflow.entities import Experiment, Run
    from mlflow.tracking import MlflowClient

EXPERIMENTS = "splatproof/"
"""Start of the name of every experiment of ours; the suite's name follows."""
STATE, RECORD, ORIGIN, CASE, EXECUTION = (
    f"splatproof.{name}" for name in ("state", "record_sha256", "origin", "case", "execution")
)
"""Tags. Of a case's run: logging or complete; hash of record.json; host and folder it came from;
`case_key`. Of the run that those of a suite's execution lie under: state "suite", and which it is."""


def search_runs(
    client: "MlflowClient", filter_string: str, experiments: Sequence[str] | None = None
) -> list["Run"]:
    """All our runs that match.

    Args:
        client: Client of the store.
        filter_string: Condition in MLflow's words.
        experiments: Identities of the experiments that are searched; None: all of ours.
    """
    if experiments is None:
        ours = f"name LIKE '{EXPERIMENTS}%'"
        found = _pages(client.search_experiments, filter_string=ours)
        experiments = [one.experiment_id for one in found]
    if not experiments:
        return []
    return _pages(client.search_runs, experiment_ids=experiments, filter_string=filter_string)


def experiment_of(client: "MlflowClient", suite: str, location: str | None) -> "Experiment":
    """The experiment of a suite, made where it does not exist.

    Args:
        client: Client of the store.
        suite: Name of the suite.
        location: Where files of a new experiment go; None: the server decides.
    """
    name = EXPERIMENTS + suite
    found = client.get_experiment_by_name(name)
    if found is not None:
        return found
    try:
        return client.get_experiment(client.create_experiment(name, location))
    except store_errors():
        made = client.get_experiment_by_name(name)  # by another process, between the two calls
        if made is None:
            raise
        return made


def _pages(search: Callable[..., Any], **query: object) -> list[Any]:
    items, token = [], None
    while True:
        page = search(**query, page_token=token)
        items += page
        token = page.token
        if not token:
            return items
