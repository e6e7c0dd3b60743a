"""`bench render MODEL CAMERAS OUT`: a trained model's views as images."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from splatproof.cli import output
from splatproof.cli.models import model_path

if TYPE_CHECKING:
    from splatproof.reference.types.camera import Camera


def render(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    cameras: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CAMERAS")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    *,
    protocol: str = "default",
    views: Literal["test", "train", "all"] = "test",
    backend: str = "cpu",
) -> int:
    """Render a model's views to OUT as 8-bit PNGs (clamped, rounded half up) named after the views.

    Args:
        model: What `bench fit` calls OUT, a model folder in it, or a packed file.
        cameras: Name of a registered scene, a scene folder, or a .json file: a list of objects
            with name, width, height, K (3 x 3, pixels) and world_to_camera (4 x 4, OpenCV axes).
        out: Folder for the images.
        protocol: Size, split and background: name of a protocol or path of a .toml file.
        views: Which views of a scene.
        backend: Rasterizer: cpu, reference or cuda.
    """
    import torch

    from splatproof.base.errors import DataError
    from splatproof.methods.loading import load_reconstruction
    from splatproof.methods.storage.camera_files import read_cameras
    from splatproof.metrics.protocol_files import load_protocol
    from splatproof.reference.types.result import picture_name
    from splatproof.reference.types.scene import camera_view
    from splatproof.suites.held_out import to_8_bit, write_png

    rules = load_protocol(protocol)
    loaded = load_reconstruction(model_path(model), backend=backend)
    found = (
        read_cameras(Path(cameras))
        if cameras.endswith(".json")
        else _scene_cameras(cameras, protocol, views)
    )
    if not found:
        raise DataError(f"{cameras}: no {views} view under protocol {rules.name}")
    names = [picture_name(name) for name in found]
    if len(set(names)) < len(names):
        raise DataError(f"{cameras}: two views have the same name but for the suffix")
    out.mkdir(parents=True, exist_ok=True)
    background = torch.tensor(rules.background)
    with output.progress() as bar:
        task = bar.add_task("render", total=len(found), values="")
        for name, camera in zip(names, found.values(), strict=True):
            write_png(
                out / name, to_8_bit(loaded.render(camera_view(camera, name), background).colour)
            )
            bar.advance(task)
    output.emit({"out": str(out), "images": len(found)}, f"{out}: {len(found)} images")
    return 0


def _scene_cameras(scene: str, protocol: str, views: str) -> "dict[str, Camera]":
    """Cameras of a scene's views by name."""
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.metrics.protocol_files import load_protocol

    opened = open_scene(scene, load_protocol(protocol))
    chosen = {"test": opened.test_views, "train": opened.train_views, "all": opened.views}[views]
    return {view.name: view.camera for view in chosen}
