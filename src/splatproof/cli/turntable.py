"""`bench turntable MODEL OUT`: a film of a trained model."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from splatproof.api.paths import model_path
from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.models import protocol_of, scene_of

MOST_FRAMES = 36_000
"""Twenty minutes at 30 frames a second."""


def turntable(
    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    *,
    path: Literal["orbit", "cameras"] = "orbit",
    seconds: float = 8.0,
    fps: float = 30.0,
    width: int = 960,
    height: int | None = None,
    mode: str = "colour",
    scene: str | None = None,
    protocol: str | None = None,
    backend: str = "cpu",
) -> None:
    """Write a film of a trained model: round the scene, or along its cameras.

    OUT ends in .mp4 (H.264) or .webm (VP9); needs the package av (pip install 'splatproof[video]'). A
    model that moves runs through the scene's whole time. With --json one line tells out, frames,
    width, height, fps and path.

    Args:
        model: Folder that `bench fit` calls OUT, a model folder, or a packed file.
        out: The film; one that is there is replaced.
        path: orbit: once round the middle of the scene, at the usual height and distance of its
            training cameras; cameras: along the training cameras in the order of their names.
        seconds: Length of the film.
        fps: Frames a second.
        width: Width in pixels, even.
        height: Height in pixels, even. None: 9/16 of the width.
        mode: What is shown: colour, depth, blocks, seams, unseen or error, as in `bench view`.
        scene: Name of a registered scene, or a scene folder. None: the one that the model was
            trained on.
        protocol: Name of a protocol, or the path of a .toml file. None: the one that the model was
            trained under.
        backend: Name of the rasterizer: cpu, reference or cuda.
    """
    from splatproof.viewing.film import check_film, writing
    from splatproof.viewing.frames import bytes_of
    from splatproof.viewing.modes import check_mode
    from splatproof.viewing.opening import open_stage
    from splatproof.viewing.turntable import cameras, still

    if not (0 < fps <= 240 and 0 < seconds * fps <= MOST_FRAMES):
        raise UsageError(
            f"--seconds {seconds:g} at --fps {fps:g}: expected up to 240 frames a second and "
            f"{MOST_FRAMES} frames in all, both more than 0"
        )
    tall = 2 * round(width * 9 / 32) if height is None else height
    check_film(out, width, tall)
    stage = open_stage(
        [(model, model_path(model))], scene=scene, protocol=protocol, backend=backend,
        scene_of=scene_of, protocol_of=protocol_of, say=output.log,
    )  # fmt: skip
    check_mode(stage, mode)
    walked = cameras(stage, path, max(1, round(seconds * fps)), width=width, height=tall)
    with output.progress() as bar, writing(out, width=width, height=tall, fps=fps) as film:
        task = bar.add_task("film", total=len(walked), values="")
        for camera, time in walked:
            film.add(bytes_of(still(stage, camera, time, mode)))
            bar.advance(task)
    record = {"out": str(out), "frames": len(walked), "width": width, "height": tall, "fps": fps}
    output.emit(
        record | {"path": path}, f"{out}: {len(walked)} frames of {width} x {tall} at {fps:g}/s"
    )
