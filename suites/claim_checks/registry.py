"""All checks of claims by name, and how one is run."""

import tempfile
from pathlib import Path

from splatproof.base.errors import SplatproofError
from splatproof.base.names import unknown
from splatproof.reference.types.checked import Checked
from splatproof.suites.claim_checks.accuracy import ACCURACY
from splatproof.suites.claim_checks.bits import BITS
from splatproof.suites.claim_checks.check import Check
from splatproof.suites.claim_checks.seam import SEAM
from splatproof.suites.claim_checks.size import SIZE
from splatproof.suites.claim_checks.speed import SPEED
from splatproof.suites.claim_checks.steps import STEPS
from splatproof.suites.environment import environment

CHECKS: dict[str, Check] = {**SPEED, **STEPS, **BITS, **SIZE, **ACCURACY, **SEAM}


def run_check(name: str, *, reduced: bool = False) -> Checked:
    """Measure what a claim is about. What this machine lacks is an error of the result.

    Args:
        name: Name of the check.
        reduced: Smaller cases, and fewer of them.
    Raises: UsageError for a check that does not exist.
    """
    if name not in CHECKS:
        raise unknown("check", name, CHECKS)
    check = CHECKS[name]
    facts = environment("cpu")
    machine = ", ".join(f"{key} {facts[key]}" for key in ("cores", "simd", "backend"))
    try:
        with tempfile.TemporaryDirectory(prefix="splatproof-") as folder:
            found = check.measure(reduced, Path(folder))
    except SplatproofError as error:
        return Checked(
            check=name, values=(), unit=check.unit, compared="", machine=machine,
            reduced=reduced, error=" ".join(str(error).split()),
        )  # fmt: skip
    return Checked(
        check=name, values=tuple(float(f"{value:.6g}") for value in found.values), unit=check.unit,
        compared=found.compared, machine=machine, reduced=reduced,
    )  # fmt: skip
