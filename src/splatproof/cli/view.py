"""`bench view MODEL...`: trained models in the browser, from anywhere."""

import webbrowser
from pathlib import Path
from typing import Annotated

import tyro

from splatproof.api.paths import model_path
from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.models import protocol_of, scene_of


def view(
    models: Annotated[list[Path], tyro.conf.Positional, tyro.conf.arg(metavar="MODEL")],
    *,
    scene: str | None = None,
    protocol: str | None = None,
    port: int = 8766,
    open: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    backend: str = "cpu",
    measure: int | None = None,
) -> None:
    """Look at trained models from anywhere, drawn by this project's own rasterizer.

    Serves one page at http://127.0.0.1:PORT/, for this machine alone, until ctrl-C: orbit and fly,
    depth, blocks, seams, what no training photo shows, the error against the nearest photo, the
    scene's cameras (click one: its photo beside the render), time and light where the model knows
    them, and two models with a split between them. With --json the address is one JSON object.

    Args:
        models: Folders that `bench fit` calls OUT, model folders, or packed files. The page shows
            one, or two with a split.
        scene: Name of a registered scene, or a scene folder, whose photos are shown. None: the scene
            that the first model was trained on; without any, there are no photos.
        protocol: Name of a protocol, or the path of a .toml file: size and split of the photos. None:
            the one that the first model was trained under.
        port: Port that is served; 0: any that is free.
        open: Also open the page in the browser.
        backend: Name of the rasterizer: cpu, reference or cuda.
        measure: Instead of serving: ask for this many frames of 640 x 360 on a walk round the scene,
            as the page would, and print how long they took, as text or one JSON object. Without a
            MODEL that is of 100,000 random Gaussians, all of them in the image.
    """
    from splatproof.base.local_server import HOST, listening, server_of
    from splatproof.viewing.measuring import measured, random_stage, sway, walk
    from splatproof.viewing.opening import open_stage
    from splatproof.viewing.server import application

    if measure is not None and measure < 1:
        raise UsageError(f"--measure {measure}: expected 1 or more frames")
    if not models:
        if measure is None:
            raise UsageError("name at least one model: what `bench fit` calls OUT")
        stage, camera = random_stage(backend)
        found = measured(stage, sway(camera, measure))
        output.emit(found.record(), found.text())
        return
    stage = open_stage(
        [(given, model_path(given)) for given in models], scene=scene, protocol=protocol,
        backend=backend, scene_of=scene_of, protocol_of=protocol_of, say=output.log,
    )  # fmt: skip
    if measure is not None:
        found = measured(stage, walk(stage, measure))
        output.emit(found.record(), found.text())
        return
    at = listening(port)
    number = at.getsockname()[1]
    address = f"http://{HOST}:{number}/"
    output.emit({"address": address}, f"{address}  (ctrl-C ends it)")
    if open:
        webbrowser.open(address)
    try:
        server_of(application(stage, number)).run(sockets=[at])
    except KeyboardInterrupt:
        output.log("ended")
