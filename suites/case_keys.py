"""What makes a result count as a case's: one hash of all that its numbers depend on."""

import dataclasses
import hashlib
import json

from splatproof.reference.types.protocol import key_rules
from splatproof.reference.types.result import NO_PRIOR, prior_name
from splatproof.suites.suite_files import Case


def case_key(case: Case, backend: str) -> str:
    """Hash of everything that a case's numbers depend on, apart from data, code and machine.

    Args:
        case: What is run.
        backend: Name of the rasterizer that runs it.
    Returns: SHA-256 in hexadecimal.
    """
    return key_of(
        scene=case.scene_name,
        method=case.method,
        settings=dataclasses.asdict(case.settings),
        seed=case.seed,
        protocol=key_rules(dataclasses.asdict(case.protocol)),
        pose_noise=case.pose_noise,
        backend=backend,
        **prior_part(prior_name(case.depth_prior)),
        **({"marks": case.marks} if case.marks else {}),
    )


def prior_part(name: str) -> dict[str, str]:
    """What a depth prior adds to a case's key: nothing where there is none, as before there were any.

    The hash of a prior's weights is part of the case's data, see `splatproof.suites.scene_data`.

    Args:
        name: The prior's short name.
    """
    return {} if name == NO_PRIOR else {"depth_prior": name}


def key_of(**parts: object) -> str:
    """SHA-256 of the parts as canonical JSON (sorted keys; tuples and lists are the same).

    Args:
        parts: Plain data by name.
    Returns: SHA-256 in hexadecimal.
    """
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()
