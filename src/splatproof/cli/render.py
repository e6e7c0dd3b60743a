"""`bench render MODEL OUT`: a trained model's views as images."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from splatproof.api.paths import model_path
from splatproof.cli import output
from splatproof.cli.models import placed, protocol_of, scene_of
from splatproof.cli.own_cameras import for_model

if TYPE_CHECKING:
    from torch import Tensor

    from splatproof.methods.contracts.reconstruction import Reconstruction
    from splatproof.reference.types.protocol import Protocol
    from splatproof.reference.types.scene import View

    Draw = Callable[[Reconstruction], Callable[[View], Tensor]]


def render(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    *,
    scene: str | None = None,
    protocol: str | None = None,
    views: Literal["test", "train", "all"] | None = None,
    cameras: Path | None = None,
    backend: str = "cpu",
) -> int:
    """Render a trained model's views to OUT as PNGs named after the views.

    A model that `bench fit` or `bench run` saved knows its scene and protocol: without options its
    held-out views are rendered as they were scored, at the protocol's size and over its background,
    and the images are those in the case's renders/ byte for byte. A packed file knows them too. A
    .ply, .spz, .sog or .glb needs --scene and --protocol, or --cameras. PNGs have 8 bits a channel, or 16 where the protocol scores
    renders that are not rounded. With --json one line tells out, images (how many),
    source (the scene or the file of cameras) and protocol.

    Args:
        model: The folder that `bench fit` calls OUT, the model folder in it, or a .ply, .spz, .sog, .glb or
            packed file.
        out: Folder for the images.
        scene: Name of a registered scene, or a scene folder, whose views are rendered. None: the
            scene that the model was trained on.
        protocol: Name of a protocol, or the path of a .toml file, that says size, split and
            background. None: the protocol that the model was trained under.
        views: Which views of the scene: those that are scored, those that train, or all. None: test.
        cameras: Render from the cameras in this .json file instead: a list of objects with name,
            width, height, K (3 x 3, pixels) and world_to_camera (4 x 4, OpenCV axes, in the model's frame or, where
            that is shifted, the scene's original one), and for models
            that know of them time (seconds since the scene's first view), sensor (name of a physical
            camera) and appearance (name of the training view whose light is shown).
        backend: Name of the rasterizer: cpu, reference or cuda.
    """
    from splatproof.base.errors import DataError, UsageError
    from splatproof.datasets.photos import write_png
    from splatproof.methods.loading import load_origin, load_reconstruction
    from splatproof.reference.types.result import picture_name
    from splatproof.suites.held_out import kept

    if cameras is not None and (scene is not None or views is not None):
        raise UsageError("--cameras says what is rendered; leave --scene and --views out")
    path = model_path(model)
    origin = load_origin(path)
    if cameras is None:
        source = scene_of(model, origin, scene)
        rules = protocol_of(model, origin, protocol)
        chosen, draw = _of_scene(source, rules, views or "test")
    else:
        source = str(cameras)
        known = protocol is not None or bool(origin.protocol)
        rules = protocol_of(model, origin, protocol if known else "default")
        chosen, draw = _of_file(cameras, rules)
    if not chosen:
        raise DataError(f"{source}: no {views or 'test'} view under protocol {rules.name}")
    names = [picture_name(view.name) for view in chosen]
    if len(set(names)) < len(names):
        raise DataError(f"{source}: two views have the same name but for the suffix")
    show = draw(load_reconstruction(path, backend=backend))
    out.mkdir(parents=True, exist_ok=True)
    with output.progress() as bar:
        task = bar.add_task("render", total=len(chosen), values="")
        for name, view in zip(names, chosen, strict=True):
            write_png(out / name, kept(show(view), rules.rounding)[1])
            bar.advance(task)
    record = {"out": str(out), "images": len(names), "source": source, "protocol": rules.name}
    output.emit(record, f"{out}: {len(names)} images of {source} under protocol {rules.name}")
    return 0


def _of_scene(scene: str, rules: "Protocol", views: str) -> "tuple[Sequence[View], Draw]":
    """A scene's views, and how a model shows one as it is scored."""
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.suites.held_out import drawn

    opened = open_scene(scene, rules)
    chosen = {"test": opened.test_views, "train": opened.train_views, "all": opened.views}[views]

    def draw(model: "Reconstruction") -> "Callable[[View], Tensor]":
        model = placed(model, opened)
        return lambda view: drawn(view, opened.train_views, model, rules)

    return chosen, draw


def _of_file(cameras: Path, rules: "Protocol") -> "tuple[Sequence[View], Draw]":
    """Views that nobody took, from the cameras of a file, and how a model shows one."""
    import torch

    from splatproof.methods.storage.camera_files import read_cameras

    background = torch.tensor(rules.background)
    views = read_cameras(cameras)

    def draw(model: "Reconstruction") -> "Callable[[View], Tensor]":
        fitting = for_model(views, model, cameras)
        return lambda view: model.render(fitting[view.name], background).colour

    return tuple(views.values()), draw
