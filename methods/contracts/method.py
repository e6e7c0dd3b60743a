"""What a method is: a name, settings, a fit, what it costs, and the models that it leaves."""

import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.reconstruction import Reconstruction, Stored
from splatproof.methods.contracts.run import Run
from splatproof.reference.types.scene import Scene

NAMES = re.compile(r"[a-zA-Z0-9][a-zA-Z0-9+._-]*")
"""What a method may be called: a folder's name, without "@", which begins a variant's."""
Loader = Callable[[Path, Stored, str], Reconstruction]
"""load(folder, stored, backend): the model of a folder whose model.json and arrays were read."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What a fit will probably take, right within a factor of two."""

    cpu_seconds: float
    """CPU seconds of training on backend cpu, all processes together."""
    memory_mb: float
    """Peak memory of its fullest process in 2^20 bytes."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """A way to reconstruct a scene."""

    name: str
    """What suites and the command line call it."""
    settings: type
    """Frozen dataclass with a default for every field; an ablation is a setting, never a fork."""
    fit: Callable[[Scene, Any, Run], Reconstruction]
    """fit(scene, settings, run): train on scene.train_views only."""
    cost: Callable[[Any, Scene], Cost]
    """cost(settings, scene): before anything is trained; no image is read."""
    description: str
    """What the method does, in one line."""
    loaders: Mapping[str, Loader] = field(default_factory=dict)
    """How to load the kinds of models that only this method leaves, by kind."""
    blocks: bool = False
    """Whether it trains a scene in blocks, so that Run.engine and Run.workers apply."""

    def __post_init__(self) -> None:
        """Refuse a name that is no folder or that rows of tables read otherwise, and settings of another kind.

        Raises: UsageError.
        """
        if not NAMES.fullmatch(self.name):
            raise UsageError(
                f"method name {self.name!r}: expected letters, digits, '+', '-', '_' and '.', a letter "
                "or digit first"
            )
        kind: Any = self.settings
        told = f"method {self.name}: its settings are {kind!r:.80}, expected a frozen dataclass"
        parameters = getattr(kind, "__dataclass_params__", None)
        if parameters is None or not parameters.frozen:
            raise UsageError(told)
        for one in fields(kind):
            if one.init and one.default is MISSING and one.default_factory is MISSING:
                raise UsageError(f"{told} with a default for every field; {one.name} has none")
