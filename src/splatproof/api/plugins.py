"""Plug-in files: what a user adds without packaging it."""

from pathlib import Path

from splatproof.base.errors import UsageError
from splatproof.base.plugin_files import forget_plugin_file, load_plugin_file
from splatproof.base.plugins import offered
from splatproof.datasets.catalogue.opening import Adapter, all_adapters
from splatproof.methods.contracts.method import Method
from splatproof.methods.registry import methods
from splatproof.metrics.registry import Metric, all_metrics


def use_plugin(path: str | Path) -> tuple[str, ...]:
    """Add the methods, metrics and adapters of a Python file, here and in workers.

    Everything at the file's top level that is a `Method`, a `Metric` or an `Adapter` is known by its
    name from then on, as if an installed package offered it; `bench COMMAND --plugin FILE.py` is
    this. The file is code and is run. A file that has not changed is not run twice. Records of
    cases that use it hold its name and hash.

    Args:
        path: The file; its name without ".py" is letters, digits and "_".
    Returns: Names of what it adds: methods, then metrics, then adapters.
    Raises: UsageError, naming the file and where possible the line, if it cannot be read or run,
        offers nothing, or offers a name that is taken.
    Source: ours.
    """
    file = load_plugin_file(path)
    added = [*offered(file, Method), *offered(file, Metric), *offered(file, Adapter)]
    try:
        if not added:
            raise UsageError(
                f"plugin {path}: has no Method, Metric or Adapter at its top level; give one a name "
                "there"
            )
        methods()
        all_metrics()
        all_adapters()
    except UsageError:
        forget_plugin_file(file)
        raise
    return tuple(added)
