"""Appearance codes of models: which one a view has, and the fit of one to a part of an image."""

from collections.abc import Callable, Sequence
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.base.names import did_you_mean
from splatproof.methods.kernels import adam
from splatproof.methods.training.terms import photometric_loss
from splatproof.reference.types.scene import View

RATE, LAST_RATE = 0.05, 0.05 / 64
"""Adam's rate at the start of a fit, and the smallest that is tried."""
PATIENCE, GAIN = 8, 1e-3
"""The rate is halved after so many steps in which the loss fell by less than this share."""
EPSILON = 1e-8
"""Adam's, as its paper has it."""
MOST_STEPS = 300
"""Steps after which a fit ends in any case."""


@runtime_checkable
class HasCode(Protocol):
    """A Model that shows a view in the light of a code: it reads View.appearance (`chosen_code`)."""

    def neutral_code(self, view: View) -> Float[Tensor, " c"]:
        """The code of nobody's light in particular, where every fit of a code starts.

        Args:
            view: What is to be shown; its image is not for looking at.
        """
        ...


def chosen_code(
    view: View,
    photos: Sequence[str],
    codes: Float[Tensor, "n c"],
    neutral: Float[Tensor, " c"],
) -> Float[Tensor, " c"]:
    """The code that a view is shown with, as View.appearance means it.

    None: the view's own where it was trained on, else the neutral one. A name: that of the training
    view. A tensor is the code itself.

    Args:
        view: What is to be shown.
        photos: Names of the training views, in the order of their codes.
        codes: Code of each training view.
        neutral: Code of any other view.

    Raises: UsageError for the name of no training view, or a code of another length.
    """
    asked = view.appearance
    if isinstance(asked, Tensor):
        if asked.shape != neutral.shape:
            raise UsageError(
                f"view {view.name}: its appearance has shape {tuple(asked.shape)}, expected "
                f"{tuple(neutral.shape)}; fit it with this very model"
            )
        return asked.to(neutral)
    name = view.name if asked is None else asked
    if name in photos:
        return codes[photos.index(name)]
    if asked is None:
        return neutral
    raise UsageError(
        f"view {view.name}: appearance {name!r} is not the name of a view that the model was trained "
        f"on{did_you_mean(name, photos)}"
    )


def fit_code(
    show: Callable[[Tensor], Float[Tensor, "h w 3"]],
    start: Float[Tensor, " c"],
    image: Float[Tensor, "h n 3"],
    columns: slice,
    mask: Bool[Tensor, "h n"] | None = None,
) -> Float[Tensor, " c"]:
    """The code with which a model shows some columns of an image best.

    Adam on the photometric loss (0.2 D-SSIM) of these columns alone. Its rate is halved whenever 8
    steps lowered the smallest loss by less than a thousandth; it ends below 1/64 of its first rate,
    or after 300 steps. Nothing is drawn at random.

    Args:
        show: show(code): the whole image, differentiable by the code.
        start: Code of the first step.
        image: The columns that may be looked at, in [0, 1]; the rest of the image is not given.
        columns: Which columns of the whole image they are.
        mask: Which of their pixels count; None: all.

    Returns: The code of the smallest loss seen.

    Source: ours.
    """
    truth, counts = image.to(start), None if mask is None else mask.to(start.device)
    code = start.detach().float().cpu().clone()  # a few numbers, for the update on the CPU
    first, second = torch.zeros_like(code), torch.zeros_like(code)
    best, least, mark, rate = code.clone(), float("inf"), float("inf"), RATE
    for step in range(1, MOST_STEPS + 1):
        with torch.enable_grad():
            asked = code.clone().to(start).requires_grad_()
            loss = photometric_loss(show(asked)[:, columns].contiguous(), truth, mask=counts)
        if float(loss.detach()) < least:
            best, least = code.clone(), float(loss.detach())
        if step % PATIENCE == 0:
            if least > (1 - GAIN) * mark:
                rate /= 2
            mark = least
        if rate < LAST_RATE or not loss.requires_grad:
            break
        (gradient,) = torch.autograd.grad(loss, [asked])
        adam.step(
            [code], [gradient.float().cpu().contiguous()], [first], [second], [rate], step,
            epsilon=EPSILON,
        )  # fmt: skip
    return best.to(start)
