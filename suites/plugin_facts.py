"""Which plug-in files a case uses, for its record."""

from pathlib import Path

from splatproof.base.plugin_files import PluginFile, plugin_files
from splatproof.base.plugins import offered
from splatproof.datasets.catalogue.opening import Adapter, adapter_of
from splatproof.datasets.catalogue.registry import find_scene
from splatproof.methods.contracts.method import Method
from splatproof.metrics.registry import Metric
from splatproof.suites.scene_data import PLUGIN
from splatproof.suites.suite_files import PATH, Case


def plugin_facts(case: Case) -> dict[str, str]:
    """The plug-in files that the case uses: its method, a metric or the adapter is from them.

    Args:
        case: What is run; its scene is on this machine.
    Returns: SHA-256 by "plugin my_method.py".
    Raises: What opening the scene raises, if a file has adapters.
    """
    return {PLUGIN + file.name: file.sha256 for file in plugin_files() if _used(file, case)}


def _used(file: PluginFile, case: Case) -> bool:
    if case.method in offered(file, Method):
        return True
    if not offered(file, Metric).keys().isdisjoint(case.protocol.metrics):
        return True
    adapters = offered(file, Adapter)
    return bool(adapters) and adapter_of(_folder(case.scene)).name in adapters


def _folder(scene: str) -> Path:
    return Path(scene) if scene.startswith(PATH) else find_scene(scene)
