"""Adapter to gsplat's CUDA rasterizer: our signature outside, its `rasterization` inside.

Differences to the contract that gsplat keeps: a stop at T <= 1e-4 instead of T < 1e-4, no gradient
through the alpha cap, opacity compensation of mode "antialiased" with a floor of 0.005.
"""

import importlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.rasterizer import rotation, spherical_harmonics
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput

CAPABILITIES = frozenset({"float32", "probe"})
"""What of the contract this backend offers."""


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
    """Twin of reference.rasterizer.rasterize on a GPU; results come back to the inputs' device.

    Args:
        camera: The pinhole camera; Gaussians at z <= camera.near are not drawn.
        means: World positions in scene units.
        quaternions: Rotations (w, x, y, z), normalised here; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].
        colours: Colour of each Gaussian, any number of channels; give this or `sh`, or both:
            harmonics of the first Gaussians, and colours of 3 channels of all others.
        sh: Spherical-harmonic coefficients, k in {1, 4, 9, 16}, evaluated along mean - centre.
        background: Colour behind everything; None is black.
        mode: How opacities are compensated: "classic" not at all, "antialiased" by gsplat.
        distance: Refused where True.
        median: Refused where True.
        contributors: Refused where not 0.
        probe: Where gradients by the 2D means are left, for density control; None: nowhere.

    Raises: UsageError for `distance`, `median` and `contributors`, which gsplat does not give;
        ValueError if neither `colours` nor `sh` is given.

    Source: gsplat's documented `rasterization`.
    """
    if sh is None or colours is not None:
        colours = spherical_harmonics.seen_colours(means, camera.centre, sh, colours)
        sh = None
    if distance or median or contributors:
        raise UsageError("backend 'cuda' has no distance, median depth or contributors; use 'cpu'")
    features, degree = (sh, round((sh.shape[1]) ** 0.5) - 1) if sh is not None else (colours, None)
    assert features is not None
    home, device = means.device, gpu()

    def there(tensor: Tensor) -> Tensor:
        return tensor.to(device, torch.float32)

    image, alpha, meta = importlib.import_module("gsplat").rasterization(
        there(means), there(rotation.normalise(quaternions)), there(scales), there(opacities), there(features),
        there(camera.world_to_camera)[None], there(camera.K)[None], camera.width, camera.height,
        near_plane=camera.near, sh_degree=degree, packed=False, render_mode="RGB+ED",
        backgrounds=None if background is None else there(background)[None],
        rasterize_mode=mode, absgrad=probe is not None,
    )  # fmt: skip
    if probe is not None and meta["means2d"].requires_grad:
        _collect(meta["means2d"], probe)
    radii = meta["radii"][0].float()
    return RenderOutput(
        colour=image[0, :, :, :-1].to(home),
        alpha=alpha[0, :, :, 0].to(home),
        depth=image[0, :, :, -1].to(home),
        radii=(radii.amax(dim=-1) if radii.ndim == 2 else radii).detach().to(home),
    )


def gpu() -> torch.device:
    """The device that gsplat runs on."""
    return torch.device("cuda")


def _collect(means: Any, probe: ScreenProbe) -> None:
    """Leave the gradients by the 2D means in the probe when backward has passed them."""

    def leave(gradient: Tensor) -> None:
        # gsplat sets .absgrad in its own backward, before this hook
        probe.signed.grad = gradient[0].to(probe.signed)
        probe.absolute.grad = means.absgrad[0].to(probe.absolute)
        hook.remove()  # it holds `means`, which holds it where Python's collector does not see it

    hook = means.register_hook(leave)
