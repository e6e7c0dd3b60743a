"""Priors `own` and `network:PATH`: our own small network, from a photo and the points it shows."""

from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatproof.methods.priors.unet import PACKAGED, STRIDE, UNet, load_weights, save_weights
from splatproof.reference.supervision.dense_initialisation import observations, points_of
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import DepthPrior, Scene, View

FORMAT = "splatproof depth network 1"
"""What the facts of a weights file say under "format"."""
WIDTHS = (24, 48, 96, 128)
"""Channels of the levels, finest first."""
INPUTS = 5
"""Channels of the input: R, G, B, sparse disparity over its median, and where there is any."""
LONGER = 128
"""Pixels of the longer side that the network sees; its answer is enlarged again."""
SHIPPED = PACKAGED / "depth.safetensors"
"""Weights that come with this package; depth.json beside them says how they were made."""
COMPLETION = PACKAGED / "completion.safetensors"
"""The same network's that was trained with points of matched photos; completion.json says how."""


class DepthNetwork(UNet):
    """Four levels with 0.8 million parameters; says disparity of unknown scale and zero."""

    def __init__(self) -> None:
        """Start from random weights."""
        super().__init__(INPUTS, 1, WIDTHS)

    def forward(self, given: Float[Tensor, "n 5 h w"]) -> Float[Tensor, "n h w"]:
        """Disparity of each pixel; both sides of the input are multiples of STRIDE."""
        return self.features(given)[:, 0]


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene.

    Args:
        scene: Any scene; sparse points with tracks help.
        weights: File that `save_network` wrote.
        seed: Not used; it draws nothing.
    Raises: DataError where the file is not such a network's.
    """
    assert weights is not None
    network = load_network(weights)
    seen = observations(scene.points, len(scene.views))

    def make(index: int) -> DepthPrior:
        points = scene.points.positions[points_of(seen, index)]
        return said_of(network, scene.views[index], points)

    return make


def said_of(network: DepthNetwork, view: View, points: Float[Tensor, "n 3"]) -> DepthPrior:
    """What a network says of a view, at the view's size; it says something everywhere.

    Args:
        network: Its weights.
        view: The view.
        points: Sparse points that it sees; none is fine.
    """
    with torch.inference_mode():
        said = network(network_input(view, points)[None])
        whole = functional.interpolate(said[:, None], view.size, mode="bilinear")[0, 0]
    return DepthPrior(disparity=whole.clone(), valid=torch.ones(view.size, dtype=torch.bool))


def network_size(camera: Camera) -> tuple[int, int]:
    """Height and width at which the network sees a view: multiples of STRIDE, LONGER at most."""
    scale = LONGER / max(camera.height, camera.width)
    height, width = (max(1, round(side * scale / STRIDE)) for side in (camera.height, camera.width))
    return STRIDE * height, STRIDE * width


def network_input(view: View, points: Float[Tensor, "n 3"]) -> Float[Tensor, "5 h w"]:
    """Photo and sparse disparity of a view as the network takes them.

    Args:
        view: The view.
        points: Sparse points that it sees; none is fine.
    """
    size = network_size(view.camera)
    photo = functional.interpolate(view.load().permute(2, 0, 1)[None], size, mode="area")[0]
    at, z = project_points(view.camera, points.double())
    scale = torch.tensor([size[1] / view.camera.width, size[0] / view.camera.height]).double()
    column, row = (at * scale).floor().long().T
    inside = (z > 0) & (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    sparse, mask = torch.zeros(2, *size)
    if inside.any():
        disparity = (1 / z[inside]).float()
        place = row[inside] * size[1] + column[inside]
        sparse.view(-1).scatter_reduce_(0, place, disparity / disparity.median(), "amax")
        mask.view(-1)[place] = 1
    return torch.cat([2 * photo - 1, sparse[None], mask[None]])


def save_network(path: Path, network: DepthNetwork, facts: dict[str, object]) -> None:
    """Write the weights.

    Args:
        path: A .safetensors file.
        network: What is saved.
        facts: How it was trained, JSON-ready.
    """
    save_weights(path, network, FORMAT, facts)


def load_network(path: Path) -> DepthNetwork:
    """Read what `save_network` wrote.

    Raises: DataError where the file is missing, damaged or not such a network's.
    """
    return load_weights(path, DepthNetwork(), FORMAT, "bench train-prior depth")
