"""Our own matcher of photos whose poses are known: a small siamese network over a sweep of planes."""

from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional, init

from splatproof.methods.priors.plane_sweep import (
    STRIDE,
    Pair,
    Planes,
    pair_of,
    pixels,
    positions,
    smaller,
)
from splatproof.methods.priors.unet import PACKAGED, load_weights, save_weights
from splatproof.reference.supervision.dense_matching import AGREEMENT
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.types.camera import Camera, project_points

FORMAT = "splatproof matcher 1"
"""What the facts of a weights file say under "format"."""
SHIPPED = PACKAGED / "matcher.safetensors"
"""Weights that come with this package; matcher.json beside them says how they were made."""
NEAR, HALF, WIDE, COARSE = 16, 24, 32, 24
"""Channels at full and half size, between, and of the coarse features."""
GROUPS = 4
"""Parts of the features that are compared apart."""
MIXED = 8
"""Channels of what looks at the comparisons of neighbouring pixels and planes together."""
FINE, FINER = 11, 4
"""Planes of the second sweep around what the first found, and how many of its steps are one of the first's."""
MIDDLE = FINE // 2
"""Number of the plane of the second sweep that the first found."""
SHARP = 10.0
"""Logits between features that are the same and ones that have nothing in common, at first."""
REACH = 2
"""Planes on either side of the likeliest one whose mean is the answer, and whose chances are its certainty."""
DARKEST = 0.01
"""Deviation of a photo's colours, of 1, below which it is not stretched further."""
NEAREST = 1e-3
"""Least k of an answer: no surface is farther than a thousand times as far as the middle plane."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Said:
    """What the network says of a pair."""

    coarse: Float[Tensor, "d hc wc"]
    """Logits of the planes at each coarse cell."""
    fine: Float[Tensor, "f h w"]
    """Logits of FINE planes of its own at each pixel, `step` apart, the middle one at `start`."""
    start: Float[Tensor, "h w"]
    """k that the first sweep found at each pixel."""
    step: float
    """k between two planes of the second sweep."""


class Mixing(nn.Module):
    """Comparisons of neighbouring pixels and neighbouring planes looked at in turns, which is fast on a processor."""

    def __init__(self) -> None:
        """Start from random weights, with the last of zeros: it says nothing at first."""
        super().__init__()
        self.pixels = nn.ModuleList(
            nn.Conv2d(before, MIXED, 3, padding=1) for before in (GROUPS, MIXED)
        )
        self.planes = nn.ModuleList(
            nn.Conv2d(MIXED, after, (3, 1), padding=(1, 0)) for after in (MIXED, 1)
        )
        for values in self.planes[1].parameters():
            init.zeros_(values)

    def forward(self, cost: Float[Tensor, "g d h w"]) -> Float[Tensor, "d h w"]:
        """A logit for each plane and pixel.

        Args:
            cost: How alike each group of features is.
        """
        at = cost
        for index in range(2):
            by_plane = functional.relu(self.pixels[index](at.transpose(0, 1))).transpose(0, 1)
            at = self.planes[index](by_plane.flatten(2)[None])[0].unflatten(2, cost.shape[2:])
            at = functional.relu(at) if index == 0 else at
        return at[0]


class MatchNetwork(nn.Module):
    """52,000 parameters: features of both photos, compared on planes, coarse and then fine; ours."""

    def __init__(self) -> None:
        """Start from random weights; what looks at neighbours says nothing at first."""
        super().__init__()
        self.near = _layers((3, NEAR, 1, 1), (NEAR, NEAR, 1, 1))
        self.halved = _layers((NEAR, HALF, 2, 1), (HALF, HALF, 1, 1))
        self.wide = _layers((HALF, WIDE, 2, 1), (WIDE, WIDE, 1, 1), (WIDE, WIDE, 1, 2))
        self.far = nn.Conv2d(WIDE, COARSE, 3, padding=2, dilation=2)
        self.join = nn.Conv2d(NEAR + COARSE, NEAR, 3, padding=1)
        self.sharp = nn.Parameter(torch.full((2,), SHARP))
        self.mix = nn.ModuleList(Mixing() for _ in range(2))

    def features(
        self, photo: Float[Tensor, "3 h w"], counted: Bool[Tensor, "h w"]
    ) -> tuple[Float[Tensor, "c hc wc"], Float[Tensor, "f h w"]]:
        """Coarse and fine features, in GROUPS unit vectors each; 0 where nothing counts.

        Args:
            photo: sRGB in [0, 1]; brightness and contrast of the whole do not matter.
            counted: Pixels that show something.
        """
        weight = counted.to(photo)
        near = self.near(_stretched(photo, weight)[None])
        far = self.far(self.wide(self.halved(near)))
        larger = functional.interpolate(far, scale_factor=STRIDE, mode="bilinear")
        fine = self.join(torch.cat([near, larger], dim=1))
        share = functional.avg_pool2d(weight[None], STRIDE)[0]
        return _units(far[0], share), _units(fine[0], weight)

    def forward(self, pair: Pair) -> Said:
        """Logits of both sweeps; gradients of the second do not reach where it starts.

        Args:
            pair: The photos.
        """
        everywhere = torch.ones_like(pair.covered)
        here, there = (
            self.features(pair.photo, everywhere), self.features(pair.other, pair.covered)
        )  # fmt: skip
        height, width = pair.covered.shape
        cells = pixels(height // STRIDE, width // STRIDE, STRIDE)
        scales = pair.planes.scales.float()
        whole = scales[:, None, None].expand(-1, *cells.shape[:2])
        coarse = self._swept(0, here[0], there[0], pair.planes, cells, whole)
        first, step = float(scales[0]), float(scales[1] - scales[0])
        found = first + step * peak(coarse.detach())[0]
        start = functional.interpolate(found[None, None], scale_factor=STRIDE, mode="bilinear")[
            0, 0
        ]
        number = torch.arange(FINE) - MIDDLE
        around = start + step / FINER * number[:, None, None]
        fine = self._swept(1, here[1], there[1], pair.planes, pixels(height, width), around)
        return Said(coarse=coarse, fine=fine, start=start, step=step / FINER)

    def _swept(
        self,
        level: int,
        here: Float[Tensor, "c h w"],
        there: Float[Tensor, "c h w"],
        planes: Planes,
        at: Float[Tensor, "h w 3"],
        scales: Float[Tensor, "d h w"],
    ) -> Float[Tensor, "d h w"]:
        """Logits of each plane: how alike the features are, and what neighbouring pixels and planes add to that."""
        size = at[-1, -1, :2] + at[0, 0, :2]
        alike = []
        for scale in scales:  # one after the other, so that memory holds the features once
            grid = (2 * positions(planes, at, scale[None]) / size - 1).float()
            met = functional.grid_sample(there[None], grid, align_corners=False)[0]
            alike.append((here * met).unflatten(0, (GROUPS, -1)).sum(dim=1))
        cost = torch.stack(alike, dim=1)
        return self.sharp[level] * cost.mean(dim=0) + self.mix[level](cost)


def _layers(*sizes: tuple[int, int, int, int]) -> nn.Sequential:
    """Convolutions of 3 x 3 by channels before and after, stride and dilation, each with a ReLU."""
    made: list[nn.Module] = []
    for before, after, stride, apart in sizes:
        layer = nn.Conv2d(before, after, 3, stride, padding=apart, dilation=apart)
        init.kaiming_normal_(layer.weight, nonlinearity="relu")
        assert layer.bias is not None
        init.zeros_(layer.bias)
        made += [layer, nn.ReLU()]
    return nn.Sequential(*made)


def _stretched(
    photo: Float[Tensor, "3 h w"], weight: Float[Tensor, "h w"]
) -> Float[Tensor, "3 h w"]:
    """Each channel less its mean and over its deviation, of what counts."""
    count = weight.sum().clamp(min=1)
    off = (photo - ((photo * weight).sum(dim=(1, 2)) / count)[:, None, None]) * weight
    return off / (off.square().sum(dim=(1, 2)) / count + DARKEST**2).sqrt()[:, None, None]


def _units(
    features: Float[Tensor, "c h w"], weight: Float[Tensor, "h w"]
) -> Float[Tensor, "c h w"]:
    """Less their mean, which all pixels have in common and which tells none apart, and of length 1 in each group."""
    mean = (features * weight).sum(dim=(1, 2)) / weight.sum().clamp(min=1)
    off = (features - mean[:, None, None]).unflatten(0, (GROUPS, -1))
    return functional.normalize(off, dim=1).flatten(0, 1) * weight


def peak(
    logits: Float[Tensor, "d h w"],
) -> tuple[Float[Tensor, "h w"], Float[Tensor, "h w"]]:
    """Number of the likeliest plane, with a fraction, and the chance that the truth is by it.

    The mean over the planes at most REACH from the likeliest one, and the sum of their chances. That is 0 where the
    likeliest plane is the first or the last: the truth may lie beyond.

    Args:
        logits: One for each plane.
    """
    chances = logits.softmax(dim=0)
    best = chances.argmax(dim=0)
    number = torch.arange(len(logits))[:, None, None]
    by_it = chances * ((number - best).abs() <= REACH)
    sure = by_it.sum(dim=0)
    within = (best > 0) & (best < len(logits) - 1)
    return (number * by_it).sum(dim=0) / sure, sure * within


def estimate(
    network: MatchNetwork, pair: Pair
) -> tuple[Float[Tensor, "h w"], Float[Tensor, "h w"]]:
    """Inverse depth of each pixel of the first photo, float64, and the chance of it in both sweeps.

    Args:
        network: The network.
        pair: The photos.
    """
    said = network(pair)
    number, sure = peak(said.fine)
    before = functional.interpolate(peak(said.coarse)[1][None, None], scale_factor=STRIDE)[0, 0]
    scale = (said.start + said.step * (number - MIDDLE)).clamp(min=NEAREST)
    plane = pixels(*pair.covered.shape) @ pair.planes.slope
    return scale.double() * plane, sure * before


class OwnMatcher:
    """The network both ways; one for all pairs and threads, which wait for one another."""

    def __init__(self, network: MatchNetwork) -> None:
        """Take a trained network."""
        self.network = network
        self._alone = Lock()

    def __call__(
        self,
        first: Camera,
        second: Camera,
        image: Float[Tensor, "h w 3"],
        other: Float[Tensor, "hb wb 3"],
        shared: Float[Tensor, "n 3"],
    ) -> tuple[Float[Tensor, "h w 2"], Float[Tensor, "h w"]]:
        """The warp W with u_B = u_A + W(u_A) in pixels, along the epipolar lines, and certainty in [0, 1].

        Certainty is the chance of the planes about the answer in both sweeps, times exp(-e^2 / 2): a match, carried
        back by the depth that B is found to have there, misses its pixel by e pixels. It is 0 outside B.

        Args:
            first: Camera of photo A.
            second: Camera of photo B, at another place.
            image: Photo A, sRGB in [0, 1].
            other: Photo B.
            shared: Sparse points that both see, in scene units: they say where planes are needed. Without any,
                nothing is certain.

        Source: ours.
        """
        (a, photo), (b, seen) = smaller(first, image), smaller(second, other)
        there, back = pair_of(a, b, photo, seen, shared), pair_of(b, a, seen, photo, shared)
        if there is None or back is None:
            return torch.zeros(*image.shape[:2], 2), torch.zeros(image.shape[:2])
        with self._alone, torch.no_grad():  # what a pair takes is not multiplied by threads
            inverse, sure = estimate(self.network, there)
            returned, _ = estimate(self.network, back)
        inverse, sure = inverse[: a.height, : a.width], sure[: a.height, : a.width]
        sure = sure * agreement(a, b, inverse, returned[: b.height, : b.width])
        maps = torch.stack([inverse, sure])[None]
        if a is not first:
            maps = functional.interpolate(maps, image.shape[:2], mode="bilinear")
        at, z = project_points(second, unproject(first, 1 / maps[0, 0]))
        size = at.new_tensor([second.width, second.height])
        inside = ((at >= 0) & (at < size)).all(dim=1) & (z > 0)
        warp = at.reshape(*image.shape[:2], 2) - pixels(*image.shape[:2])[..., :2]
        return warp.float(), (maps[0, 1] * inside.reshape(image.shape[:2])).float()


def agreement(
    first: Camera,
    second: Camera,
    inverse: Float[Tensor, "h w"],
    other: Float[Tensor, "hb wb"],
) -> Float[Tensor, "h w"]:
    """exp(-e^2 / 2) of each pixel of A: to B and back by both inverse depths it misses its place by e pixels.

    Args:
        first: Camera of photo A.
        second: Camera of photo B.
        inverse: Inverse depth of A's pixels.
        other: Inverse depth of B's pixels.

    Returns: Numbers from 0 to 1; 0 where the way leads out of B, or behind one of the two.
    """
    at, z = project_points(second, unproject(first, 1 / inverse))
    size = at.new_tensor([second.width, second.height])
    read = functional.grid_sample(
        other[None, None], (2 * at / size - 1)[None, :, None], padding_mode="border",
        align_corners=False,
    )[0, 0, :, 0]  # fmt: skip
    ray = torch.cat([at, torch.ones_like(z[:, None])], dim=1) @ torch.linalg.inv(second.K).T
    back, ahead = project_points(
        first, (ray / read[:, None] - second.translation) @ second.rotation
    )
    off = back - pixels(*inverse.shape)[..., :2].reshape(-1, 2)
    met = (at >= 0).all(dim=1) & (at < size).all(dim=1) & (z > 0) & (ahead > 0)
    alike = torch.exp(-off.square().sum(dim=1) / (2 * AGREEMENT**2))
    return torch.where(met, alike, 0).reshape(inverse.shape)


def save_matcher(path: Path, network: MatchNetwork, facts: dict[str, object]) -> None:
    """Write the weights.

    Args:
        path: A .safetensors file.
        network: What is saved.
        facts: How it was trained, JSON-ready.
    """
    save_weights(path, network, FORMAT, facts)


def load_own_matcher(path: Path = SHIPPED) -> OwnMatcher:
    """Read what `save_matcher` wrote.

    Args:
        path: File of the weights.
    Raises: DataError where the file is missing, damaged or not such a network's.
    """
    return OwnMatcher(load_weights(path, MatchNetwork(), FORMAT, "bench train-prior matcher"))
