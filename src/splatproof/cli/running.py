"""What `bench fit` and `bench run` share: how cases are run, and what is shown meanwhile."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from splatproof.reference.types.result import Result
    from splatproof.suites.runner import Outcome, Progress
    from splatproof.suites.suite_files import Case, Suite


@dataclass(frozen=True, kw_only=True)
class Running:
    """How it is run. Only the backend changes the numbers."""

    backend: str = "cpu"
    """Name of the rasterizer that trains and renders: cpu, reference or cuda. `bench doctor` says
    which are ready."""
    threads: int | None = None
    """Threads of torch and the kernels. None: as many as torch takes by itself."""
    checkpoint_seconds: float = 15.0
    """Seconds of training between two checkpoints: what a kill loses at most."""
    resume: bool = True
    """Keep what is finished and continue what was interrupted. With --no-resume results that are
    there are removed and everything starts over."""

    def __post_init__(self) -> None:
        """Refuse what cannot be. Raises: UsageError."""
        if self.threads is not None and self.threads < 1:
            raise UsageError(f"--threads is {self.threads}, expected 1 or more")
        if not self.checkpoint_seconds >= 0:
            raise UsageError(
                f"--checkpoint-seconds is {self.checkpoint_seconds}, expected 0 or more seconds"
            )


@dataclass(frozen=True, kw_only=True)
class BlockRunning:
    """How the blocks of a city are trained. It does not change the numbers."""

    workers: int | None = None
    """Blocks that are trained at the same time. None: one for each core."""
    engine: Literal["processes", "inline", "ray"] = "processes"
    """Where blocks are trained: each in a process here, one after the other in one process, or on a
    Ray cluster."""

    def __post_init__(self) -> None:
        """Refuse what cannot be. Raises: UsageError."""
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers is {self.workers}, expected 1 or more")


USUAL, USUAL_BLOCKS = Running(), BlockRunning()
"""How things run where nothing else is asked for."""


def check_options(suite: "Suite", running: Running, blocks: BlockRunning) -> None:
    """Refuse, before anything is written, options that no case can obey.

    Args:
        suite: The cases that are about to run.
        running: How they are to be run.
        blocks: How blocks are to be trained.
    Raises: UsageError for a backend that does not exist, or options of blocks where no case has
        any; MissingError if this machine lacks what the backend needs.
    """
    from splatproof.methods.contracts.backends import get_backend
    from splatproof.methods.registry import get_method

    get_backend(running.backend)
    names = sorted({case.method for case in suite.cases})
    if blocks != USUAL_BLOCKS and not any(get_method(name).blocks for name in names):
        raise UsageError(
            "--workers and --engine are for methods that train a scene in blocks, and of the cases of suite "
            f"{suite.name} that are to run none does ({', '.join(names)}); leave them out"
        )


def options(running: Running, blocks: BlockRunning) -> dict[str, Any]:
    """The options as a job of `splatproof.suites.run_case` takes them.

    Args:
        running: How cases are run.
        blocks: How blocks are trained.
    Returns: Values by the names of Job's fields.
    """
    from splatproof.suites.environment import usable_cores

    workers = usable_cores() if blocks.workers is None else blocks.workers
    return {**vars(running), "engine": blocks.engine, "workers": workers}


def prepare(suite: "Suite") -> None:
    """Load the metrics' weights and make the procedural scenes that are not made yet, with a bar.

    Raises: MissingError if weights are not on this machine: better now than after the training.
    """
    from splatproof.metrics.registry import load_weights
    from splatproof.suites import scenes

    load_weights({metric for case in suite.cases for metric in case.protocol.metrics})
    with output.progress() as bar:
        task = bar.add_task("making scenes", total=None, values="")
        scenes.make_scenes(suite, lambda done, total: bar.update(task, completed=done, total=total))


class Screen:
    """What a person sees while cases run, on stderr."""

    def __init__(self, bar: "Bar", show: "Callable[[Outcome], None]") -> None:
        """Add one task to the bar, for the running case.

        Args:
            bar: Where progress is shown.
            show: Prints the result of a case on stdout.
        """
        self._bar, self._show = bar, show
        self._task = bar.add_task("", total=None, values="")

    def progress(self, at: "Progress") -> None:
        """Show where the case is."""
        if at.stage == "start":
            note = f" {at.note}" if at.note else ""
            output.log(f"[{at.index + 1}/{at.count}] {at.case.label}{note}")
            self._bar.reset(self._task, total=None, description=at.case.label, values="")
        elif at.note:
            output.log(at.note)
            return
        values = "  ".join(f"{name} {value:.4g}" for name, value in (at.values or {}).items())
        self._bar.update(
            self._task,
            completed=at.step,
            total=at.total or None,
            description=f"{at.case.label} {at.stage}",
            values=values,
        )

    def result(self, outcome: "Outcome") -> None:
        """Tell what became of the case."""
        from splatproof.suites.case_folder import TRACEBACK

        result, case = outcome.result, outcome.case
        self._show(outcome)
        if result.error:
            where = outcome.folder / TRACEBACK
            told = f"traceback: {where}" if where.exists() else f"folder {outcome.folder}"
            output.warn(f"{case.label} failed: {result.error} ({told})")
            return
        spent = sum(result.stages.values())
        output.log(f"{outcome.status}: {case.label}  {scores(case, result.metrics)}  {spent:.1f} s")


def scores(case: "Case", metrics: dict[str, float]) -> str:
    """The protocol's metrics in words.

    Args:
        case: What was scored.
        metrics: Values by name; a scene that holds no view out has none.
    Returns: Names and values, or that there are none.
    """
    named = [name for name in case.protocol.metrics if name in metrics]
    if not named:
        return f"not scored: protocol {case.protocol.name} holds no view out"
    return "  ".join(f"{name} {metrics[name]:.4g}" for name in named)


def case_of(result: "Result") -> dict[str, object]:
    """Which case a line of --json is about."""
    return {
        "suite": result.suite,
        "scene": result.scene,
        "method": result.method,
        "variant": result.variant,
        "pose_noise": result.pose_noise,
        "depth_prior": result.depth_prior,
        "protocol": result.protocol,
        "seed": result.seed,
    }


def record(outcome: "Outcome") -> dict[str, object]:
    """The line that --json prints of a case."""
    result = outcome.result
    return {
        **case_of(result),
        "status": outcome.status,
        "error": result.error,
        "folder": str(outcome.folder),
        **result.metrics,
        "seconds": result.stages,
        "primitives": result.primitives,
        "bytes_on_disk": result.bytes_on_disk,
        "peak_memory_mb": result.peak_memory_mb,
        "render_ms": result.render_ms,
    }


def of_other_code(outcomes: "Sequence[Outcome]") -> str:
    """One line where results were kept that another commit made; empty where none is known to be.

    A kept result says nothing of the code that is here now: whoever compares two versions must know.

    Args:
        outcomes: What became of each case.
    """
    from splatproof.reports.comparing.sides import short_commit
    from splatproof.suites.environment import git_commit

    kept = [one.result.environment.get("commit", "") for one in outcomes if one.status == "kept"]
    now = git_commit() if any(kept) else ""
    other = [commit for commit in kept if commit and now and commit != now]
    if not other:
        return ""
    made = ", ".join(sorted({short_commit(commit) for commit in other}))
    return (
        f"{len(other)} of {len(outcomes)} results were kept and are of commit {made}, while this code is "
        f"{short_commit(now)}; another --out, or --no-resume, measures this code"
    )


def exit_code(outcomes: "Iterable[Outcome]") -> int:
    """1 if a case failed, else 0."""
    return int(any(outcome.status == "failed" for outcome in outcomes))
