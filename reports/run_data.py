"""A result as MLflow sees it: flat params, metrics, step curves and tags."""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping

from splatproof.reference.types.result import Result

NOT_IN_A_NAME = re.compile(r"[^\w\-. :/]")
"""What MLflow refuses in the names of params and metrics."""


def case_name(result: Result) -> str:
    """The case as its folder names it: suite/scene/method/protocol/seed0."""
    parts = (result.suite, result.scene, result.row, result.protocol, f"seed{result.seed}")
    return "/".join(parts)


def case_key(result: Result) -> str:
    """Hash of what makes a case: its name, the method's settings and the protocol's rules."""
    return digest((case_name(result), result.settings, result.protocol_rules))


def digest(value: object) -> str:
    """Short hash of plain data that does not depend on the order of keys."""
    text = json.dumps(value, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def params(result: Result) -> dict[str, str]:
    """Scene, method, seed, protocol and every setting and rule by its dotted name."""
    named = {
        "suite": result.suite,
        "scene": result.scene,
        "method": result.method,
        "variant": result.variant,
        "row": result.row,
        "pose_noise": result.pose_noise,
        "depth_prior": result.depth_prior,
        "seed": result.seed,
        "protocol": result.protocol,
        "settings": result.settings,
        "protocol_rules": result.protocol_rules,
    }
    return {_name(name): str(value) for name, value in flatten(named)}


def metrics(result: Result) -> dict[str, float]:
    """Scores by their names, cost/NAME for what the case cost, seconds/STAGE and counters/NAME.

    MLflow's pages make a section of what is before a slash, so scores stand alone and first.
    """
    costs = {
        "train_seconds": result.training_seconds,
        "cpu_seconds": result.cpu_seconds,
        "peak_memory_mb": result.peak_memory_mb,
        "primitives": result.primitives,
        "bytes_on_disk": result.bytes_on_disk,
        "render_ms": result.render_ms,
    }
    named = dict(flatten(result.metrics))
    named |= {f"cost/{name}": value for name, value in costs.items()}
    named |= {f"seconds/{stage}": value for stage, value in result.stages.items()}
    named |= {f"counters/{name}": value for name, value in result.counters.items()}
    return {_name(name): float(str(value)) for name, value in named.items()}


def curves(result: Result) -> list[tuple[str, int, float, float]]:
    """(curve/NAME, step, value, seconds since the fit began) of all that was logged while training.

    Of a record without its clock the seconds are 0.
    """
    known = len(result.curve_seconds) == len(result.curve)
    clock = result.curve_seconds if known else (0.0,) * len(result.curve)
    return [
        (_name(f"curve/{name}"), step, float(str(value)), seconds)
        for (step, values), seconds in zip(result.curve, clock, strict=True)
        for name, value in values.items()
    ]


def tags(result: Result) -> dict[str, str]:
    """Versions, commit and machine, facts of the scene, hashes, and the error of a failed case."""
    named = {
        "split_sha256": result.split_sha256,
        "model_sha256": result.model_sha256,
        "environment": result.environment,
        "scene_facts": result.scene_facts,
        "error": result.error,
    }
    return {_name(name): str(value) for name, value in flatten(named)}


def flatten(values: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Nested mappings as (dotted name, value).

    Args:
        values: Mappings in mappings.
        prefix: What every name starts with.
    """
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from flatten(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _name(name: str) -> str:
    return NOT_IN_A_NAME.sub("_", name)
