"""`bench study stability`: every hard case through every implementation, its error and its budget."""

import time
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from splatproof.base.errors import SplatproofError
from splatproof.reference.checks.agreement import compare_gradients
from splatproof.suites.hard_cases import (
    blocks,
    coders,
    components,
    gaussians,
    images,
    rising_blocks,
    rising_density,
    rising_metrics,
    rising_views,
    steps,
)  # fmt: skip
from splatproof.suites.hard_cases.case import HardCase
from splatproof.suites.hard_cases.rising import Rising
from splatproof.suites.studies import ladders

CASES: tuple[HardCase, ...] = (*components.CASES, *blocks.CASES, *coders.CASES, *images.CASES)
"""One difficult input each."""
RISING: tuple[Rising, ...] = (
    *rising_blocks.CASES,
    *rising_views.CASES,
    *rising_density.CASES,
    *rising_metrics.CASES,
)
"""A difficulty each that is raised rung by rung."""


def rows(*, quick: bool) -> Iterator[dict[str, Any]]:
    """A row a case and implementation.

    Keys: component, case, implementation, expect, finite, max_abs_error, grad_rel_l2,
    discontinuity_pixels, budget, ms, ok, note; those of a ladder also have ladder and hardness.

    Args:
        quick: Leave out the cases of more than a thousand Gaussians, most rungs of ladders, and short
            trainings of methods.
    """
    for case in CASES:
        yield judge(case)
    for case in RISING:
        for rung in case.rungs:
            yield climbed(case, rung)
    yield from gaussians.rows(quick=quick)
    yield from ladders.rows(quick=quick)
    yield from steps.rows(quick=quick)


def climbed(case: Rising, rung: float) -> dict[str, Any]:
    """The row of one rung of a difficulty that rises.

    Args:
        case: The difficulty.
        rung: How difficult.
    """
    row = judge(case.at(rung)) | {"ladder": case.name, "hardness": rung}
    return row | {"note": case.reason if case.more(rung) > 1 else ""}


def judge(case: HardCase) -> dict[str, Any]:
    """Run one case of a component in float64 and float32 and hold the two against each other."""
    row: dict[str, Any] = {
        "component": case.component, "case": case.name, "implementation": "reference float32",
        "expect": case.expect, "budget": case.budget, "discontinuity_pixels": 0,
    }  # fmt: skip
    if case.expect == "refused":
        return row | refusal(case)
    truth, true_gradients, _ = evaluate(case, torch.float64)
    value, gradients, ms = evaluate(case, torch.float32)
    finite = bool(torch.isfinite(value).all() and torch.isfinite(truth).all())
    finite &= all(bool(torch.isfinite(g).all()) for g in (*gradients, *true_gradients))
    scale = max(1.0, float(truth.abs().max())) if truth.numel() else 1.0
    error = float((value.double() - truth).abs().max()) / scale if truth.numel() else 0.0
    largest = max((float(g.norm()) for g in true_gradients), default=0.0)
    off = max(
        (compare_gradients(a, b, floor=1e-6 * max(1.0, largest)).relative_l2
         for a, b in zip(gradients, true_gradients, strict=True)), default=0.0,
    )  # fmt: skip
    return row | {
        "finite": finite, "max_abs_error": error, "grad_rel_l2": off, "ms": ms,
        "ok": finite and error <= case.budget and off <= 1e-3, "note": "",
    }  # fmt: skip


def refusal(case: HardCase) -> dict[str, Any]:
    """What a case that must be refused says; anything else is a failure."""
    start = time.perf_counter()
    try:
        case.run(*case.inputs())
    except (ValueError, SplatproofError) as error:
        note, ok = str(error).splitlines()[0], True
    else:
        note, ok = "was not refused", False
    ms = 1e3 * (time.perf_counter() - start)
    return {
        "finite": ok,
        "max_abs_error": 0.0,
        "grad_rel_l2": 0.0,
        "ms": ms,
        "ok": ok,
        "note": note,
    }


def evaluate(case: HardCase, dtype: torch.dtype) -> tuple[Tensor, list[Tensor], float]:
    """Outputs, gradients by the inputs (none unless differentiable) and milliseconds.

    Args:
        case: Case that is run.
        dtype: Precision that its inputs are given in.
    """
    inputs = [value.to(dtype).requires_grad_(case.differentiable) for value in case.inputs()]
    start = time.perf_counter()
    value = case.run(*inputs)
    ms = 1e3 * (time.perf_counter() - start)
    if not case.differentiable:
        return value.detach(), [], ms
    generator = torch.Generator().manual_seed(0)
    cotangent = torch.randn(value.shape, generator=generator, dtype=torch.float64).to(dtype)
    if value.requires_grad:
        value.backward(cotangent)
    gradients = [torch.zeros_like(x) if x.grad is None else x.grad for x in inputs]
    return value.detach(), gradients, ms
