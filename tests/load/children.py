"""Large works, each in a process of its own whose memory is then its own: python -m load.children NAME FOLDER.

Prints one JSON object: the peak memory in MiB, and what else the work tells.
"""

import contextlib
import io
import json
import shutil
import sys
import time
from pathlib import Path

import torch

from helpers.city_scene import small_scene
from helpers.tiny_scene import random_gaussians
from splatproof.base.memory import MEBIBYTE, peak_memory_mb
from splatproof.cli import main
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.city.block_model import BlockModel
from splatproof.methods.city.merge import write_merged
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.storage.packed.rows import FolderRows
from splatproof.methods.storage.packed.writer import write_packed
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.types.protocol import Protocol


def views(folder: Path, steps: int) -> dict[str, object]:
    """Open a scene and train on it.

    Args:
        folder: The scene.
        steps: Of training.
    """
    begun = time.process_time()
    scene = open_scene(folder, Protocol(name="large", source="test"))
    opened = time.process_time() - begun
    model = fit(scene.for_training(), Settings(iterations=steps), Run(backend="cpu", threads=1))
    width = scene.views[0].camera.width
    return {
        "views": len(scene.views),
        "opened_s": opened,
        "primitives": len(model.model),
        "width": width,
    }


def merge(folder: Path, block: int, blocks: int) -> dict[str, object]:
    """Write one block, merge it so many times, and pack what comes out.

    Args:
        folder: An empty folder.
        block: Gaussians of a block.
        blocks: How many.
    """
    save_model(ExplicitModel(model=random_gaussians(block, degree=3)), folder / "block", Origin())
    # where a block lies is not looked at
    parts = [BlockModel(region=None, model=folder / "block")] * blocks  # pyrefly: ignore[bad-argument-type]
    kept = [torch.ones(block, dtype=torch.bool)] * blocks
    zero = torch.zeros(3, dtype=torch.float64)
    (folder / "merged").mkdir()
    write_merged(folder / "merged", parts, kept, origin=Origin(), shift=zero)
    report = write_packed(folder / "model.spgs", FolderRows(folder / "merged"), threads=1)
    return {"primitives": report.primitives, "bytes": report.bytes}


def soak(folder: Path, seconds: float) -> dict[str, object]:
    """Train, save, load and draw again and again, and note the resident memory after each.

    Args:
        folder: An empty folder.
        seconds: For so long.
    """
    scene, method = small_scene(60), get_method("3dgs")
    settings = method.settings(iterations=60, sh_degree=1)
    run = Run(backend="cpu", threads=1, folder=folder / "run", checkpoint_seconds=0.0)
    times, held = [], []
    begun = time.monotonic()
    while not times or times[-1] < seconds:
        save_model(method.fit(scene, settings, run), folder / "model", Origin())
        load_reconstruction(folder / "model").render(scene.views[0])
        shutil.rmtree(folder / "run")
        times.append(time.monotonic() - begun)
        held.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / MEBIBYTE)
    return {"seconds": times, "held_mb": held}


def report(folder: Path) -> dict[str, object]:
    """Print the leaderboard of a store and write its page, as the command does.

    Args:
        folder: Folder of the runs.
    """
    begun = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = main(["report", "--out", str(folder), "--json"])
    page = (folder / "report.html").stat().st_size
    seconds = time.process_time() - begun
    lines = len(printed.getvalue().splitlines())
    return {"code": code, "results": lines, "page_mb": page / MEBIBYTE, "seconds": seconds}


WORKS = {"report": report, "views": views, "merge": merge, "soak": soak}


if __name__ == "__main__":
    name, folder, *numbers = sys.argv[1:]
    told = WORKS[name](Path(folder), *map(json.loads, numbers))
    print(json.dumps({"peak_mb": peak_memory_mb()} | told))
