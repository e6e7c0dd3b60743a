"""A scene small enough to train on in a test: random Gaussians seen by a few cameras."""

from functools import partial
from pathlib import Path

import torch
from jaxtyping import Bool
from torch import Tensor

from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, SparsePoints, View


def random_gaussians(count: int, *, degree: int = 1, seed: int = 0) -> Gaussians:
    """Blobs of 0.05 to 0.2 units inside a cube of 2 units around the origin."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator)

    sh = torch.randn(count, (degree + 1) ** 2, 3, generator=generator)
    return Gaussians(
        means=uniform(count, 3) * 2 - 1,
        quaternions=torch.randn(count, 4, generator=generator),
        log_scales=(0.05 + 0.15 * uniform(count, 3)).log(),
        opacity_logits=uniform(count) * 4 - 1,
        sh=0.3 * sh,
    )


def camera(index: int, *, width: int = 24, height: int = 18) -> Camera:
    """One of a row of cameras that look along z at the cube from 4 units away."""
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, 3] = torch.tensor([0.4 * index - 1.0, 0.1 * index, 4.0])
    K = torch.tensor(
        [[1.6 * width, 0, width / 2], [0, 1.6 * width, height / 2], [0, 0, 1]], dtype=torch.float64
    )
    return Camera(K=K, world_to_camera=pose, width=width, height=height)


def tiny_scene(
    *, views: int = 6, points: int = 40, seed: int = 0, mask: Bool[Tensor, "h w"] | None = None
) -> Scene:
    """Photos of random Gaussians, and their centres as sparse points. View 0 is held out."""
    truth = random_gaussians(points, seed=seed)

    def view(index: int) -> View:
        where = camera(index)
        photo = rasterizer.rasterize(
            where, truth.means, truth.quaternions, truth.scales, truth.opacities, sh=truth.sh
        ).colour.clamp(0, 1)
        return View(
            name=f"{index}.png",
            camera=where,
            load=partial(torch.clone, photo),
            load_mask=None if mask is None else mask.clone,
        )

    return Scene(
        name="tiny",
        root=Path("nowhere"),
        views=tuple(view(i) for i in range(views)),
        train=tuple(range(1, views)),
        test=(0,),
        points=sparse_points(truth.means.double()),
        up=torch.tensor([0.0, -1.0, 0.0], dtype=torch.float64),
        units="sfm",
        shift=torch.zeros(3, dtype=torch.float64),
    )


def sparse_points(positions: Tensor) -> SparsePoints:
    """Grey points without tracks."""
    return SparsePoints(
        positions=positions,
        colours=torch.full((len(positions), 3), 128, dtype=torch.uint8),
        track_starts=torch.zeros(len(positions) + 1, dtype=torch.int64),
        track_views=torch.zeros(0, dtype=torch.int64),
    )
