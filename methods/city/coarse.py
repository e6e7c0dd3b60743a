"""The coarse model of a whole scene that blocks start from: trained once, and what of it is whose."""

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Float64, Int8, Int32
from torch import Tensor

from splatproof.base.memory import peak_within
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city.partition import Partition
from splatproof.methods.city.point_roles import Auxiliary, assigned
from splatproof.methods.city.regions import nearest_region
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.models.exposure import exposed
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.session import run_key
from splatproof.reference.partition.ghosts import RIM
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import Scene

BESIDE = 0.15
"""Share of an image's size by which it is widened when it is asked what a view shows: a Gaussian whose
middle lies beside the image may reach into it. The same share by which the release of 3DGS widens its."""

Report = Callable[[int, int, dict[str, float]], None]
Stage = Callable[[], dict[str, Any]]


def coarse_stage(
    scene: Scene, settings: Settings, run: Run, folder: Path, report: Report
) -> tuple[Path, Stage]:
    """The file of a coarse model, and the stage that trains it unless it is there.

    Args:
        scene: The whole scene.
        settings: What its training follows.
        run: Seed, backend and checkpoints; runs that share its cache share equal coarse models.
        folder: The run's own folder: checkpoints, and the file where there is no cache.
        report: Called as report(step, total, values).

    Returns: The path, named by all that the model depends on; and the stage, which returns the seconds
        of the training, those of an earlier one where the file was there ("shared").
    """
    at = replace(run, folder=folder / "coarse", report=report)
    key = hashlib.sha256(run_key(scene, settings, at, "coarse").encode()).hexdigest()[:16]
    path = (run.cache or folder) / f"coarse-{key}.safetensors"
    return path, partial(_train, scene, settings, at, path)


def _train(scene: Scene, settings: Settings, at: Run, path: Path) -> dict[str, Any]:
    peak = {"peak_mb": 0.0}  # not known
    if path.exists():
        return peak | read_tensors(path)[1] | {"shared": True}
    with peak_within(peak, "peak_mb"):
        model, plan = prepare(scene, settings, at)
        trainer = Trainer(exposed(model, settings.exposure, plan.views), plan, at)
        trainer.resume()
        trainer.train()
    trained = model.gaussians()
    facts = {"seconds": trainer.seconds, "cpu_seconds": trainer.cpu_seconds,
             "densifications": trainer.counts.densifications, **peak}  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    write_tensors(path, {name: getattr(trained, name) for name in FIELDS}, facts)
    assert at.folder is not None
    shutil.rmtree(at.folder, ignore_errors=True)
    return facts


def coarse_roles(
    means: Float64[Tensor, "n 3"],
    scene: Scene,
    found: Partition,
    views: Sequence[Bool[Tensor, " v"]],
    auxiliary: Auxiliary,
    margin: float,
) -> tuple[Int8[Tensor, " n"], ...]:
    """Role of each Gaussian of a coarse model in each block.

    A block's own are those in its region widened by the margin, and those that no other region is
    nearer to. Beyond, what its views show is context, or ghosts; ghosts also lie within a normalised
    distance of 1.2. Without auxiliary Gaussians all of the coarse model is every block's own, as in
    CityGaussian.

    Args:
        means: Positions of the coarse model in the scene's frame.
        scene: The whole scene.
        found: Its partition.
        views: For each block, which of the scene's views train it.
        auxiliary: What takes part beside the block's own Gaussians.
        margin: Share of its size by which a region is widened, as in normalised distances.

    Returns: For each block OWN, CONTEXT, GHOST or LEFT_OUT for each Gaussian.

    Source: ours; without auxiliary Gaussians CityGaussian, Sec. 3.2.
    """
    if auxiliary == "none":
        return (torch.zeros(len(means), dtype=torch.int8),) * len(views)
    owner = nearest_region(found.regions, means)
    roles = []
    for block, region in enumerate(found.regions):
        away = region.distance(means)
        own = (away <= 1 + margin) | (owner == block)
        seen = shown([scene.views[i].camera for i in views[block].nonzero()[:, 0].tolist()], means)
        near = away <= 1 + RIM
        roles.append(assigned(own, seen, near | seen, auxiliary))
    return tuple(roles)


def shown(cameras: Sequence[Camera], means: Float64[Tensor, "n 3"]) -> Bool[Tensor, " n"]:
    """Places that any of the cameras shows, see `shown_by`.

    Args:
        cameras: Who looks.
        means: Places in the scene's frame.
    """
    return shown_by(cameras, means) > 0


def shown_by(cameras: Sequence[Camera], means: Float64[Tensor, "n 3"]) -> Int32[Tensor, " n"]:
    """How many cameras show each place: in front, in the image widened by BESIDE, whatever hides it.

    Args:
        cameras: Who looks.
        means: Places in the scene's frame.
    """
    found = torch.zeros(len(means), dtype=torch.int32)
    for camera in cameras:
        pixel, depth = project_points(camera, means)
        size = pixel.new_tensor([camera.width, camera.height])
        inside = (pixel >= -BESIDE * size) & (pixel <= (1 + BESIDE) * size)
        found += inside.all(dim=1) & (depth > 0)
    return found
