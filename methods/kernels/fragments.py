"""What single fragments of a picture say of the Gaussians: the native twin of `opacity_spread.tallied`."""

from typing import Any

from jaxtyping import Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.rasterizer import is_drawn, plain
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.types.render import RenderOutput


def tallied(drawn: RenderOutput, by_colour: Float[Tensor, "h w 3"]) -> Float[Tensor, "n 3"]:
    """Sum of g, sum of g^2 and number of the fragments of each Gaussian of a picture, g = dL / d ln(alpha).

    One backward pass up to the sums over pixels; nothing is listed by pixel.

    Args:
        drawn: What `rasterizer.rasterize` returned, while it has a gradient.
        by_colour: dL / d colour of each pixel, float32.

    Raises: ValueError if `drawn` has no gradient, or `by_colour` is not of its size.

    Source: ours; `splatproof.reference.density.opacity_spread` has what it is good for.
    """
    if not is_drawn(drawn):
        raise ValueError("drawn is no picture of this rasterizer that has a gradient")
    if by_colour.shape != drawn.colour.shape or by_colour.dtype != drawn.colour.dtype:
        raise ValueError(
            f"by_colour is {by_colour.dtype} {tuple(by_colour.shape)}, expected {drawn.colour.dtype} "
            f"{tuple(drawn.colour.shape)}"
        )
    node: Any = drawn.colour.grad_fn
    background, _, alpha, depth, *_ = node.saved_tensors
    tallies = alpha.new_empty(len(drawn.radii), 3)
    use_threads()
    _ext.render_backward(
        node.state, node.model, background, alpha, depth, None, plain(by_colour), None, None, None, None,
        None, None, None, None, None, None, None, None, tallies,
    )  # fmt: skip
    return tallies
