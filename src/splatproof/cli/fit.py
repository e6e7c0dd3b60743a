"""`bench fit METHOD SCENE`: train one method on one scene and score the held-out views."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from splatproof.base.errors import UsageError
from splatproof.cli import output
from splatproof.cli.binding import bound
from splatproof.cli.flags import and_plugins
from splatproof.cli.running import (
    USUAL,
    USUAL_BLOCKS,
    BlockRunning,
    Running,
    Screen,
    check_options,
    exit_code,
    options,
    prepare,
    record,
)
from splatproof.cli.scene_opening import Points, scene_rules, tell_left_out
from splatproof.cli.short_runs import short_run

if TYPE_CHECKING:
    from splatproof.suites.run_case import Job
    from splatproof.suites.runner import Outcome


def subcommands() -> dict[str, Callable[..., int]]:
    """One command a method, so that each shows and takes its own settings."""
    from splatproof.methods.registry import methods

    return {name: _command(name) for name in methods()}


def fit(
    method: str,
    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")],
    settings: Any,
    *,
    out: Path,
    protocol: str = "default",
    width: int | None = None,
    points: Points | None = None,
    strict: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    seed: int = 0,
    pose_noise: Literal["none", "L1", "L2", "L3"] = "none",
    depth_prior: str = "none",
    view: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    running: Annotated[Running, tyro.conf.arg(name="")] = USUAL,
    blocks: Annotated[BlockRunning, tyro.conf.arg(name="")] = USUAL_BLOCKS,
) -> int:
    """Train, score the held-out views, and keep everything in OUT: the model, pictures and a record.

    It is a suite of one case, run as `bench run` runs its cases. OUT gets model/, renders/, truth/,
    errors/ (and masks/, seams/, blocks/ where there are any) and record.json with every score, cost
    and version. The same command continues a run that was interrupted at any moment, and keeps one
    that is finished; what was made with other settings is refused, not replaced. `bench render` and
    `bench export` take OUT; `bench report --out OUT` shows it, and `bench report` on a folder above
    shows all the fits in it beside each other.

    With --json each held-out image is a line: scene, method, seed, protocol, image and every metric
    by its name; the last line is that of the case, as `bench run --json` prints it: suite, scene,
    method, variant, pose_noise, depth_prior, protocol, seed, status (kept, finished, failed), error,
    folder, the mean of every metric, seconds by stage, primitives, bytes_on_disk, peak_memory_mb,
    render_ms.

    Args:
        method: Name of the method.
        scene: Name of a registered scene, or a scene folder.
        settings: The method's settings.
        out: Folder for everything; new, or one that the same command has begun.
        protocol: Name of a protocol (`bench protocols` lists and explains them), or the path of a
            .toml file: size and split of the images, and how renders are scored.
        width: Width of the images in pixels, in training and in scoring. None: the protocol's.
        points: Where the sparse points come from that training starts from: the scene's own, or
            triangulated from the training photos under their given poses, for a scene that has poses
            and no points. None: as the protocol says.
        strict: Refuse a COLMAP model or transforms.json that names photos which are not there, instead of
            leaving them out.
        seed: Number that every random draw depends on; equal seeds give equal models.
        pose_noise: Level of the noise on the poses of training views, drawn with the seed: L1 turns
            each by 0.5 degrees and shifts it by 0.001 of the scene's extent (standard deviations),
            L2 by 1 and 0.002, L3 by 2 and 0.005. Held-out views and sparse points stay true.
        depth_prior: Depth prior that the method may read of each training view: oracle (true depth
            of a made world), oracle+noise, lidar (sweeps, completed), sweep (matched photos),
            network:FILE (our own network's weights), depth-anything:FOLDER, or none.
        view: Show the model in the browser while it trains; the address is told on stderr. The model is
            the same to the bit. Not for methods that train in blocks.
        running: How it is run.
        blocks: How blocks of a city are trained.
    """
    from splatproof.cli.expected_time import expected_time
    from splatproof.cli.report import sync_cases
    from splatproof.methods.priors.kinds import resolved
    from splatproof.methods.registry import get_method
    from splatproof.reports.mlflow_client import default_uri
    from splatproof.suites.chosen_folder import check_chosen
    from splatproof.suites.one_case import job_of_one
    from splatproof.suites.records import RECORD_NAME
    from splatproof.suites.runner import run_alone
    from splatproof.suites.scenes import check_opens, check_scene

    uri = default_uri(out)
    where = str(Path(scene).resolve()) if Path(scene).is_dir() else scene
    suite, job = job_of_one(
        method, where, settings, out=out, protocol=scene_rules(protocol, width, points, strict),
        seed=seed, pose_noise=pose_noise,
        depth_prior=resolved(depth_prior, Path.cwd(), "--depth-prior"), **options(running, blocks),
    )  # fmt: skip
    if view and get_method(method).blocks:
        raise UsageError(
            f"--view: {method} trains blocks in processes of their own, which no page follows; leave it "
            f"out and run `bench view {out}` when they are done"
        )
    check_options(suite, running, blocks)
    check_scene(where)
    check_chosen(job)
    prepare(suite)
    opened = check_opens(job.case)
    tell_left_out(opened)
    if not (out / RECORD_NAME).exists():
        output.log(expected_time(job.case, opened, running.backend))
    if short := short_run(settings):
        output.log(short)
    with _watched(job) if view else nullcontext(job) as job, output.progress() as bar:
        screen = Screen(bar, _print_scores)
        outcome = run_alone(job, on_progress=screen.progress, on_result=screen.result)
    if sync_cases(out, uri):
        output.warn(f"the record is on disk; the next `bench report --out {out}` logs it")
    if not outcome.result.error:
        where, also = quote(str(out)), and_plugins()
        look, page = f"bench view {where}{also}", f"bench report --out {where}{also}"
        output.log(f"look at it: {look}; page with pictures: {page}")
    return exit_code([outcome])


@contextmanager
def _watched(job: "Job") -> "Iterator[Job]":
    """The job while a page shows its model."""
    from splatproof.viewing.live import watched

    case = job.case
    with watched(case.scene, case.protocol, f"{case.method} in training", output.log) as folder:
        yield replace(job, snapshots=folder)


def _print_scores(outcome: "Outcome") -> None:
    """A line an image, then the means."""
    result = outcome.result
    label = {name: getattr(result, name) for name in ("scene", "method", "seed", "protocol")}
    for image in result.images:
        output.emit(label | {"image": image.name} | image.metrics, _line(image.name, image.metrics))
    if output.wants_json():
        output.print_record(record(outcome))
    elif result.metrics:
        output.print_text(_line("mean", result.metrics))


def _line(name: str, metrics: dict[str, float]) -> str:
    return f"{name:<24}" + "  ".join(f"{key} {value:.4f}" for key, value in metrics.items())


def _command(name: str) -> Callable[..., int]:
    """The command of one method, with its settings as flags."""
    from splatproof.methods.registry import get_method

    method = get_method(name)
    return bound(
        fit,
        {"method": name},
        without=set() if method.blocks else {"blocks"},
        kinds={"settings": Annotated[method.settings, tyro.conf.arg(name="")]},
        title=f"{method.description}.",
    )
