"""`bench ingest PHOTOS OUT`: a scene folder from photos, by structure from motion."""

import os
import shlex
from pathlib import Path
from typing import Annotated

import tyro

from splatproof.cli import output


def ingest(
    photos: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="PHOTOS")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    *,
    max_image_size: int = 1600,
    threads: int | None = None,
    seed: int = 0,
) -> int:
    """Turn a folder of photos into a scene: OUT/photos, OUT/sparse/0 and OUT/scene.toml.

    GPS in the photos' EXIF is used to choose which photos are matched and to bring the scene
    to metres with z up. The same command continues a run that was interrupted. With --json the scene
    is a line: scene (its folder), registered, left_out, units, facts.

    Args:
        photos: Folder of JPEG, PNG or TIFF photos that overlap by 60 to 80 %.
        out: Scene folder to make; must not exist yet.
        max_image_size: Longest side, in pixels, at which features are looked for; larger photos are
            scaled down for that.
        threads: Number of CPU threads. None: one for each core. The result does not depend on it.
        seed: Number that every random draw depends on; equal seeds give equal scenes.
    """
    from splatproof.datasets.ingesting.ingest import ingest_photos

    with output.progress() as bar:
        tasks = {}

        def report(step: str, done: int, total: int) -> None:
            if step not in tasks:
                tasks[step] = bar.add_task(step, total=total, values="")
                if bar.disable:  # no terminal: one line a step
                    output.log(f"{step} ({total})")
            bar.update(tasks[step], completed=done, total=total)

        made = ingest_photos(
            photos,
            out,
            max_image_size=max_image_size,
            threads=threads or os.cpu_count() or 1,
            seed=seed,
            report=report,
            say=output.log,
        )
    scene = made.scene
    lines = [f"{made.folder}: {scene.facts['registered']} photos registered, units: {scene.units}"]
    lines += [f"GPS: {scene.facts['gps']}"]
    lines += [f"left out: {name}: {reason}" for name, reason in sorted(scene.left_out.items())]
    record = {
        "scene": str(made.folder),
        "registered": made.registered,
        "left_out": scene.left_out,
        "units": scene.units,
        "facts": scene.facts,
    }
    output.emit(record, "\n".join(lines))
    output.log(f"next: bench fit auto {shlex.quote(str(made.folder))} --out MODEL --seconds 60")
    return 0
