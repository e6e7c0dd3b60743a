"""How far each twin of a component is from its float64 reference."""

import math
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from splatproof.reference.checks.agreement import compare_gradients, largest_error
from splatproof.suites.twins.twin import Component, Problem, Twin, leaves_of, running

Judgement = dict[str, Any]


def judge(component: Component, problem: Problem) -> dict[str, Judgement]:
    """Errors of all twins by name.

    Keys of each: max_abs_error, rms_error and scale (the largest true value, at least 1) of the output, grad_rel_l2 and grad_cosine (the worst
    of the gradients by each leaf; None without a backward pass), discontinuity_pixels, ok. Outputs at a
    discontinuity do not count and pass no gradient; an approximating twin is ok if it is finite.

    Args:
        component: Component whose twins are held against its reference.
        problem: Input that all of them are given.
    """
    if component.reference is None:
        nothing = dict.fromkeys(
            (
                "max_abs_error",
                "scale",
                "rms_error",
                "grad_rel_l2",
                "grad_cosine",
                "discontinuity_pixels",
            )
        )
        return {twin.name: nothing | {"ok": True} for twin in component.twins}
    ignored = problem.discontinuities() if problem.discontinuities else None
    truth, true_gradients = evaluate(component.reference, problem, ignored)
    found = {}
    for twin in component.twins:
        value, gradients = evaluate(twin, problem, ignored)
        found[twin.name] = compare(value, truth, ignored) | agreement(gradients, true_gradients)
        found[twin.name]["ok"] = within(component, twin, found[twin.name])
    return found


def evaluate(
    twin: Twin, problem: Problem, ignored: Bool[Tensor, "..."] | None
) -> tuple[Tensor, dict[str, Tensor]]:
    """Output of the first forward pass, and gradients by the leaves.

    Args:
        twin: Implementation that is run.
        problem: Input that it is given.
        ignored: Outputs that pass no gradient; None: all pass theirs.
    """
    leaves = leaves_of(problem, twin)
    with running(twin):
        value = twin.start(problem, leaves)()
        if problem.cotangent is None:
            return value.detach().cpu(), {}
        cotangent = problem.cotangent.to(value)
        if ignored is not None:
            cotangent = torch.where(ignored[..., None].to(value.device), 0, cotangent)
        value.backward(cotangent)
    gradients = {n: torch.zeros_like(v) if v.grad is None else v.grad for n, v in leaves.items()}
    return value.detach().cpu(), {name: gradient.cpu() for name, gradient in gradients.items()}


def compare(value: Tensor, truth: Tensor, ignored: Bool[Tensor, "..."] | None) -> Judgement:
    """Errors of the output.

    Args:
        value: Output of a twin.
        truth: Output of the reference.
        ignored: Outputs that do not count; None: all count.
    """
    error = (value.double() - truth.double()).abs()
    if ignored is not None:
        error = error[~ignored]
    return {
        "max_abs_error": largest_error(value, truth, ignore=ignored),
        "scale": max(1.0, float(truth.abs().max())) if truth.numel() else 1.0,
        "rms_error": float(error.square().mean().sqrt()) if error.numel() else 0.0,
        "discontinuity_pixels": 0 if ignored is None else int(ignored.sum()),
    }


def agreement(gradients: dict[str, Tensor], truth: dict[str, Tensor]) -> Judgement:
    """The worst relative L2 distance and the worst cosine over the leaves.

    Args:
        gradients: Gradients of a twin by the name of the leaf.
        truth: Gradients of the reference by the same names; empty without a backward pass.
    """
    if not truth:
        return {"grad_rel_l2": None, "grad_cosine": None}
    each = [compare_gradients(gradients[name], truth[name]) for name in truth]
    return {
        "grad_rel_l2": max(a.relative_l2 for a in each),
        "grad_cosine": min(a.cosine for a in each),
    }


def within(component: Component, twin: Twin, found: Judgement) -> bool:
    """Whether a twin keeps its component's budget, or is finite if it approximates.

    Args:
        component: Component with the budget.
        twin: Implementation that was judged.
        found: Errors of the twin, as `compare` and `agreement` give them.
    """
    error = found["max_abs_error"]
    if twin.approximates:  # the cosine is -1 for a gradient that is not finite
        return math.isfinite(error) and (found["grad_cosine"] or 0.0) > -1
    gradient = found["grad_rel_l2"] or 0.0
    return error <= component.max_abs_error and gradient <= component.grad_rel_l2
