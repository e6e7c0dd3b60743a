"""What training photos say of a picture from any camera: whether they show it, and how wrong it is.

Nobody knows the true depth of a free camera's picture, so the model's own is asked.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from splatproof.datasets.seen import seen_pixels
from splatproof.metrics.seam_partition import surface_points
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View, camera_view
from splatproof.viewing.poses import resized
from splatproof.viewing.stage import Shown, Stage, model_depth, solid_depth

SLACK = 0.05
"""Share of its depth by which a point may lie behind what the model shows the photo there: more hides
it from the photo."""
PHOTO_WIDTH = 960
"""Width in pixels to which photos are scaled down before they are compared."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotoError:
    """How far a picture is from a photo of the same place."""

    name: str
    """Name of the photo's view."""
    error: Float[Tensor, "h w"]
    """Mean absolute difference of the channels, in [0, 1]; 0 where it is not known."""
    known: Bool[Tensor, "h w"]
    """Where the photo shows what the picture shows."""


def seen_by_photos(
    stage: Stage, shown: Shown, camera: Camera, output: RenderOutput
) -> Bool[Tensor, "h w"]:
    """Which pixels show a surface that at least one training photo shows (True: shown).

    By `datasets.seen.seen_pixels`, with the model's depth in place of the true one, here and in
    small pictures of all training views.

    Args:
        stage: With training views.
        shown: The model.
        camera: Camera of the picture.
        output: What the model shows of it.
    """
    depth = solid_depth(output)
    asked = replace(camera_view(camera, "free camera"), load_depth=lambda: depth)
    assert stage.scene is not None
    seen = seen_pixels(asked, stage.seen_views(shown), stage.scene.points, -1, shown.depths)
    assert seen is not None
    return seen


def error_against_photo(
    stage: Stage, shown: Shown, camera: Camera, output: RenderOutput, photo: View | None
) -> PhotoError:
    """The difference to a photo, carried into the picture along the model's depth.

    Each pixel's surface point is looked up in the photo, if it lies in the photo and nothing that the
    model shows there hides it. From the photo's own camera that is the difference of the two images.

    Args:
        stage: With training views.
        shown: The model.
        camera: Camera of the picture.
        output: What the model shows of it.
        photo: What is compared with; None: the training view whose camera is nearest.
    """
    view = photo or nearest_photo(stage, camera)
    small = resized(view.camera, min(PHOTO_WIDTH, view.camera.width))
    truth = _scaled(stage.photos.load(view), small)
    depth = output.depth.double()
    world = surface_points(camera, depth).reshape(-1, 3)
    at, z = project_points(small, world)
    size = at.new_tensor([small.width, small.height])
    inside = (z > small.near) & ((at >= 0) & (at < size)).all(dim=1)
    seen_from = resized(view.camera, min(PHOTO_WIDTH // 2, view.camera.width))
    asked = replace(view.without_truth(), camera=seen_from)
    front = shown.depths.get((view.name, "front"), lambda: model_depth(shown, asked))
    grid = (2 * at / size - 1).float()[None, None]
    there = grid_sample(front.nan_to_num(posinf=1e30)[None, None], grid, "nearest",
                        "border", align_corners=False)[0, 0, 0]  # fmt: skip
    colour = grid_sample(truth.permute(2, 0, 1)[None], grid, "bilinear", "border",
                         align_corners=False)[0, :, 0].T  # fmt: skip
    known = inside & (z <= (1 + SLACK) * there.double()) & (output.alpha.reshape(-1) >= 0.5)
    error = (output.colour.clamp(0, 1).reshape(-1, 3) - colour).abs().mean(dim=1)
    shape = output.alpha.shape
    return PhotoError(
        name=view.name, known=known.reshape(shape),
        error=torch.where(known, error, 0.0).reshape(shape),
    )  # fmt: skip


def nearest_photo(stage: Stage, camera: Camera) -> View:
    """The training view whose camera is nearest: distance in radii, and difference of directions.

    Args:
        stage: With training views.
        camera: Where the picture is taken from.
    """

    def away(view: View) -> float:
        distance = float((view.camera.centre - camera.centre).norm()) / stage.place.radius
        return distance + 1 - float(view.camera.rotation[2] @ camera.rotation[2])

    return min(stage.training, key=away)


def _scaled(image: Float[Tensor, "h w 3"], camera: Camera) -> Float[Tensor, "a b 3"]:
    """An image as large as a camera's, by areas."""
    size = (camera.height, camera.width)
    if image.shape[:2] == size:
        return image
    return interpolate(image.permute(2, 0, 1)[None], size, mode="area")[0].permute(1, 2, 0)
