"""Rising difficulties of relocation, of evidence from several views and of the spread of opacity gradients."""

import torch
from torch import Tensor

from splatproof.reference.density import multi_view_error, opacity_spread, relocation
from splatproof.suites.hard_cases.case import joined
from splatproof.suites.hard_cases.rising import Rising, normal, tenth, uniform

COPIES = torch.tensor([1, 2, 3, 7, 20, 50, 51, 52, 1000])
"""Stacks of one, of few, of as many as are told apart, and of more."""


def _stacked(rung: float, opacities: Tensor, scales: Tensor) -> Tensor:
    """Stacks of opacities that 1 / rung is missing from 1 of, and of such a fraction."""
    found = [
        relocation.stacked(o, scales, COPIES) for o in (1 - opacities / rung, opacities / rung)
    ]
    return joined(*(part for pair in found for part in pair))


def _nudged(rung: float, half: Tensor, opacities: Tensor, draws: Tensor) -> Tensor:
    """Noise of Gaussians `rung` times as large, in their size."""
    large = rung * half
    return relocation.nudges(large @ large.mT, opacities, draws) / rung**2


def _marked(rung: float, image: Tensor, truth: Tensor, weights: Tensor) -> Tensor:
    """Evidence by errors that are `rung` times as small."""
    marks = multi_view_error.marked(truth + (image - truth) / rung, truth, 0.3)
    found = multi_view_error.evidence(weights, marks.flatten())[None]
    return joined(
        multi_view_error.importance(found), multi_view_error.blame(found, found.new_ones(1))
    )


def _spread(rung: float, gradients: Tensor, drawn: Tensor) -> Tensor:
    """Gradients that differ by a rung-th of their mean, times the rung: their variance stays as it is."""
    shown = drawn > 0.3
    agreed = opacity_spread.tallied((1 + gradients / rung).where(shown, 0), shown)
    disputed = opacity_spread.tallied(rung * gradients.where(shown, 0), shown)
    return joined(opacity_spread.spread(agreed), opacity_spread.spread(disputed) / rung**2)


CASES = (
    Rising(component="relocation", name="1 / what is missing from an opacity of 1", run=_stacked,
           inputs=lambda h: (0.1 + 0.8 * uniform(9), 0.1 + uniform(9, 3)), rungs=(1.0, 1e2, 1e4), more=tenth,
           reason="1 - 1 / h is rounded to 6e-8, which h times as much of 1 / h is; scales and opacities of a "
           "stack follow from it"),
    Rising(component="relocation", name="times as large", run=_nudged,
           inputs=lambda h: (normal(9, 3, 3), 0.1 * uniform(9), normal(9, 3, seed=1))),
    Rising(component="view errors", name="times as small an error", run=_marked, rungs=(1.0, 1e1, 1e2),
           inputs=lambda h: (uniform(6, 6, 3), uniform(6, 6, 3, seed=1), uniform(36, 5))),
    Rising(component="opacity spread", name="times as alike, and as large", run=_spread, rungs=(1.0, 1e2, 1e4),
           inputs=lambda h: (normal(40, 7), uniform(40, 7))),
)  # fmt: skip
