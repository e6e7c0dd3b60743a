"""`bench train-prior`: train the networks that make priors, on worlds that no suite tests."""

import json
import shlex
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from splatproof.base.errors import UsageError
from splatproof.base.files import sha256, write_text
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.reference.types.scene import Scene

FIRST_SEED = 1000
"""Worlds are trained on from this seed on, where no registered scene lies."""
CURVE_EVERY = 50
"""Steps that one point of the record's loss curve is the mean of."""
MOST_BYTES = 4_000_000
"""Most bytes of a file of weights."""


def depth(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.safetensors")],
    *,
    worlds: tuple[str, ...] = ("courtyard", "city"),
    preset: str = "small",
    seeds: int = 2,
    steps: int = 1500,
) -> None:
    """Train the depth network of `--depth-prior own` and `network:FILE` on worlds made for it.

    Worlds are made in the cache folder and found there again. One thread trains, so that the same
    command gives the same bits on a machine; OUT is written at the end, and beside it a .json that
    says command, worlds, steps, losses and the hash. Leave out the kind of world that is to be
    tested to see what the network says of one it never saw.

    Args:
        out: File of the weights.
        worlds: Kinds of worlds (`bench scenes list` shows scenes of each).
        preset: Size of the worlds.
        seeds: Worlds of each kind, of the seeds 1000, 1001, ...
        steps: Batches of four views; about half a second each on one thread.

    Raises: UsageError for a kind or preset that there is not, and for fewer than one seed or step.
    """
    import torch

    from splatproof.methods.priors.network import save_network
    from splatproof.methods.priors.network_training import samples_of, train
    from splatproof.methods.training.threads import threads

    _check(out, worlds, preset, seeds, steps)
    numbers = list(range(FIRST_SEED, FIRST_SEED + seeds))
    facts = {"worlds": list(worlds), "preset": preset, "seeds": numbers, "steps": steps}
    losses: list[float] = []
    with threads(1):
        samples = [
            sample
            for world in worlds
            for seed in numbers
            for scene in _scenes(world, preset, seed)
            for sample in samples_of(scene)
        ]
        started = time.perf_counter()
        with output.progress() as bar:
            task = bar.add_task(f"depth on {len(samples)} views", total=steps, values="")

            def report(step: int, total: int, loss: float) -> None:
                losses.append(loss)
                bar.update(task, completed=step, total=total, values=f"loss {loss:.3f}")

            network = train(samples, steps=steps, report=report)
        seconds = time.perf_counter() - started
    save_network(out, network, facts)
    words = ["bench", "train-prior", "depth", out.name, "--worlds", *worlds, "--preset", preset]
    record = facts | {
        "command": shlex.join([*words, "--seeds", str(seeds), "--steps", str(steps)]),
        "sha256": sha256(out), "bytes": out.stat().st_size, "views": len(samples),
        "torch": torch.__version__, "train_seconds": round(seconds),
        "loss": _curve(losses), "loss_every": CURVE_EVERY,
    }  # fmt: skip
    write_text(out.with_suffix(".json"), json.dumps(record, indent=1) + "\n")
    output.emit(
        record, f"{out}: loss {record['loss'][0]} to {record['loss'][-1]} in {seconds:.0f} s"
    )


def _check(out: Path, worlds: tuple[str, ...], preset: str, seeds: int, steps: int) -> None:
    from splatproof.datasets.procedural.worlds import settings_of

    if out.suffix != ".safetensors":
        raise UsageError(f"{out}: expected a file name that ends in .safetensors")
    if not worlds:
        raise UsageError("--worlds names none, expected at least one kind of world")
    for world in worlds:
        settings_of(world, preset)
    for name, value in (("seeds", seeds), ("steps", steps)):
        if value < 1:
            raise UsageError(f"--{name} is {value}, expected 1 or more")


def _scenes(world: str, preset: str, seed: int) -> "Iterator[Scene]":
    """The scenes of a world, made in the cache unless they are there."""
    from splatproof.datasets.cache_folder import cache_folder
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.datasets.procedural.worlds import content, make
    from splatproof.datasets.progress import bar
    from splatproof.metrics.protocol_files import load_protocol

    folder = cache_folder() / "scenes" / content(world, preset, seed) / world
    if not folder.is_dir():
        with bar(f"making {world} {seed}") as report:
            make(world, preset, seed, folder, report)
    whole = (folder / "sparse").is_dir()
    parts = [folder] if whole else sorted(each.parent for each in folder.glob("*/sparse"))
    for part in parts:
        yield open_scene(str(part), load_protocol("default"))


def _curve(losses: list[float]) -> list[float]:
    """Means of CURVE_EVERY losses each, the last of what is left."""
    parts = [losses[at : at + CURVE_EVERY] for at in range(0, len(losses), CURVE_EVERY)]
    return [round(sum(part) / len(part), 4) for part in parts]
