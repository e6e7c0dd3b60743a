"""The folder that a user named for one case: what lies there is never replaced unasked."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from splatproof.base.differing import differences
from splatproof.base.errors import UsageError
from splatproof.suites.case_folder import OURS
from splatproof.suites.run_case import Job
from splatproof.suites.same_model import made_of


def check_chosen(job: Job) -> None:
    """Refuse a folder that holds what this job did not make; nothing is written.

    Raises: UsageError naming the folder and what it holds.
    """
    found = made_of(job.folder)
    if not found:
        foreign = [name for name in OURS if (job.folder / name).exists()]
        if foreign:
            raise UsageError(
                f"{job.folder}: holds {foreign[0]!r}, which no `bench fit` left there; take a folder "
                "that is new or empty"
            )
    elif job.resume and found.get("key") != job.key:
        case, backend = found.get("case"), found.get("backend")
        same = (case, backend) == (job.case.label, job.backend)
        raise UsageError(
            f"{job.folder}: holds {case} of backend {backend}"
            + (f" with other settings or protocol rules{_which(found, job)}" if same else "")
            + "; take another folder, or start over in this one with --no-resume"
        )


def _which(found: Mapping[str, Any], job: Job) -> str:
    """The settings and rules that differ, where the folder says what it was made with."""
    before, now = found.get("origin"), asdict(job.case.origin)
    if not isinstance(before, Mapping):  # an earlier release wrote it
        return ""
    parts = ("settings", "protocol")
    said = differences({name: before.get(name, {}) for name in parts}, {n: now[n] for n in parts})
    return f" ({said})" if said else ""
