"""Large works inside their bounds of memory, each in a process of its own."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from helpers import case_folders
from helpers.adapter_checks import hard_links
from helpers.colmap_scenes import Flight, reconstruction
from helpers.generated_store import write_store
from splatproof.base.memory import MEBIBYTE

pytestmark = pytest.mark.slow
CHILD = "load.children"
VIEWS, STEPS, VIEWS_MB = 5_000, 200, 2048
"""Photos of 4000 x 3000, steps of training on them as they are, and MiB that both take."""
BLOCK, BLOCKS, MERGED_MB = 1_000_000, 50, 8192
"""Gaussians of a block, blocks that are merged and packed, and MiB that both take."""
RESULTS, RESULTS_MB = 10_000, 1536
"""Results in a store, and MiB that `bench report` takes."""
SOAK = float(os.environ.get("SPLATPROOF_SOAK_SECONDS", "1200"))
"""Seconds of training, saving, loading and drawing again and again."""
GROWTH_MB = 16.0
"""MiB by which resident memory may grow in the second half of the soak: the allocator's own unrest, a
few of this process's arenas; a model of the soak that is kept each time adds up to more in a minute."""


def peak_of(name: str, *arguments: object) -> dict:
    """What a work of load.children tells."""
    done = subprocess.run(
        [sys.executable, "-m", CHILD, name, *map(str, arguments)], text=True, check=False, capture_output=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout.splitlines()[-1])
    print(name, {key: value for key, value in told.items() if not isinstance(value, list)})
    return told


def test_five_thousand_large_photos_are_opened_and_trained_on(tmp_path):
    size = (4000, 3000)
    flight = Flight(
        views=VIEWS, lap=6, size=size, model="PINHOLE", params=[2917, 2917, 2000, 1500], points=60
    )
    model = reconstruction(flight)
    for image in model.images.values():
        image.name = image.name.replace(".png", ".jpg")
    (tmp_path / "scene/sparse/0").mkdir(parents=True)
    model.write_binary(tmp_path / "scene/sparse/0")
    coarse = np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize(size).save(tmp_path / "one.jpg")
    names = [tmp_path / "scene/photos" / image.name for image in model.images.values()]
    hard_links(tmp_path / "one.jpg", names)
    told = peak_of("views", tmp_path / "scene", STEPS)
    assert told["views"] == VIEWS
    assert told["width"] == size[0]
    assert told["peak_mb"] < VIEWS_MB


def test_fifty_million_gaussians_are_merged_and_packed(tmp_path):
    each = 4 * (3 + 4 + 3 + 1 + 48)  # a block, the merged model; packed it is less
    needed = BLOCK * each * (2 + 2 * BLOCKS)
    if shutil.disk_usage(tmp_path).free < needed:
        pytest.skip(f"needs {needed / 2**30:.0f} GiB of disk")
    try:
        told = peak_of("merge", tmp_path, BLOCK, BLOCKS)
    finally:
        for path in tmp_path.iterdir():  # pytest keeps folders of runs before
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert told["primitives"] == BLOCK * BLOCKS
    assert told["peak_mb"] < MERGED_MB
    assert told["peak_mb"] < each * BLOCK * BLOCKS / MEBIBYTE  # it never holds the model


def test_ten_thousand_results_are_reported(tmp_path):
    cases = (
        case_folders.result(scene=f"town{n % 50}", method=f"m{n // 50 % 20}", seed=n // 1000)
        for n in range(RESULTS)
    )
    write_store(tmp_path, cases)
    told = peak_of("report", tmp_path)
    assert told["results"] == RESULTS
    assert told["peak_mb"] < RESULTS_MB


def test_memory_is_flat_over_a_long_run(tmp_path):
    told = peak_of("soak", tmp_path, SOAK)
    times, held = np.array(told["seconds"]), np.array(told["held_mb"])
    late = times > times[-1] / 2
    slope = np.polyfit(times[late], held[late], 1)[0]
    grown = float(slope * (times[-1] - times[late][0]))
    print(
        f"{len(times)} rounds, {held[late][0]:.0f} to {held[-1]:.0f} MiB, {grown:+.2f} MiB by slope"
    )
    assert grown < GROWTH_MB
