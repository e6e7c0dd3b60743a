"""`bench gallery`: draw one picture a component, from the code itself."""

import os
from pathlib import Path
from typing import Annotated

import tyro

from splatproof.cli import output


def gallery(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    *,
    scene: str = "courtyard",
    page: Path | None = None,
) -> int:
    """Draw a picture of every component, made by the component itself.

    With --json each picture is a line: picture (its path).

    Args:
        out: Folder for the pictures.
        scene: Name of a registered scene, or a scene folder, to draw them on; some pictures need one
            with true depth.
        page: Also write the Markdown page of all components to this file.
    """
    from splatproof.base.files import write_text
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.metrics.protocol_files import load_protocol
    from splatproof.suites.gallery import pictures

    opened = open_scene(scene, load_protocol("quick"))
    for path in pictures.draw(opened, out, lambda name: output.log(f"drawn: {name}")):
        output.emit({"picture": str(path)}, str(path))
    if page is not None:
        write_text(page, pictures.page(os.path.relpath(out, page.parent)))
    return 0
