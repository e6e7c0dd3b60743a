"""Depth priors in training: read once, and the pixels of a frame of which they say anything."""

from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.image_cache import TensorCache
from splatproof.methods.training.terms import Frame
from splatproof.reference.types.scene import Scene

KEPT_BYTES = 2**28
"""Most bytes of disparities that are kept between steps, and of masks."""


def require_prior(scene: Scene, setting: str) -> None:
    """Refuse a scene of whose training views none has a depth prior.

    Args:
        scene: What is trained on.
        setting: Weight that is 0 where there is none.

    Raises: DataError.
    """
    if all(view.load_prior is None for view in scene.train_views):
        raise DataError(
            f"scene {scene.name!r}: no training view has a depth prior; name one for the case, or "
            f"set {setting} = 0 to do without"
        )


class PriorPixels:
    """The priors of the views that are trained on, kept in memory as far as they fit."""

    def __init__(self) -> None:
        """Nothing is read yet."""
        self.disparities, self.masks = TensorCache(KEPT_BYTES), TensorCache(KEPT_BYTES)

    def of(self, frame: Frame) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]] | None:
        """Disparity of a frame's prior, and the pixels that it knows and that count; None: there is no prior.

        Args:
            frame: A view, rendered; the tensors come as its depth's type and device.
        """
        load, depth = frame.view.load_prior, frame.output.depth
        if load is None:
            return None
        disparity = self.disparities.get(frame.view, lambda: load().disparity).to(depth)
        valid = self.masks.get(frame.view, lambda: load().valid).to(depth.device)
        return disparity, valid if frame.mask is None else valid & frame.mask
