"""Pictures that need a trained model: a short 3dgs run on the scene, then seams and spectra."""

import tempfile
from functools import lru_cache
from pathlib import Path

import torch

from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.reconstruction import Bakes
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import METHODS
from splatproof.metrics.seam_render import render_seam_view
from splatproof.reference.partition import boxes
from splatproof.reference.partition import density_split as partition_density
from splatproof.reference.partition.density_split import DensitySettings
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene
from splatproof.suites.gallery.blocks import draw_spectrum
from splatproof.suites.gallery.drawing import COLOURS, panels, save, show_image

STEPS = 600
"""Training steps of the model that is drawn: seconds on two cores."""


@lru_cache(maxsize=1)
def short_model(scene: Scene) -> Gaussians:
    """Method 3dgs after a few hundred steps, seed 0."""
    method = METHODS["3dgs"]
    with tempfile.TemporaryDirectory() as folder:
        run = Run(folder=Path(folder), seed=0)
        model = method.fit(scene, method.settings(iterations=STEPS), run)
        assert isinstance(model, Bakes)
        return model.bake()


def draw_spectral_energy(scene: Scene, path: Path) -> None:
    """Spectral energy of the Gaussians, and what the gate drops.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    draw_spectrum(short_model(scene), path)


def draw_seams(scene: Scene, path: Path) -> None:
    """Seam mask over a render, the render by block, and the two strongest blocks' difference.

    Args:
        scene: Scene that the picture is made of.
        path: PNG file to write.
    """
    model = short_model(scene)
    means = model.means.double()
    settings = DensitySettings(max_points=0, max_depth=4, max_blocks=4)
    found = partition_density.split(means[:, :2], settings)
    heights = partition_density.height_bounds(means[:, 2])
    oriented = partition_density.oriented_boxes(found, torch.eye(3, dtype=torch.float64), heights)
    distances = torch.stack([boxes.box_distance(box, means) for box in oriented])
    # As after stitching: a primitive of the rim may belong to the neighbour that it lies beside.
    owner = distances.argmin(dim=0)
    near = (distances <= 1.1).sum(dim=0) > 1
    second = distances.scatter(0, owner[None], torch.inf).argmin(dim=0)
    swap = near & (torch.rand(len(means), generator=torch.Generator().manual_seed(0)) < 0.5)
    owner = torch.where(swap, second, owner)
    own = distances.gather(0, owner[None])[0]
    view = scene.views[scene.test[0]]
    backend = get_backend("cpu")
    seam = render_seam_view(backend.rasterize, view.camera, model, owner, own.float(), view.load())
    tint = torch.tensor([[int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in COLOURS])
    coloured = backend.rasterize(
        view.camera, model.means, model.quaternions, model.scales, model.opacities,
        colours=tint[owner],
    ).colour.clamp(0, 1)  # fmt: skip
    marked = seam.image.clone()
    marked[seam.seam] = 0.4 * marked[seam.seam] + 0.6 * torch.tensor([1.0, 0.1, 0.3])
    error = (seam.image - seam.truth).abs().mean(dim=-1)
    figure, axes = panels(4, width=14.0)
    show_image(axes[0], seam.image.numpy(), f"render of {view.name}")
    show_image(axes[1], (0.6 * coloured + 0.4 * seam.image).numpy(), "by block")
    show_image(
        axes[2], marked.numpy(), f"seam mask: {float(seam.seam.float().mean()):.0%} of pixels"
    )
    show_image(axes[3], error.numpy(), "error", cmap="inferno", vmin=0, vmax=0.25)
    save(figure, path)
