"""`bench score MODEL`: a model's renders of views that were held out, scored without a case folder."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from splatproof.api.paths import model_path
from splatproof.base.errors import UsageError
from splatproof.cli.models import placed, protocol_of, scene_of
from splatproof.cli.own_cameras import for_model

if TYPE_CHECKING:
    from splatproof.reference.types.protocol import Protocol
    from splatproof.reference.types.result import ImageScore


def is_model(given: Path) -> bool:
    """Whether a path means a trained model and not a folder of renders.

    Args:
        given: As the user named it.
    """
    from splatproof.methods.gaussian_files import is_file

    return is_file(given) or (model_path(given) / "model.json").is_file()


def score_held_out(
    given: Path, scene: str | None, protocol: str | None
) -> "tuple[str, Protocol, tuple[ImageScore, ...]]":
    """Render the held-out views of a scene from a model and score them, as a fit does.

    Nothing is kept of the pictures: `bench render` writes them.

    Args:
        given: The folder that `bench fit` calls OUT, the model folder in it, or a file of Gaussians.
        scene: Name of a registered scene, or a scene folder. None: the model's own.
        protocol: Name of a protocol, or path of a .toml file. None: the model's own.
    Returns: The scene's name, the rules and a score for each held-out view.
    Raises: UsageError if nobody says scene or protocol; DataError for a scene or a model that cannot
        be used.
    """
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.methods.loading import load_origin, load_reconstruction
    from splatproof.metrics.registry import load_weights
    from splatproof.suites.held_out import score_views

    if protocol is not None and "," in protocol:
        raise UsageError(f"--protocol {protocol}: a model is scored under one protocol at a time")
    path = model_path(given)
    origin = load_origin(path)
    source = scene_of(given, origin, scene)
    rules = protocol_of(given, origin, protocol)
    load_weights(rules.metrics)
    opened = open_scene(source, rules)
    model = placed(load_reconstruction(path), opened)
    with TemporaryDirectory() as folder:
        return opened.name, rules, score_views(opened, model, rules, Path(folder))


def render_cameras(given: Path, cameras: Path, protocol: str | None, folder: Path) -> None:
    """Render the cameras of a file from a model into PNGs named after them.

    Args:
        given: The model as the user named it.
        cameras: A .json file as `bench render` reads it.
        protocol: Names with commas between them: the first one's background and rounding are those
            of the pictures. None: the default's.
        folder: Where the pictures are written; it is there.
    Raises: DataError for a model or a file of cameras that cannot be used.
    """
    import torch

    from splatproof.datasets.photos import write_png
    from splatproof.methods.loading import load_reconstruction
    from splatproof.methods.storage.camera_files import read_cameras
    from splatproof.metrics.protocol_files import load_protocol
    from splatproof.reference.types.result import picture_name
    from splatproof.suites.held_out import kept

    rules = load_protocol((protocol or "default").split(",")[0].strip())
    views = read_cameras(cameras)
    model = load_reconstruction(model_path(given))
    views = for_model(views, model, cameras)
    for view in views.values():
        image = model.render(view, torch.tensor(rules.background)).colour
        write_png(folder / picture_name(view.name), kept(image, rules.rounding)[1])
