"""The image that a view is scored against, made from its photo each time it is asked for.

Order: decode, undistort at full size, then down-scale. The photo is sampled bilinearly only
once and at its own resolution, and the protocol's filter sees straight lines. A protocol may ask
for the other order, which others use; bilinear sampling of a small photo blurs it.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.image_cache import TensorCache
from splatproof.datasets.photos import check_photo, read_photo
from splatproof.datasets.reading_clock import READING
from splatproof.datasets.resize import FILTER_RADIUS, resample, scale_intrinsics
from splatproof.datasets.undistort import (
    Undistortion,
    photo_positions,
    undistort_image,
    valid_pixels,
)

_SHARE = 1e-4
"""Share of a pixel; a smaller one is rounding of the bilinear weights."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """How one photo becomes one truth image."""

    path: Path
    photo_size: tuple[int, int]
    """(width, height) that the camera was calibrated for."""
    undistortion: Undistortion | None
    """None: the photo is a pinhole image already."""
    shrunk: tuple[int, int]
    """(width, height) to which the photo is down-scaled before it is undistorted."""
    size: tuple[int, int]
    """(width, height) of the truth image."""
    filter: str
    positions: TensorCache
    """Shared by the views of a scene: where a camera's pinhole pixels lie in its photos."""
    background: tuple[float, float, float] | None = None
    """SRGB that transparent pixels are laid on; None: a transparent photo is refused."""
    valid: Path | None = None
    """Mask image of the photo: 0 where a pixel must not be used."""
    sky: Path | None = None
    """Mask image of the photo: above 0 where there is sky."""

    def image(self) -> Float[Tensor, "h w 3"]:
        """Float32 sRGB in [0, 1]; zeros where the mask is False."""
        with READING.timed("decode"):
            pixels = read_photo(self.path, self.background)
        height, width, _ = pixels.shape
        if (width, height) != self.photo_size:
            raise DataError(
                f"{self.path}: photo is {width} x {height}, its camera says "
                f"{self.photo_size[0]} x {self.photo_size[1]}; use the photos of this model"
            )
        if self.undistortion is not None:
            with READING.timed("resize"):
                pixels = resample(pixels, self.shrunk, self.filter)
            with READING.timed("undistort"):
                pixels = undistort_image(pixels, self._positions(self.undistortion))
        with READING.timed("resize"):
            pixels = resample(pixels, self.size, self.filter)
        return pixels * self.mask()[..., None] if self.has_mask else pixels

    def __call__(self) -> Float[Tensor, "h w 3"]:
        """As `image`: a view reads its photo by this."""
        return self.image()

    def check(self) -> None:
        """Raise what `image` would raise of the photo's file, without most of the work."""
        check_photo(self.path, transparent=self.background is not None)

    def at(self, size: tuple[int, int]) -> Float[Tensor, "h w 3"]:
        """The image at a smaller size, read in a fraction of the time: the photo never has its full pixels.

        Not the pixels of `image` shrunk, but those of the same rays: the photo is made smaller before it is undistorted.

        Args:
            size: (width, height), at most those of the truth image.
        """
        ratio = max(size[0] / self.size[0], size[1] / self.size[1])
        shrunk = tuple(max(1, min(side, round(side * ratio))) for side in self.shrunk)
        with READING.timed("decode"):
            pixels = read_photo(self.path, self.background, (shrunk[0], shrunk[1]))
        plan = self.undistortion
        if plan is not None:
            with READING.timed("resize"):
                pixels = resample(pixels, (shrunk[0], shrunk[1]), "area")
            old = (plan.width, plan.height)
            small = replace(
                plan, K=scale_intrinsics(plan.K, old, size), width=size[0], height=size[1]
            )
            with READING.timed("undistort"):
                positions = self.positions.get((plan, size), lambda: photo_positions(small))
                pixels = undistort_image(pixels, positions)
        with READING.timed("resize"):
            return resample(pixels, size, "area")

    @property
    def has_mask(self) -> bool:
        """Whether pixels may be invalid."""
        outside = self.undistortion is not None and self.undistortion.masked
        return outside or self.valid is not None

    def mask(self) -> Bool[Tensor, "h w"]:
        """Pixels to which the filter brings nothing from outside the photo or its mask."""
        if self.valid is not None:
            good = self._flag(self.valid)
        elif self.undistortion is not None:
            good = torch.ones(self.photo_size[::-1])
        else:
            return torch.ones(self.size[::-1], dtype=torch.bool)
        if self.undistortion is None:
            return shrink_mask(good > 0, self.size, self.filter)
        positions = self._positions(self.undistortion)
        good = shrink_mask(good > 0, self.shrunk, self.filter).float()
        # bilinear: a pixel that a masked one has any share in is masked
        inside = undistort_image(good[..., None], positions)[..., 0] > 1 - _SHARE
        return shrink_mask(inside & valid_pixels(positions), self.size, self.filter)

    def sky_mask(self) -> Bool[Tensor, "h w"]:
        """Pixels of which more than half is sky. Raises: DataError naming the file."""
        assert self.sky is not None
        return self._mostly(self._flag(self.sky))

    def moving_masks(
        self, moving: Mapping[str, Path | Callable[[], Bool[np.ndarray, "h w"]]]
    ) -> dict[str, Bool[Tensor, "h w"]]:
        """Each kind of what moves, and the pixels that it covers by more than half their area.

        Masks are no field of this class: who may read the image may not read them.

        Args:
            moving: Kind of what moves: mask image of the photo, above 0 where it is, or what makes
                such a mask.
        Raises: DataError naming the file.
        """
        return {
            kind: self._mostly(
                self._flag(source)
                if isinstance(source, Path)
                else torch.from_numpy(source()).float()
            )
            for kind, source in moving.items()
        }

    def _mostly(self, flags: Float[Tensor, "_h _w"]) -> Bool[Tensor, "h w"]:
        """Pixels of the truth image more than half of which is flagged in the photo."""
        share = flags[..., None].expand(-1, -1, 3)
        if self.undistortion is not None:
            share = resample(share, self.shrunk, "area")
            share = undistort_image(share, self._positions(self.undistortion))
        return resample(share, self.size, "area")[..., 0] > 0.5

    def _flag(self, path: Path) -> Float[Tensor, "h w"]:
        """1 where a mask image is above 0."""
        flags = (read_photo(path).amax(-1) > 0).float()
        if flags.shape != self.photo_size[::-1]:
            raise DataError(
                f"{path}: mask is {flags.shape[1]} x {flags.shape[0]}, its photo is "
                f"{self.photo_size[0]} x {self.photo_size[1]}; use the masks of these photos"
            )
        return flags

    def _positions(self, plan: Undistortion) -> Float[Tensor, "h w 2"]:
        return self.positions.get(plan, lambda: photo_positions(plan))


def shrink_mask(
    valid: Bool[Tensor, "h w"], size: tuple[int, int], filter: str
) -> Bool[Tensor, "h2 w2"]:
    """Mask of a down-scaled image: valid where every pixel under the filter was valid.

    Args:
        valid: Mask at full size.
        size: (width, height) after.
        filter: The filter that the image is down-scaled with.
    """
    height, width = valid.shape
    if size == (width, height):
        return valid
    # beyond the new pixel's own rectangle, the filter reaches this many old pixels further
    reach = [
        math.ceil((FILTER_RADIUS[filter] - FILTER_RADIUS["area"]) * old / new)
        for old, new in ((width, size[0]), (height, size[1]))
    ]
    kernel = np.ones((2 * reach[1] + 1, 2 * reach[0] + 1), dtype=np.uint8)
    eroded = cv2.erode(valid.numpy().astype(np.uint8), kernel)  # outside the array counts as valid
    invalid = cv2.resize(1.0 - eroded.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return torch.from_numpy(invalid == 0)
