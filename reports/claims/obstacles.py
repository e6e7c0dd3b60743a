"""Why a claim cannot be tested here, as far as methods and suites themselves say it."""

from collections.abc import Mapping
from dataclasses import dataclass

from splatproof.reports.claims.claim import Claim

Place = tuple[str, str, str]
"""Scene, protocol and row of a case."""


@dataclass(frozen=True, kw_only=True)
class Known:
    """What this installation has."""

    methods: frozenset[str]
    """Names of the methods."""
    suites: Mapping[str, frozenset[Place]]
    """The cases of each suite."""


def obstacle(claim: Claim, known: Known) -> str:
    """What is not there and would be needed to run a claim's rows; empty: nothing.

    Args:
        claim: Names a suite and rows.
        known: What there is.
    """
    absent = dict.fromkeys(
        method for method in map(method_of, claim.rows) if method not in known.methods
    )
    faults = [f"method {name} is not built" for name in absent]
    if claim.suite not in known.suites:
        return "; ".join([*faults, f"suite {claim.suite} does not exist"])
    if faults:
        return "; ".join(faults)
    cases = known.suites[claim.suite]
    for row in dict.fromkeys(claim.rows):
        own = {(scene, protocol) for scene, protocol, name in cases if name == row}
        if not own:
            return f"suite {claim.suite} has no row {row}"
        protocols = {protocol for _, protocol in own}
        if claim.protocol and claim.protocol not in protocols:
            return f"suite {claim.suite} has no {row} under protocol {claim.protocol}"
        for scene in claim.scenes:
            if scene not in {scene for scene, _ in own}:
                return f"suite {claim.suite} has no {row} on {scene}"
    return ""


def method_of(row: str) -> str:
    """The method of a row: pvg of pvg@no-sky~depth-oracle."""
    return row.partition("~")[0].partition("@")[0]
