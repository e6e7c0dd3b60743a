"""`bench fit METHOD SCENE`: train one method on one scene and score the held-out views."""

import inspect
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import tyro

from splatproof.cli import output


def subcommands() -> dict[str, Callable[..., int]]:
    """One command a method, so that each shows and takes its own settings."""
    from splatproof.methods.registry import methods

    return {name: _command(name) for name in methods()}


def fit(
    method: str,
    scene: str,
    settings: Any,
    *,
    out: Path,
    protocol: str = "default",
    seed: int = 0,
    backend: str = "cpu",
    threads: int | None = None,
    checkpoint_seconds: float = 30.0,
    engine: str = "processes",
    workers: int = 1,
) -> int:
    """Train, save the model to OUT/model, and score the held-out views.

    The same command continues a run that was interrupted. OUT also gets checkpoint/, renders/,
    truth/ and errors/; `bench render` and `bench export` take OUT. With --json each held-out image is
    a line: scene, method, seed, protocol, image and every metric by its name; then one without image:
    their means, gaussians, seconds by stage, render_ms.

    Args:
        method: Name of the method.
        scene: Name of a registered scene, or a scene folder.
        settings: The method's settings.
        out: Folder for the model, the checkpoints and the pictures.
        protocol: Name of a protocol, or the path of a .toml file: size, split, scoring rules.
        seed: Of every random draw.
        backend: Rasterizer: cpu, reference or cuda.
        threads: Threads to use; None: as many as torch does.
        checkpoint_seconds: Seconds between checkpoints.
        engine: Where the blocks of a city are trained: processes, inline or ray.
        workers: Blocks of a city that are trained at the same time.
    """
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.methods.backends import get_backend
    from splatproof.methods.models.base import Origin, save_model
    from splatproof.methods.registry import get_method
    from splatproof.methods.run import Run
    from splatproof.metrics.protocol_files import load_protocol
    from splatproof.metrics.registry import load_weights
    from splatproof.metrics.scoring import scene_metrics
    from splatproof.suites.held_out import score_views, scored_views

    row, rules = get_method(method), load_protocol(protocol)
    get_backend(backend)
    load_weights(rules.metrics)
    started = time.perf_counter()
    opened = open_scene(scene, rules)
    stages = {"load": time.perf_counter() - started}
    if opened.test:
        scored_views(opened, rules)  # what cannot be scored is told before the training
    output.log(
        f"{opened.name}: {len(opened.train)} views train, {len(opened.test)} {rules.scored} views are "
        f"scored, {len(opened.points)} points"
    )
    with output.progress() as bar:
        task = bar.add_task(method, total=settings.iterations, values="")

        def report(step: int, total: int, values: dict[str, float]) -> None:
            text = "  ".join(f"{name} {value:.5g}" for name, value in values.items())
            bar.update(task, completed=step, total=total, values=text)

        run = Run(
            folder=out, seed=seed, backend=backend, threads=threads, report=report,
            background=rules.background, on_stage=stages.__setitem__,
            checkpoint_seconds=checkpoint_seconds, engine=engine, workers=workers,
            say=output.log,
        )  # fmt: skip
        model = row.fit(opened.for_training(), settings, run)
    origin = Origin(
        method=method, settings=asdict(settings), scene=scene, protocol=asdict(rules), seed=seed
    )
    save_model(model, out / "model", origin)
    output.log(f"{model.primitives} Gaussians in {stages['train']:.1f} s; model in {out / 'model'}")
    record = {"scene": opened.name, "method": method, "seed": seed, "protocol": rules.name}
    facts = {"gaussians": model.primitives, "seconds": stages}
    if not opened.test:
        output.log(f"protocol {rules.name} holds no view out; nothing to score")
        return 0
    images, milliseconds = score_views(opened, model, rules, out)
    means = scene_metrics(images)
    for image in images:
        output.emit(
            record | {"image": image.name} | image.metrics, _line(image.name, image.metrics)
        )
    output.emit(record | means | facts | {"render_ms": milliseconds}, _line("mean", means))
    return 0


def _line(name: str, metrics: dict[str, float]) -> str:
    return f"{name:<24}" + "  ".join(f"{key} {value:.4f}" for key, value in metrics.items())


def _command(method: str) -> Callable[..., int]:
    """The function `fit` for one method, with its settings as flags."""
    from splatproof.methods.registry import get_method

    kind = get_method(method).settings
    hints = get_type_hints(fit) | {
        "scene": Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
        "settings": Annotated[kind, tyro.conf.arg(name="")],
    }
    parameters = [
        parameter.replace(annotation=hints[name])
        for name, parameter in inspect.signature(fit).parameters.items()
        if name != "method"
    ]

    def command(**options: Any) -> int:
        return fit(method, **options)

    # tyro reads the signature of `fit` without the method, not that of a test's type-checking wrapper
    command = inspect.unwrap(command)
    command.__doc__ = f"{get_method(method).description}.\n\n{inspect.cleandoc(fit.__doc__ or '')}"
    command.__annotations__ = hints
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command
