"""Training as a function: the same road as `bench fit`, a suite of one case."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from splatproof.api.models import load
from splatproof.api.scenes import rules_of
from splatproof.base.errors import SplatproofError, UsageError
from splatproof.base.inside import allowing_outside, outside_is_allowed
from splatproof.base.typed_toml import build
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.priors.kinds import resolved
from splatproof.methods.registry import get_method
from splatproof.metrics.registry import load_weights
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import Result
from splatproof.reports.mlflow_client import default_uri
from splatproof.reports.store import sync
from splatproof.suites.chosen_folder import check_chosen
from splatproof.suites.one_case import job_of_one
from splatproof.suites.run_case import CHECKPOINT_SECONDS
from splatproof.suites.runner import Progress, run_alone
from splatproof.suites.scenes import check_opens, check_scene, make_scenes


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A finished fit and where it lies."""

    folder: Path
    """The folder with model/, renders/, truth/, errors/ and record.json."""
    status: Literal["kept", "finished"]
    """kept: it was finished before; finished: it ran now."""
    result: Result
    """The record: every score, cost, setting and version; `result.images` has each view's scores."""

    @property
    def metrics(self) -> dict[str, float]:
        """Mean of each metric over the held-out views by name, and values of the whole scene."""
        return dict(self.result.metrics)

    def load(self, *, backend: str = "cpu") -> Reconstruction:
        """The model.

        Args:
            backend: Name of the rasterizer that draws it.
        Raises: As `splatproof.load`.
        """
        return load(self.folder, backend=backend)


def fit(
    method: str,
    scene: str | Path,
    *,
    out: str | Path,
    settings: Mapping[str, Any] | object | None = None,
    protocol: str | Path | Protocol = "default",
    width: int | None = None,
    seed: int = 0,
    pose_noise: str = "none",
    depth_prior: str = "none",
    backend: str = "cpu",
    threads: int | None = None,
    resume: bool = True,
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
    allow_outside: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Fitted:
    """Train one method on one scene and score the held-out views, as `bench fit` does.

    It runs in a process of its own. The same call continues what was interrupted at any moment and
    keeps what is finished; what was made with other settings is refused, not replaced. The record
    is logged to MLFLOW_TRACKING_URI, else to OUT/mlflow.db.

    Args:
        method: Name of a method.
        scene: Folder of a scene, or a name of `bench scenes list`.
        out: Folder for everything; new, or one that the same call has begun.
        settings: Settings that differ from the method's defaults, by name; or an instance of its
            settings dataclass.
        protocol: Name of `bench protocols`, path of a .toml file, or the rules.
        width: Width of the images in pixels; None: the protocol's own.
        seed: Number that every random draw depends on; equal seeds give equal models.
        pose_noise: Noise on the poses of training views: none, L1, L2 or L3.
        depth_prior: Depth prior that the method may read; see docs/depth_priors.md.
        backend: Name of the rasterizer: cpu, reference or cuda.
        threads: Threads of torch and the kernels; None: as many as torch takes.
        resume: False removes what an earlier fit left in the folder.
        checkpoint_seconds: Seconds of training between two checkpoints, >= 0.
        allow_outside: Read photos and masks that the scene's files name outside its folder, or that
            links lead to; only for scenes that you trust.
        on_progress: Hears stage, step and the loss while it runs.
    Returns: The finished fit.
    Raises: UsageError for an unknown name or setting, or a folder that holds something else;
        DataError for a damaged scene; MissingError if this machine lacks something;
        SplatproofError with the reason if training failed.
    Source: ours.

    Warns: Where the tracking store cannot be reached; the record is on disk then.
    """
    out = Path(out)
    uri = default_uri(out)
    rules = rules_of(protocol, width)
    suite, job = job_of_one(
        method, _where(scene), _settings(method, settings), out=out, protocol=rules, seed=seed,
        pose_noise=pose_noise, depth_prior=resolved(depth_prior, Path.cwd(), "depth_prior"),
        backend=backend, threads=threads, resume=resume, checkpoint_seconds=checkpoint_seconds,
    )  # fmt: skip
    with allowing_outside(allow_outside or outside_is_allowed()):
        get_backend(backend)
        check_scene(job.case.scene)
        check_chosen(job)
        load_weights(rules.metrics)
        make_scenes(suite, lambda done, total: None)
        check_opens(job.case)
        outcome = run_alone(job, on_progress=on_progress)
    for failure in sync([out], uri):
        warnings.warn(f"{out}: not logged: {failure.reason}", stacklevel=2)
    if outcome.status == "failed":
        raise SplatproofError(f"{job.case.label} failed: {outcome.result.error} (folder {out})")
    return Fitted(folder=out, status=outcome.status, result=outcome.result)


def _settings(method: str, given: Mapping[str, Any] | object | None) -> object:
    """An instance of the method's settings. Raises: UsageError naming the setting."""
    kind = get_method(method).settings
    if isinstance(given, kind):
        return given
    if given is None or isinstance(given, Mapping):
        return build(kind, given or {}, f"settings of {method}")
    raise UsageError(
        f"settings of {method}: found a {type(given).__name__}, expected names and values or a "
        f"{kind.__name__} of {kind.__module__}"
    )


def _where(scene: str | Path) -> str:
    """An absolute folder where there is one, else a registered name."""
    return str(Path(scene).resolve()) if Path(scene).is_dir() else str(scene)
