"""Trained models: loaded to be rendered, and the rasterizer under them."""

from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from splatproof.api.paths import model_path
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.methods.loading import load_reconstruction
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput


def load(model: str | Path, *, backend: str = "cpu") -> Reconstruction:
    """Load what training left behind.

    `model.render(view)` gives its image of a view: a scene's, or `camera_view(camera)`. The result's
    `colour` is height x width x 3, not clamped; `alpha` and `depth` (scene units, 0 where nothing
    is drawn) are height x width. `model.primitives` counts Gaussians or anchors.

    Args:
        model: Folder that `bench fit` or `fit` calls OUT, the model folder in it, or a packed file.
        backend: Name of the rasterizer that draws it: cpu, reference or cuda.
    Returns: The model.
    Raises: DataError, in one line, if a file is missing, damaged, foreign or of a newer version;
        UsageError for an unknown backend; MissingError if it cannot run here.
    Source: ours.
    """
    get_backend(backend)
    return load_reconstruction(model_path(Path(model)), backend=backend)


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
    backend: str = "cpu",
) -> RenderOutput:
    """Render Gaussians: C = sum_i c_i a_i prod_{j<i} (1 - a_j) + T bg, sorted by camera-space z.

    Colour, alpha and depth are differentiable by every tensor.

    Args:
        camera: The pinhole camera; Gaussians at z <= camera.near are not drawn.
        means: World positions in scene units.
        quaternions: Rotations (w, x, y, z) of any norm; zero is the identity.
        scales: Standard deviations in scene units, >= 0.
        opacities: Opacity of each Gaussian, in [0, 1].
        colours: Colour of each Gaussian, 1 to 32 channels; give this or `sh`, or both: harmonics of
            the first Gaussians, and colours of 3 channels of all others.
        sh: Spherical-harmonic coefficients, k in {1, 4, 9, 16}, DC first.
        background: Colour behind everything; None is black.
        mode: "antialiased" scales opacity by sqrt(det(Sigma2 - 0.3 I) / det(Sigma2)).
        backend: cpu takes float32 on the CPU; reference any float dtype, slowly; cuda the GPU.
    Returns: `colour` (height x width x channels, not clamped), `alpha` in [0, 1), `depth` (scene
        units, 0 where nothing is drawn), `radii` of each Gaussian in pixels (0: not seen).
    Raises: ValueError, naming the argument, unless `colours`, `sh` or both are given and
        shapes and dtypes fit; UsageError for an unknown backend; MissingError if it cannot run here.
    Source: Kerbl et al. 2023, "3D Gaussian Splatting", Sec. 4 to 6; antialiased: Yu et al. 2024.
    """
    return get_backend(backend).rasterize(
        camera, means, quaternions, scales, opacities,
        colours=colours, sh=sh, background=background, mode=mode,
    )  # fmt: skip
