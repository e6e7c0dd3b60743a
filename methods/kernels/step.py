"""One native training step but for the optimiser: a view's loss and the gradients of all parameters.

`ViewGradients().of(...)` renders the trained tensors themselves (logarithms of scales, opacity logits,
quaternions of any length, SH in two tensors), so no tensor is made that only autograd would need. It agrees
with rasterizer.rasterize, loss.photometric and autograd up to rounding.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.rasterizer import DEGREES, check_background, native_camera, plain
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera

SHAPES = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (),
          "sh_dc": (1, 3)}  # fmt: skip
"""Shape of one row of each trained tensor; sh_rest has (k - 1, 3)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """What one view says about the parameters."""

    loss: float
    """Photometric loss of the view."""
    gradients: dict[str, Tensor]
    """Gradient of the loss by each parameter; without `sh_rest` where degree 0 is drawn."""
    screen: Float[Tensor, "n 2"]
    """Sum over pixels of d loss / d (2D mean)."""
    absolute: Float[Tensor, "n 2"] | None
    """Sum over pixels of |d loss / d (2D mean)|; None where it was not asked for."""
    radii: Float[Tensor, " n"]
    """Longer half-extent of each Gaussian in pixels; 0 where it is not seen."""


class ViewGradients:
    """Computes steps into memory of its own, which the next step uses again."""

    def __init__(self) -> None:
        """Own nothing yet."""
        self._memory: dict[str, Tensor] = {}

    def of(
        self,
        camera: Camera,
        parameters: Mapping[str, Tensor],
        truth: Float[Tensor, "h w 3"],
        *,
        degree: int,
        background: Float[Tensor, "3"] | None = None,
        mask: Bool[Tensor, "h w"] | None = None,
        dssim: float = 0.2,
        mode: Mode = "classic",
        absolute: bool = False,
    ) -> Step:
        """Loss of rendering one view, L = (1 - l) L1 + l (1 - SSIM), and dL / d parameters.

        Args:
            camera: The pinhole camera of the view.
            parameters: Tensors means, quaternions (any length), log_scales, opacity_logits, sh_dc
                and sh_rest.
            truth: The photo, in [0, 1].
            degree: Highest SH degree that is drawn; the coefficients above get zero gradient.
            background: Colour behind everything; None is black.
            mask: Pixels that count; None: all.
            dssim: Weight l of 1 - SSIM, in [0, 1].
            mode: How the Gaussians are rasterized, as in rasterize.
            absolute: Whether the absolute gradients by the 2D means are wanted too.

        Returns: The step, valid until the next call. Where the loss is not finite, its tensors are not
            written.

        Raises: ValueError if a tensor is missing, has another shape, is not contiguous float32 on the
            CPU, or the photo is not of the camera's size.

        Source: Kerbl et al. 2023, "3D Gaussian Splatting", Alg. 1; gradients without a graph: ours.
        """
        check(parameters, degree, mode)
        check_background(background, 3)
        size = (camera.height, camera.width)
        if truth.shape != (*size, 3) or truth.dtype != torch.float32:
            raise ValueError(
                f"truth is {truth.dtype} {tuple(truth.shape)}, expected torch.float32 {(*size, 3)}"
            )
        if mask is not None and (mask.shape != size or mask.dtype != torch.bool):
            raise ValueError(
                f"mask is {mask.dtype} {tuple(mask.shape)}, expected torch.bool {size}"
            )
        values = {name: value.detach() for name, value in parameters.items()}
        new = {name: self._like(name, value) for name, value in values.items()}
        n = len(values["means"])
        screen, radii = self._take("screen", (n, 2)), self._take("radii", (n,))
        moduli = self._take("absolute", (n, 2)) if absolute else None
        model = _ext.Model(
            values["means"], values["quaternions"], values["log_scales"], values["opacity_logits"], None,
            values["sh_dc"], (degree + 1) ** 2, True, mode == "antialiased", values["sh_rest"],
        )  # fmt: skip
        if degree == 0:
            del new["sh_rest"]
        use_threads()
        loss = _ext.step(
            model, *native_camera(camera), plain(background), truth.contiguous(),
            None if mask is None else mask.contiguous(), dssim, new["means"], new["quaternions"],
            new["log_scales"], new["opacity_logits"], new["sh_dc"], new.get("sh_rest"), screen, moduli, radii,
        )  # fmt: skip
        return Step(loss=loss, gradients=new, screen=screen, absolute=moduli, radii=radii)

    def _like(self, name: str, value: Tensor) -> Tensor:
        return self._take(f"by {name}", tuple(value.shape))

    def _take(self, name: str, shape: tuple[int, ...]) -> Tensor:
        """Memory of that name, uninitialised."""
        held = self._memory.get(name)
        if held is None or held.shape != shape:
            self._memory[name] = torch.empty(shape)
        return self._memory[name]


def check(parameters: Mapping[str, Tensor], degree: int, mode: Mode) -> None:
    """Refuse parameters that the kernels cannot read.

    Args:
        parameters: Tensors of SHAPES and sh_rest, contiguous float32 on the CPU; no others.
        degree: SH degree that is drawn, 0 to what sh_rest holds.
        mode: "classic" or "antialiased".

    Raises: ValueError, naming the tensor, what was found and what was expected.
    """
    missing = sorted({*SHAPES, "sh_rest"} ^ parameters.keys())
    if missing:
        raise ValueError(f"parameters: {', '.join(missing)} missing or unknown")
    n, rest = len(parameters["means"]), parameters["sh_rest"]
    stored = 1 + (rest.shape[1] if rest.ndim == 3 else 0)
    if stored not in DEGREES or not 1 <= (degree + 1) ** 2 <= stored or degree < 0:
        raise ValueError(
            f"sh_rest has shape {tuple(rest.shape)} at degree {degree}, expected (n, k - 1, 3), k in "
            f"{DEGREES} and at least (degree + 1)^2"
        )
    shapes = {name: (n, *row) for name, row in SHAPES.items()} | {"sh_rest": (n, stored - 1, 3)}
    for name, shape in shapes.items():
        tensor = parameters[name]
        good = tensor.dtype == torch.float32 and tensor.is_contiguous()
        if not good or tensor.device.type != "cpu" or tensor.shape != shape:
            raise ValueError(
                f"{name} is {tensor.dtype} {tuple(tensor.shape)} on {tensor.device}, expected contiguous "
                f"torch.float32 {shape} on the CPU"
            )
    if mode not in ("classic", "antialiased"):
        raise ValueError(f"mode is {mode!r}, expected 'classic' or 'antialiased'")


def observe(
    screen: Float[Tensor, "n 2"],
    radii: Float[Tensor, " n"],
    camera: Camera,
    gradient_sum: Float[Tensor, " n"],
    seen: Float[Tensor, " n"],
) -> None:
    """Add one view: gradient_sum += |(w / 2, h / 2) * screen| and seen += 1 where radii > 0, in place.

    Args:
        screen: Gradient of the loss by the 2D means, per pixel.
        radii: Half-extent of each Gaussian in pixels; 0 where it was not seen.
        camera: Camera of that view; its size w, h turns pixels into units of half the image.
        gradient_sum: Sum of norms over the views so far, changed in place.
        seen: Number of views so far that saw each Gaussian, changed in place.

    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 5.2.
    """
    use_threads()
    _ext.observe(
        screen.contiguous(),
        radii.contiguous(),
        camera.width / 2,
        camera.height / 2,
        gradient_sum,
        seen,
    )
