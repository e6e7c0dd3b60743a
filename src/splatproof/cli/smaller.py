"""A trained model with fewer Gaussians, or trained through the steps of its small file, for `bench export`."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from splatproof.api.paths import model_path
from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.models import placed, protocol_of, scene_of

if TYPE_CHECKING:
    from splatproof.methods.models.explicit import ExplicitModel
    from splatproof.methods.storage.packed.coded_writer import CodeSettings
    from splatproof.reference.compression.quantisers import Steps
    from splatproof.reference.types.protocol import Protocol
    from splatproof.reference.types.scene import Scene


def smaller(
    given: Path,
    thin: float | None,
    tune: int | None,
    packed: Path | None,
    kept: "CodeSettings",
) -> "tuple[ExplicitModel, Steps | None]":
    """A model in its scene's frame, thinned and tuned, and the steps that it was tuned through.

    What a tuning has reached is kept beside the packed file until it is done: the same call continues.

    Args:
        given: The model as the user named it.
        thin: Share of the Gaussians that goes; None: none.
        tune: Training steps; None: none, and no file's steps.
        packed: The file that it is tuned for; needed where `tune` is given.
        kept: How finely that file stores it.
    Raises: UsageError for a model that is not made of plain Gaussians, that does not say its scene, or
        for numbers out of range.
    """
    import torch

    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.methods.compression.thinning import check_share, thinned
    from splatproof.methods.loading import load_origin, load_reconstruction
    from splatproof.methods.models.explicit import ExplicitModel
    from splatproof.methods.storage.packed.coded_writer import chosen_steps
    from splatproof.methods.storage.packed.rows import MemoryRows

    if thin is not None:
        check_share(thin, "--thin")
    if tune is not None and tune < 1:
        raise UsageError(f"--tune is {tune}, expected 1 training step or more")
    loaded, origin = load_reconstruction(model_path(given)), load_origin(model_path(given))
    if not isinstance(loaded, ExplicitModel):
        raise UsageError(
            f"{given}: --thin and --tune are for models of plain Gaussians, not of kind "
            f"{loaded.kind!r}; export it without them"
        )
    protocol = protocol_of(given, origin, None)
    scene = open_scene(scene_of(given, origin, None), protocol).for_training()
    model = placed(loaded, scene)
    assert isinstance(model, ExplicitModel)
    if thin is not None:
        draw = torch.Generator().manual_seed(origin.seed or 0)
        few = thinned(model.model, scene.train_views, thin, generator=draw, mode=model.mode)
        model = replace(model, model=few)
    if tune is None or packed is None:
        return model, None
    steps = chosen_steps(MemoryRows(model.model), kept)
    return _tuned(model, scene, protocol, steps, tune, packed), steps


def _tuned(
    model: "ExplicitModel",
    scene: "Scene",
    protocol: "Protocol",
    steps: "Steps",
    tune: int,
    packed: Path,
) -> "ExplicitModel":
    """The model, trained on with a bar; the checkpoint goes when that is done."""
    from splatproof.methods.compression.tuning import TuneSettings, tuned
    from splatproof.methods.contracts.run import Run

    folder = packed.with_name(packed.name + ".tuning")
    with output.progress() as bar:
        task = bar.add_task("tuning", total=tune, values="")

        def report(step: int, total: int, values: dict[str, float]) -> None:
            words = f"loss {values['loss']:.4f}"
            bar.update(task, completed=step, total=total, values=words)

        run = Run(folder=folder, background=protocol.background, report=report)
        settings = TuneSettings(iterations=tune)
        found = tuned(model.model, scene, steps, settings, run, model.mode)
    shutil.rmtree(folder, ignore_errors=True)
    return replace(model, model=found)
