"""An experiment's description and views, so that MLflow's pages open on scores and what differs."""

import json
from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Any

from splatproof.metrics.registry import all_metrics
from splatproof.reference.types.result import Result
from splatproof.reports import run_data
from splatproof.reports.mlflow_client import write_tag
from splatproof.reports.mlflow_search import STATE
from splatproof.reports.shown_run import NOTE

if TYPE_CHECKING:
    from mlflow.entities import Experiment
    from mlflow.tracking import MlflowClient

VIEW = "mlflow.sharedViewState."
"""Start of the tags of an experiment that hold its saved views, as MLflow 3's pages write them."""
SCORES, MEANS = "scores", "means"
"""Our views: every case with its scores; means over seeds of each scene and row."""
TABLE = ("scene", "row", "seed", "protocol")
"""Params that name a case; those after the scene that never differ are left out."""
MOST_SETTINGS = 8
"""Settings that differ shown as columns; MLflow's column menu and compare page have all."""
COSTS = ("cost/train_seconds", "cost/primitives", "cost/bytes_on_disk", "cost/render_ms")
RUN_NAME = "attributes.`Run Name`"
ONLY_CASES = f"tags.`{STATE}` = 'complete'"


class Shown:
    """What the columns of a suite's views are, gathered from its cases one by one."""

    def __init__(self) -> None:
        """Nothing is known yet."""
        self._values: dict[str, str] = {}
        self._differing: dict[str, None] = {}
        self._metrics: dict[str, None] = {}

    def add(self, result: Result) -> None:
        """Take a case into account.

        Args:
            result: Any case of the suite.
        """
        named: Any = result.protocol_rules.get("metrics")
        self._metrics |= dict.fromkeys(map(str, named or ()))
        for name, value in run_data.params(result).items():
            if self._values.setdefault(name, value) != value:
                self._differing[name] = None

    @property
    def metrics(self) -> list[str]:
        """The protocols' metrics, first the one that ranks."""
        return list(self._metrics)

    @property
    def columns(self) -> list[str]:
        """MLflow's names of the columns: scores, the case, settings that differ, costs."""
        named = [name for name in TABLE if name in self._differing or name in ("scene", "row")]
        settings = [name for name in self._differing if name.startswith("settings.")]
        scores, costs = ([f"metrics.`{name}`" for name in own] for own in (self._metrics, COSTS))
        params = [f"params.`{name}`" for name in (*named, *settings[:MOST_SETTINGS])]
        return [*scores, *params, *costs]


def write_views(client: "MlflowClient", experiment: "Experiment", suite: str, shown: Shown) -> None:
    """Write the tags of an experiment that are not so yet; a description is never replaced.

    Args:
        client: Client of the store.
        experiment: The suite's experiment.
        suite: Name of the suite.
        shown: All its cases that are known.
    """
    wanted = {
        "mlflow.experimentKind": "custom_model_development",
        VIEW + SCORES: _view("Scores", _scores(shown)),
        VIEW + MEANS: _view("Means over seeds", _means(shown)),
    }
    if shown.metrics:
        first = all_metrics().get(shown.metrics[0])
        wanted["mlflow.experiment.primaryMetric.name"] = shown.metrics[0]
        better = str(first is None or first.higher_is_better)
        wanted["mlflow.experiment.primaryMetric.greaterIsBetter"] = better
    if NOTE not in experiment.tags:
        wanted[NOTE] = description(experiment.experiment_id, suite)
    for name, value in wanted.items():
        if experiment.tags.get(name) != value:
            write_tag(partial(client.set_experiment_tag, experiment.experiment_id), name, value)


def description(experiment: str, suite: str) -> str:
    """Markdown of an experiment: what its runs are, and links to its views.

    Args:
        experiment: MLflow's identity of it.
        suite: Name of the suite.
    """
    runs = f"#/experiments/{experiment}/runs?viewStateShareKey="
    return (
        f"[**Scores**]({runs}{SCORES}) · [**Means over seeds**]({runs}{MEANS}) of suite {suite}: "
        "each run is a case, below the run of its execution."
    )


def _scores(shown: Shown) -> dict[str, Any]:
    return _in_order(shown.columns) | _sorted_by(shown.metrics)


def _means(shown: Shown) -> dict[str, Any]:
    keys = [{"mode": "param", "groupByData": name} for name in ("scene", "row")]
    columns = [name for name in shown.columns if name.startswith("metrics.")]
    return {
        **_in_order(columns),
        "groupBy": {"aggregateFunction": "average", "groupByKeys": keys},
        **_sorted_by(shown.metrics),
    }


def _in_order(columns: list[str]) -> dict[str, Any]:
    """Columns as given, where MLflow would sort them by name; a run's whole name is seen."""
    return {
        "selectedColumns": columns,
        "columnOrder": [RUN_NAME, *columns],
        "columnWidths": {RUN_NAME: 260},
    }


def _sorted_by(metrics: Iterable[str]) -> dict[str, Any]:
    """Best first by the metric that ranks."""
    first = next(iter(metrics), None)
    if first is None:
        return {"searchFilter": ONLY_CASES}
    metric = all_metrics().get(first)
    lower = metric is not None and not metric.higher_is_better
    return {
        "searchFilter": ONLY_CASES,
        "orderByKey": f"metrics.`{first}`",
        "orderByAsc": lower,
    }


def _view(name: str, state: dict[str, Any]) -> str:
    """The envelope that MLflow's pages read; the same state always gives the same text."""
    return json.dumps({"name": name, "createdAt": 0, "updatedAt": 0, "state": json.dumps(state)})
