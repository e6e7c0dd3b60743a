"""A fit of one method on one scene, as the suite of one case that it is."""

from pathlib import Path
from typing import Any

from splatproof.base.errors import UsageError
from splatproof.base.memory import available_mb
from splatproof.base.names import unknown
from splatproof.datasets.pose_noise import LEVELS
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method
from splatproof.methods.training.image_room import image_allowance
from splatproof.reference.types.protocol import Protocol
from splatproof.suites.run_case import Job
from splatproof.suites.suite_files import Case, Suite, check_settings

SUITE = "fit"
"""What records and leaderboards call the suite of one case that each fit is."""


def job_of_one(
    method: str,
    scene: str,
    settings: Any,
    *,
    out: Path,
    protocol: Protocol,
    seed: int,
    pose_noise: str,
    depth_prior: str,
    **options: Any,
) -> tuple[Suite, Job]:
    """The suite and its only job.

    Args:
        method: Name of the method.
        scene: Registered name, or absolute folder.
        settings: Instance of the method's settings dataclass.
        out: Folder that the user named.
        protocol: The rules.
        seed: Number that every random draw depends on.
        pose_noise: Level of the noise on training poses.
        depth_prior: What `methods.priors.kinds.resolved` made of the user's words.
        **options: Further fields of Job.
    Raises: UsageError for a negative seed, an unknown level of pose noise, an unknown method or settings that no
        record can hold.
    """
    if seed < 0:
        raise UsageError(f"seed {seed}: expected a whole number from 0")
    if pose_noise not in LEVELS:
        raise unknown("pose_noise", pose_noise, LEVELS)
    check_settings(method, settings)
    case = Case(
        scene=scene, method=method, settings=settings, seed=seed, protocol=protocol,
        pose_noise=pose_noise, depth_prior=depth_prior,
    )  # fmt: skip
    # blocks divide what every run has: how many are trained at once goes by what they take
    image_bytes = Run.image_bytes if get_method(method).blocks else image_allowance(available_mb())
    suite = Suite(name=SUITE, description="", cases=(case,), scenes=())
    job = Job(
        case=case, suite=SUITE, suite_scenes=suite.scenes, folder=out, unscored=True,
        image_bytes=image_bytes, **options,
    )  # fmt: skip
    return suite, job
