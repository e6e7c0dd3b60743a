"""Runs of seconds whose models are hashed: run as a script it prints name and hash of those that it is given."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from helpers.baking import baked
from helpers.city_scene import small_scene
from helpers.tiny_scene import tiny_scene
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.refine import RefineSettings
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density

DENSITY = Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=10_000)
SHORT = Settings(iterations=60, sh_degree=1, density=DENSITY)
THREEDGS = {
    "plain": SHORT,
    "degree 3": replace(SHORT, sh_degree=3, density=replace(DENSITY, gradient=1e-6, most=60)),
    "several views": replace(SHORT, views_per_step=2, dropout=0.3, opacity_weight=0.01,
                             random_background=True, antialiased=True),
}  # fmt: skip
CITY: dict[str, Any] = {
    "iterations": 20, "sh_degree": 1, "blocks": 2,
    "density": replace(DENSITY, gradient=1e-6, largest_size=10.0, reset_interval=0),
}  # fmt: skip
CITIES: dict[str, tuple[str, dict[str, Any]]] = {
    "odbp+stitch": ("odbp+stitch", {}),
    "citygaussian": ("citygaussian", {"coarse_iterations": 5}),
    "stitchgs": ("stitchgs", {"quantise": False}),
    "dpgs-partition": ("dpgs-partition", {}),
    "odbp+stitch sgd": ("odbp+stitch",
                        {"refine": RefineSettings(optimizer="sgd", sh_dc=1e-3)}),
}  # fmt: skip

PHOTOS = "photos"
"""Name of the hash of what the runs are trained on: drawn by the reference, so by torch and MKL."""


def hashes(names: Sequence[str]) -> dict[str, str]:
    """Hashes of runs by name, and PHOTOS, made in a process of its own.

    Kernels and torch work at their lowest level there, and MKL in the way that it promises to be
    the same on every processor; else it rounds by the processor's maker and caches.
    """
    process = subprocess.run(
        [sys.executable, "-P", __file__, *names],
        env=os.environ | {
            "SPLATPROOF_SIMD": "portable", "ATEN_CPU_CAPABILITY": "default",
            "MKL_CBWR": "COMPATIBLE", "PYTHONPATH": str(Path(__file__).parents[1]),
        },
        capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip
    return dict(line.split("\t") for line in process.stdout.splitlines())


def photos() -> str:
    """Hash of the photos of both scenes."""
    views = [*tiny_scene().views, *small_scene(60).views]
    return digest({f"{i:03d}": view.load() for i, view in enumerate(views)})


def digest(arrays: dict[str, Tensor]) -> str:
    """Hash of named arrays."""
    found = hashlib.sha256()
    for name in sorted(arrays):
        found.update(name.encode())
        found.update(arrays[name].contiguous().numpy().tobytes())
    return found.hexdigest()


def threedgs(name: str, backend: str, seed: int = 3) -> str:
    """Hash of a run of 3dgs."""
    run = Run(backend=backend, threads=1, seed=seed)
    model = baked(get_method("3dgs").fit(tiny_scene(), THREEDGS[name], run))
    return digest({field: getattr(model, field) for field in FIELDS})


def city(name: str) -> str:
    """Hash of a run in blocks, in this process."""
    method, more = CITIES[name]
    settings = get_method(method).settings(**(CITY | more))
    run = Run(backend="cpu", threads=1, engine="inline", seed=3)
    model = get_method(method).fit(small_scene(60), settings, run)
    assert isinstance(model, CityModel)
    arrays = {field: getattr(model.model, field) for field in FIELDS}
    return digest(arrays | {"blocks": model.blocks, "distances": model.distances})


def digest_of(name: str) -> str:
    """Hash of a run by its name: of a city, or of 3dgs on a backend."""
    if name in CITIES:
        return city(name)
    kind, backend = name.removeprefix("3dgs ").rsplit(" ", 1)
    return threedgs(kind, backend)


if __name__ == "__main__":
    print(PHOTOS, photos(), sep="\t")
    for name in sys.argv[1:]:
        print(name, digest_of(name), sep="\t")
