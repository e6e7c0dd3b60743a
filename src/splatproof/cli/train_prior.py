"""`bench train-prior`: train the networks that make priors, on worlds that no suite tests."""

import json
import os
import shlex
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from splatproof.base.errors import MissingError, UsageError
from splatproof.base.files import check_target, sha256, write_text
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.methods.dpgs.refiner_training import Sample
    from splatproof.methods.priors.network import DepthNetwork
    from splatproof.methods.priors.network_training import Points
    from splatproof.reference.types.scene import Scene

N = TypeVar("N")

FIRST_SEED = 1000
"""Worlds are trained on from this seed on, where no registered scene lies."""
CURVE_EVERY = 50
"""Steps that one point of the record's loss curve is the mean of."""
APART = {"city": "city_unseen", "aerial-sparse": "aerial_sparse_3"}
"""Kinds of worlds with views apart from their photos, and the protocol that holds them out."""
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
    from splatproof.methods.priors.network_training import hide_points

    _train_depth("depth", out, worlds, preset, seeds, steps, points=hide_points)


def completion(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.safetensors")],
    *,
    worlds: tuple[str, ...] = ("aerial-sparse",),
    preset: str = "small",
    seeds: int = 3,
    steps: int = 2000,
) -> None:
    """Train the network that completes the depth of few photos (`stratosplat`, setting `completion.prior = "own"`).

    The depth network again, with points as matched photos leave them, drawn from true depth: dense in some regions,
    none in others, a few of them wrong. Worlds, threads, bits and the record are as for the depth network, of which
    the file is one: `--depth-prior network:FILE` takes it too. The record also says the loss on one more world of each
    kind, which the network never saw, and that of the nearest point's disparity; a constant has 1.

    Args:
        out: File of the weights.
        worlds: Kinds of worlds (`bench scenes list` shows scenes of each).
        preset: Size of the worlds.
        seeds: Worlds of each kind, of the seeds 1000, 1001, ...; the one after them is kept for the record.
        steps: Batches of four views; about a quarter of a second each on one thread.

    Raises: UsageError as the depth network's.
    """
    from splatproof.methods.priors.completion_training import errors, matched_points

    _train_depth(
        "completion", out, worlds, preset, seeds, steps, points=matched_points, apart=errors
    )


def refiner(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.safetensors")],
    *,
    worlds: tuple[str, ...] = ("city", "aerial-sparse"),
    preset: str = "small",
    seeds: int = 2,
    steps: int = 1200,
    model_steps: int = 300,
) -> None:
    """Train the network that refines side views (`dpgs`, setting `side.refiner = "own"`).

    Each world is trained on for a moment, and drawn from where it was never photographed: there the network
    learns what a render lacks. Worlds, threads, bits and the record are as for the depth network; the record also
    says the mean error, where there is no evidence, of renders, of warping and of the network on one more world
    of each kind, which it never saw.

    Args:
        out: File of the weights.
        worlds: city (trained on its flight, drawn low and at facades) and aerial-sparse (three photos).
        preset: Size of the worlds.
        seeds: Worlds of each kind, of the seeds 1000, 1001, ...; the one after them is kept for the record.
        steps: Batches of four crops; about a third of a second each on one thread.
        model_steps: Steps of the shorter of two trainings of each scene.

    Raises: UsageError for a kind that has no such views, and as the depth network's.
    """
    from splatproof.methods.dpgs.refiner_training import errors, samples_of, train
    from splatproof.methods.priors.view_refiner import save_refiner
    from splatproof.methods.training.threads import threads

    _check(out, worlds, preset, seeds, steps)
    for world in worlds:
        if world not in APART:
            raise UsageError(
                f"{world}: no views apart from its photos; there are {', '.join(APART)}"
            )
    if model_steps < 1:
        raise UsageError(f"--model-steps is {model_steps}, expected 1 or more")
    facts, numbers = _facts(worlds, preset, seeds, steps)
    facts |= {"model_steps": model_steps}

    def drawn(number: int) -> "list[Sample]":
        return [
            sample
            for world in worlds
            for scene in _scenes(world, preset, number, APART[world])
            for sample in samples_of(scene, steps=model_steps)
        ]

    with threads(1):
        samples = [sample for number in numbers for sample in drawn(number)]
        network, losses, seconds = _trained("refiner", train, samples, steps)
        apart = errors(network, drawn(numbers[-1] + 1))
    save_refiner(out, network, facts)
    record = facts | _record("refiner", out, facts, len(samples), losses, seconds)
    record |= {"error_apart": {name: round(value, 5) for name, value in apart.items()}}
    _tell(out, record)


def matcher(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.safetensors")],
    *,
    worlds: tuple[str, ...] = ("courtyard", "aerial-sparse"),
    preset: str = "small",
    seeds: int = 2,
    steps: int = 900,
) -> None:
    """Train the network that matches photos before a training (`dense.matcher = "own"`).

    It learns from pairs of photos of worlds whose depth is known. Worlds, threads, bits and the record are as for
    the depth network; the record also says which share of pixels it and optical flow are sure of on one more world
    of each kind, which it never saw, and how many pixels these are off.

    Args:
        out: File of the weights.
        worlds: Kinds of worlds (`bench scenes list` shows scenes of each); one that is left out says what it does
            out of domain.
        preset: Size of the worlds.
        seeds: Worlds of each kind, of the seeds 1000, 1001, ...; the one after them is kept for the record.
        steps: Parts of pairs of photos; about a third of a second each on one thread.

    Raises: UsageError as the depth network's.
    """
    from splatproof.methods.priors.own_matcher import save_matcher
    from splatproof.methods.priors.own_matcher_training import errors, samples_of, train
    from splatproof.methods.training.threads import threads

    _check(out, worlds, preset, seeds, steps)
    facts, numbers = _facts(worlds, preset, seeds, steps)
    with threads(1):
        samples = [
            sample
            for number in numbers
            for world in worlds
            for scene in _scenes(world, preset, number)
            for sample in samples_of(scene)
        ]
        network, losses, seconds = _trained("matcher", train, samples, steps, "pairs")
        apart = {
            world: [errors(network, scene) for scene in _scenes(world, preset, numbers[-1] + 1)]
            for world in worlds
        }
    save_matcher(out, network, facts)
    record = facts | _record("matcher", out, facts, len(samples), losses, seconds, "pairs")
    record |= {"apart": {world: _means(found) for world, found in apart.items()}}
    _tell(out, record)


def _train_depth(
    name: str,
    out: Path,
    worlds: tuple[str, ...],
    preset: str,
    seeds: int,
    steps: int,
    *,
    points: "Points",
    apart: "Callable[[DepthNetwork, list[Any]], dict[str, float]] | None" = None,
) -> None:
    """Train, write and tell of a depth network whose points are drawn as `points` does, and of its errors, where
    `apart` measures them, on one more world of each kind."""
    from splatproof.methods.priors.network import save_network
    from splatproof.methods.priors.network_training import samples_of, train
    from splatproof.methods.training.threads import threads

    _check(out, worlds, preset, seeds, steps)
    facts, numbers = _facts(worlds, preset, seeds, steps)

    def drawn(world: str, number: int) -> "list[Any]":
        return [each for one in _scenes(world, preset, number) for each in samples_of(one)]

    with threads(1):
        samples = [each for world in worlds for number in numbers for each in drawn(world, number)]
        network, losses, seconds = _trained(name, partial(train, points=points), samples, steps)
        kept = numbers[-1] + 1
        found = {} if apart is None else {w: apart(network, drawn(w, kept)) for w in worlds}
    save_network(out, network, facts)
    record = facts | _record(name, out, facts, len(samples), losses, seconds)
    if found:
        record |= {"apart": {w: {k: round(v, 4) for k, v in e.items()} for w, e in found.items()}}
    _tell(out, record)


def _means(found: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """Each number's mean over scenes."""
    return {
        name: {
            what: round(sum(one[name][what] for one in found) / len(found), 4)
            for what in found[0][name]
        }
        for name in found[0]
    }


def _facts(
    worlds: tuple[str, ...], preset: str, seeds: int, steps: int
) -> tuple[dict[str, object], list[int]]:
    """What a file of weights says of its training, and the seeds of its worlds."""
    numbers = list(range(FIRST_SEED, FIRST_SEED + seeds))
    return {"worlds": list(worlds), "preset": preset, "seeds": numbers, "steps": steps}, numbers


def _trained(
    name: str, train: "Callable[..., N]", samples: list[Any], steps: int, what: str = "views"
) -> "tuple[N, list[float], float]":
    """A network, the loss of each step and the seconds it took."""
    losses: list[float] = []
    started = time.perf_counter()
    with output.progress() as bar:
        task = bar.add_task(f"{name} on {len(samples)} {what}", total=steps, values="")

        def report(step: int, total: int, loss: float) -> None:
            losses.append(loss)
            bar.update(task, completed=step, total=total, values=f"loss {loss:.3f}")

        network = train(samples, steps=steps, report=report)
    return network, losses, time.perf_counter() - started


def _record(
    name: str,
    out: Path,
    facts: dict[str, Any],
    count: int,
    losses: list[float],
    seconds: float,
    what: str = "views",
) -> dict[str, Any]:
    """What the file beside the weights adds: the command that makes them again, hash and curve."""
    import torch

    words = ["bench", "train-prior", name, out.name, "--worlds", *facts["worlds"]]
    words += ["--preset", facts["preset"], "--seeds", str(len(facts["seeds"]))]
    words += ["--steps", str(facts["steps"])]
    if "model_steps" in facts:
        words += ["--model-steps", str(facts["model_steps"])]
    return {
        "command": shlex.join(words), "sha256": sha256(out), "bytes": out.stat().st_size,
        what: count, "torch": torch.__version__, "train_seconds": round(seconds),
        "loss": _curve(losses), "loss_every": CURVE_EVERY,
    }  # fmt: skip


def _tell(out: Path, record: dict[str, Any]) -> None:
    write_text(out.with_suffix(".json"), json.dumps(record, indent=1) + "\n")
    first, last = record["loss"][0], record["loss"][-1]
    output.emit(record, f"{out}: loss {first} to {last} in {record['train_seconds']} s")


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
    check_target(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    if not os.access(out.parent, os.W_OK):
        raise MissingError(f"{out.parent}: cannot write here; choose another folder")


def _scenes(world: str, preset: str, seed: int, protocol: str = "default") -> "Iterator[Scene]":
    """The scenes of a world under a protocol, made in the cache unless they are there."""
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
        yield open_scene(str(part), replace(load_protocol(protocol), width=None))


def _curve(losses: list[float]) -> list[float]:
    """Means of CURVE_EVERY losses each, the last of what is left."""
    parts = [losses[at : at + CURVE_EVERY] for at in range(0, len(losses), CURVE_EVERY)]
    return [round(sum(part) / len(part), 4) for part in parts]
