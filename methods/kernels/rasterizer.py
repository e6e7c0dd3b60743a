"""The native rasterizer: twin of splatproof.reference.rasterizer.rasterize on the CPU, in float32.

It differs from the reference by rounding only, except on pixels at a discontinuity of the image's
definition (splatproof.reference.checks.discontinuities). Two additions: a Gaussian with a NaN or infinite parameter is
not drawn and gets zero gradient, and outputs that nobody differentiates cost nothing in the backward
pass.
"""

import math
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput

MAX_CHANNELS = 32
"""Most colour channels in one pass."""
DEGREES = (1, 4, 9, 16)
"""Numbers of spherical-harmonic coefficients of degree 0 to 3."""
T_MIN = 1e-4
"""The definition itself stops where less light is left."""


@dataclass(frozen=True, kw_only=True)
class Shortcuts:
    """What a picture leaves out to be drawn sooner; the defaults leave out nothing.

    Raises: ValueError for a `stop` outside [1e-4, 1) or `sigmas` that are not positive.
    """

    stop: float = T_MIN
    """A block of 4 x 4 pixels ends where every pixel has less light than this left."""
    sigmas: float = math.inf
    """Blocks of 4 x 4 pixels wholly farther than so many standard deviations are not drawn."""

    def __post_init__(self) -> None:
        """Refuse what means nothing."""
        if not T_MIN <= self.stop < 1:
            raise ValueError(f"stop is {self.stop}, expected 1e-4 or more and below 1")
        if not self.sigmas > 0:
            raise ValueError(f"sigmas is {self.sigmas}, expected above 0")


EXACT = Shortcuts()
"""None at all."""


def rasterize(
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    colours: Float[Tensor, "u c"] | None = None,
    sh: Float[Tensor, "m k 3"] | None = None,
    background: Float[Tensor, " c"] | None = None,
    mode: Mode = "classic",
    distance: bool = False,
    median: bool = False,
    contributors: int = 0,
    probe: ScreenProbe | None = None,
) -> RenderOutput:
    """Render Gaussians: C = sum_i c_i a_i prod_{j<i} (1 - a_j) + T bg, sorted by camera-space z.

    Args:
        camera: The pinhole camera; Gaussians at z <= camera.near are not drawn.
        means: World positions in scene units.
        quaternions: Rotations (w, x, y, z), normalised here; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].
        colours: Colour of each Gaussian, 1 to 32 channels; give this or `sh`, or both: harmonics of
            the first Gaussians, and colours of 3 channels of all others.
        sh: Spherical-harmonic coefficients, k in {1, 4, 9, 16}, evaluated along mean - centre.
        background: Colour behind everything; None is black.
        mode: "antialiased" scales opacity by sqrt(det(Sigma2 - 0.3 I) / det(Sigma2)).
        distance: Whether the expected distance to the camera centre is returned too.
        median: Whether the median depth is returned too.
        contributors: How many of the strongest Gaussians of each pixel are returned, >= 0.
        probe: Where gradients by the 2D means are left, for density control; None: nowhere.

    Returns: The image, in float32.

    Raises: ValueError unless `colours`, `sh` or both are given, everything is float32 on the CPU and
        the shapes fit together, with at most 32 channels.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 4 to 6; Cholesky form, tiles of exact
        ellipses and the division-free backward pass: ours.
    """
    model = (means, quaternions, scales, opacities, colours, sh)
    check_model(*model)
    if mode not in ("classic", "antialiased"):
        raise ValueError(f"mode is {mode!r}, expected 'classic' or 'antialiased'")
    if contributors < 0:
        raise ValueError(f"contributors is {contributors}, expected at least 0")
    channels = 3 if colours is None else colours.shape[1]
    check_background(background, channels)
    probes = (None, None) if probe is None else (probe.signed, probe.absolute)
    asked = (mode == "antialiased", EXACT, distance, median, contributors)
    images = _Rasterize.apply(camera, asked, *model, background, *probes)
    return RenderOutput(**dict(zip(_NAMES, images, strict=True)))


def rasterize_roughly(
    shortcuts: Shortcuts,
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    sh: Float[Tensor, "n k 3"],
    background: Float[Tensor, " 3"] | None = None,
    mode: Mode = "classic",
) -> RenderOutput:
    """Render as rasterize does, but leave out what the shortcuts name.

    A colour is off by at most T + sum_i a_i times the largest difference between two colours of the pixel,
    background among them: T < `stop` is the light that is left where its block ends, and a_i <=
    o_i exp(-`sigmas`^2 / 2) are the alphas that are left out. Where the pixel is full, 0.01 more: the
    definition drops the Gaussian that would leave less than 1e-4, which may become another one.

    Args:
        shortcuts: What is left out.
        camera: As rasterize takes it, like all that follow.
        means: World positions in scene units.
        quaternions: Rotations (w, x, y, z), normalised here.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].
        sh: Spherical-harmonic coefficients, k in {1, 4, 9, 16}.
        background: Colour behind everything; None is black.
        mode: "classic" or "antialiased".

    Returns: The image, in float32, with gradients of what was drawn.

    Raises: ValueError as rasterize does.

    Source: ours; 3 standard deviations are the extent of Kerbl et al. 2023, "3D Gaussian Splatting",
        Sec. 6.
    """
    model = (means, quaternions, scales, opacities, None, sh)
    check_model(*model)
    check_background(background, 3)
    asked = (mode == "antialiased", shortcuts, False, False, 0)
    images = _Rasterize.apply(camera, asked, *model, background, None, None)
    return RenderOutput(**dict(zip(_NAMES, images, strict=True)))


def rasterize_again(
    drawn: RenderOutput,
    camera: Camera,
    means: Float[Tensor, "n 3"],
    quaternions: Float[Tensor, "n 4"],
    scales: Float[Tensor, "n 3"],
    opacities: Float[Tensor, " n"],
    *,
    colours: Float[Tensor, "n c"],
) -> RenderOutput:
    """The picture that `rasterize` makes of other colours, where all else was drawn before.

    Who covers which pixel by how much is read from the first picture, so this one takes about half the time. Gradients
    are those of `rasterize`, to the bit.

    Args:
        drawn: What `rasterize` returned for these Gaussians, while it has a gradient.
        camera: The camera that it was drawn from.
        means: The tensor that was drawn, or one that shares its numbers, as the three that follow: a detached one
            gets no gradient.
        quaternions: Rotations (w, x, y, z).
        scales: Standard deviations in scene units.
        opacities: Opacity of each Gaussian, in [0, 1].
        colours: Colour of each Gaussian, 1 to 32 channels.

    Returns: The colours; alpha, depth and radii are those of `drawn` without gradient.

    Raises: ValueError if `drawn` has no gradient, the camera or one of the tensors is not what was drawn, or the
        colours do not fit them.

    Source: ours.
    """
    if not is_drawn(drawn):
        raise ValueError("drawn is no picture of this rasterizer that has a gradient")
    node: Any = drawn.colour.grad_fn  # the context of its forward pass
    if camera is not node.camera:
        raise ValueError("camera is not the one that was drawn from")
    check_model(means, quaternions, scales, opacities, colours, None)
    shape = means, quaternions, scales, opacities
    for name, tensor, before in zip(_SHAPE, shape, node.drawn, strict=True):
        if tensor.data_ptr() != before.data_ptr() or tensor.shape != before.shape:
            raise ValueError(f"{name} is not the tensor that was drawn")
    alpha, depth = drawn.alpha.detach(), drawn.depth.detach()
    if not len(means):  # the kernels keep no state of nothing
        nothing = alpha.new_zeros(*alpha.shape, colours.shape[1])
        return RenderOutput(colour=nothing, alpha=alpha, depth=depth, radii=drawn.radii)
    image = _Again.apply(node, alpha, depth, *shape, colours)
    return RenderOutput(colour=image, alpha=alpha, depth=depth, radii=drawn.radii)


def is_drawn(output: RenderOutput) -> bool:
    """Whether a picture is one that `rasterize` made and that still has a gradient."""
    return getattr(output.colour.grad_fn, "_forward_cls", None) is _Rasterize


def check_model(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor | None,
    sh: Tensor | None,
) -> None:
    """Refuse Gaussians that the kernels cannot read: they take float32 on the CPU.

    Args:
        means: Positions, n x 3.
        quaternions: Rotations, n x 4.
        scales: Standard deviations, n x 3.
        opacities: Opacities, n.
        colours: Colours, n x c with c from 1 to 32, or of the last Gaussians n - m x 3; None where
            all have harmonics.
        sh: Spherical-harmonic coefficients, n x k x 3 with k in DEGREES, or of the first Gaussians
            m x k x 3; None where all have colours.

    Raises: ValueError, naming the argument, what was found and what was expected.
    """
    if colours is None and sh is None:
        raise ValueError("give colours, sh or both")
    n = len(means) if means.ndim else 0
    lit = n if sh is None or colours is None or not sh.ndim else len(sh)
    expected: dict[str, tuple[Tensor, tuple[int, ...]]] = {
        "means": (means, (n, 3)),
        "quaternions": (quaternions, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
    }
    if colours is not None:
        channels = 3 if sh is not None else colours.shape[-1] if colours.ndim else 0
        expected["colours"] = (colours, (n if sh is None else n - lit, channels))
        if not 1 <= channels <= MAX_CHANNELS:
            raise ValueError(f"colours has {channels} channels, expected 1 to {MAX_CHANNELS}")
    if sh is not None:
        count = sh.shape[1] if sh.ndim == 3 else 0
        expected["sh"] = (sh, (lit, count, 3))
        if count not in DEGREES:
            raise ValueError(
                f"sh has shape {tuple(sh.shape)}, expected ({n}, k, 3), k in {DEGREES}"
            )
    for name, (tensor, shape) in expected.items():
        if tensor.shape != shape:
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}, expected {shape}")
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
            raise ValueError(
                f"{name} is {tensor.dtype} on {tensor.device}, expected torch.float32 on the CPU"
            )


def check_background(background: Tensor | None, channels: int) -> None:
    """Refuse a background that the kernels cannot read.

    Args:
        background: One number a channel, float32 on the CPU; None, which is black, is fine.
        channels: Number of colour channels of the image.

    Raises: ValueError, naming what was found and what was expected.
    """
    if background is None:
        return
    if background.shape != (channels,):
        raise ValueError(f"background has shape {tuple(background.shape)}, expected ({channels},)")
    if background.dtype != torch.float32 or background.device.type != "cpu":
        raise ValueError(
            f"background is {background.dtype} on {background.device}, expected torch.float32 on the CPU"
        )


_SHAPE = ("means", "quaternions", "scales", "opacities")
_NAMES = (
    "colour", "alpha", "depth", "radii", "distance", "median_depth", "contributor_ids",
    "contributor_weights",
)  # fmt: skip


def pairs_listed() -> int:
    """Pairs of Gaussian and tile of all pictures that this process has drawn so far.

    A Gaussian is paired with each 16 x 16 tile whose pixels its support meets. The number depends
    on the model and the cameras alone, so it says how much work there was where seconds cannot.
    """
    return _ext.pairs_listed()


def plain(tensor: Tensor | None) -> Tensor | None:
    """The values alone, contiguous, as the kernels read them."""
    return None if tensor is None else tensor.detach().contiguous()


def native_camera(camera: Camera) -> tuple[Tensor, Tensor, int, int, float]:
    """The camera as the kernels take it: K and pose in float64, size and near plane."""
    return (
        camera.K.to(dtype=torch.float64, device="cpu").contiguous(),
        camera.world_to_camera.to(dtype=torch.float64, device="cpu").contiguous(),
        camera.width, camera.height, camera.near,
    )  # fmt: skip


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, camera: Camera, asked: tuple, *tensors: Tensor | None):
        antialiased, shortcuts, distance, median, contributors = asked
        means, quaternions, scales, opacities, colours, sh, background, _, _ = map(plain, tensors)
        assert means is not None
        used = 0 if sh is None else sh.shape[1]
        model = _ext.Model(
            means, quaternions, scales, opacities, colours, sh, used, False, antialiased,
            stop=shortcuts.stop, sigmas=shortcuts.sigmas,
        )  # fmt: skip
        height, width = camera.height, camera.width
        image = lambda *last: means.new_empty(height, width, *last)
        colour = image(3 if colours is None else colours.shape[1])
        alpha, depth, radii = image(), image(), means.new_empty(len(means))
        left = image() if ctx.needs_input_grad[8] else None
        far, middle = image() if distance else None, image() if median else None
        ids = torch.empty(height, width, contributors, dtype=torch.int64) if contributors else None
        weights = image(contributors) if contributors else None
        use_threads()
        state = _ext.render(
            model, *native_camera(camera), background, colour, alpha, depth, radii, left, far,
            middle, ids, weights,
        )  # fmt: skip
        ctx.state, ctx.model, ctx.camera, ctx.antialiased = state, model, camera, antialiased
        ctx.drawn = (means, quaternions, scales, opacities)
        ctx.shapes = [None if t is None else t.shape for t in tensors]
        ctx.save_for_backward(background, left, alpha, depth, far, *tensors[:6])
        ctx.mark_non_differentiable(*(t for t in (radii, ids, weights) if t is not None))
        ctx.set_materialize_grads(False)
        return colour, alpha, depth, radii, far, middle, ids, weights

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor | None):
        background, left, alpha, depth, far, *_ = ctx.saved_tensors
        colour, by_alpha, by_depth, _, by_far, by_median, _, _ = map(plain, grad_outputs)
        needed = list(ctx.needs_input_grad[2:])
        new = [
            alpha.new_empty(shape) if need else None
            for shape, need in zip(ctx.shapes, needed, strict=True)
        ]
        behind = None
        if needed[6] and colour is not None:
            behind = (colour * left[..., None]).sum(dim=(0, 1))
        use_threads()
        _ext.render_backward(
            ctx.state, ctx.model, background, alpha, depth, far, colour, by_alpha, by_depth, by_far,
            by_median, *new[:6], *new[7:],
        )  # fmt: skip
        return None, None, *new[:6], behind, *new[7:]


class _Again(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, node: Any, alpha: Tensor, depth: Tensor, *tensors: Tensor):
        means, quaternions, scales, opacities, colours = (t.detach().contiguous() for t in tensors)
        model = _ext.Model(
            means, quaternions, scales, opacities, colours, None, 0, False, node.antialiased,
        )  # fmt: skip
        image = means.new_empty(*alpha.shape, colours.shape[1])
        use_threads()
        ctx.state, ctx.model = _ext.render_again(node.state, model, None, image), model
        ctx.shapes = [t.shape for t in tensors]
        ctx.save_for_backward(alpha, depth)
        return image

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor):
        alpha, depth = ctx.saved_tensors
        new = [
            alpha.new_empty(shape) if need else None
            for shape, need in zip(ctx.shapes, ctx.needs_input_grad[3:], strict=True)
        ]
        use_threads()
        _ext.render_backward(
            ctx.state, ctx.model, None, alpha, depth, None, plain(grad_outputs[0]), None, None,
            None, None, *new, sh=None, screen=None, screen_absolute=None,
        )  # fmt: skip
        return None, None, None, *new
