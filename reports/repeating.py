"""The command that repeats a case, from its record alone."""

import shlex

from splatproof.reference.types.result import NO_PRIOR, TRUE_POSES, Result


def command(result: Result) -> str:
    """What a user types to run a case again at its commit.

    A fit's settings that are not the defaults are not in it: the record does not say which are.

    Args:
        result: Any case.
    Returns: `bench run SUITE --only CASE`, or `bench fit METHOD SCENE ...` where no suite ran it.
    """
    if result.suite_scenes:
        label = f"{result.scene}/{result.row}/{result.protocol}/seed{result.seed}"
        return shlex.join(["bench", "run", result.suite, "--only", label])
    words = ["bench", "fit", result.method, result.scene, "--protocol", result.protocol]
    words += ["--seed", str(result.seed)]
    if result.pose_noise != TRUE_POSES:
        words += ["--pose-noise", result.pose_noise]
    if result.depth_prior != NO_PRIOR:
        words += ["--depth-prior", result.depth_prior]
    return shlex.join(words)
