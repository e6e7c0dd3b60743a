"""The stage that a user names: models, and the scene that they show."""

from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.contracts.reconstruction import Origin
from splatproof.methods.loading import load_origin, load_reconstruction
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene
from splatproof.viewing.stage import Shown, Stage

Rules = Callable[[Path, Origin, str | None], Protocol]
Named = Callable[[Path, Origin, str | None], str]


def open_stage(
    models: Sequence[tuple[Path, Path]],
    *,
    scene: str | None,
    protocol: str | None,
    backend: str,
    scene_of: Named,
    protocol_of: Rules,
    say: Callable[[str], None],
) -> Stage:
    """Load models and open the scene of the first.

    Args:
        models: The path that the user named, and where the model lies, for each.
        scene: Scene that the user named; None: the first model's own, or none where it has none.
        protocol: Protocol by which photos are read; None: the first model's own, else `default`.
        backend: Name of the rasterizer.
        scene_of: Finds a model's scene, see `cli.models`.
        protocol_of: Finds its protocol.
        say: Told in one line what is missing.
    Raises: DataError, UsageError or MissingError for what cannot be opened.
    """
    origins = [load_origin(path) for _, path in models]
    shown = tuple(
        Shown(name=name, model=load_reconstruction(path, backend=backend))
        for name, (_, path) in zip(_names([given for given, _ in models]), models, strict=True)
    )
    opened: Scene | None = None
    background = torch.zeros(3)
    given, origin = models[0][0], origins[0]
    if scene is not None or origin.scene:
        known = protocol is not None or bool(origin.protocol)
        rules = protocol_of(given, origin, protocol if known else "default")
        opened = open_scene(scene_of(given, origin, scene), rules)
        background = torch.tensor(rules.background)
    else:
        say(
            f"{given}: does not say which scene it shows; photos, unseen places and errors need "
            "--scene"
        )
    return Stage(shown, opened, background)


def _names(paths: Sequence[Path]) -> list[str]:
    """The shortest ends of paths that tell them apart."""
    parts = [path.resolve().parts for path in paths]
    for length in range(1, max(map(len, parts)) + 1):
        names = ["/".join(one[-length:]) for one in parts]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]
