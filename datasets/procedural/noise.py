"""Random fields over space: the same numbers for a seed on every machine."""

from functools import cache

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.procedural.units import Number

SIDES = {2: 256, 3: 64}
"""Cells after which a table repeats, by dimension."""


@cache
def _table(dims: int) -> Tensor:
    """Uniform numbers on a lattice, wrapped by one cell: shape [1, 1, side + 1, ...]."""
    side = SIDES[dims]
    numbers = np.random.Generator(np.random.PCG64(dims)).random((side,) * dims, dtype=np.float32)
    return torch.from_numpy(np.pad(numbers, [(0, 1)] * dims, mode="wrap"))[None, None]


@cache
def _offset(dims: int, seed: int) -> Tensor:
    """Whole cells by which a seed moves the table."""
    draw = np.random.Generator(np.random.PCG64((dims, seed))).integers(0, SIDES[dims], dims)
    return torch.from_numpy(draw.astype(np.float32))


def cell_random(cells: Float[Tensor, "n d"], seed: int) -> Float[Tensor, " n"]:
    """A uniform number in [0, 1) for each whole-numbered cell.

    Args:
        cells: Whole numbers as floats, any sign; 2 or 3 columns.
        seed: Another seed gives unrelated numbers.
    """
    dims = cells.shape[1]
    side = SIDES[dims]
    wrapped = torch.remainder(cells + _offset(dims, seed), side).long()
    flat: Int[Tensor, " n"] = wrapped[:, 0]
    for axis in range(1, dims):
        flat = flat * (side + 1) + wrapped[:, axis]
    return _table(dims).flatten()[flat]


def value_noise(points: Float[Tensor, "n d"], seed: int) -> Float[Tensor, " n"]:
    """Smooth noise in [0, 1] with features of size 1: random numbers on a lattice, blended.

    Args:
        points: Positions in units of the lattice; 2 or 3 columns.
        seed: Another seed gives an unrelated field.
    """
    dims = points.shape[1]
    side = SIDES[dims]
    cells = points.floor()
    part = points - cells
    smooth = part * part * (3 - 2 * part)
    moved = cells + _offset(dims, seed)
    moved = moved - side * torch.floor(moved / side) + smooth
    grid = moved.flip(1) * (2 / side) - 1  # grid_sample wants the last axis first
    shape = (1,) * dims + (-1, dims)
    return functional.grid_sample(
        _table(dims), grid.reshape(shape), mode="bilinear", align_corners=True
    ).reshape(-1)


def fbm(
    points: Float[Tensor, "n d"],
    wavelength: Number,
    octaves: int,
    seed: int,
    footprint: Float[Tensor, " n"] | None = None,
) -> Float[Tensor, " n"]:
    """Sum of noises of halving wavelength and amplitude, in [0, 1] with mean 0.5.

    Args:
        points: Positions in metres; 2 or 3 columns.
        wavelength: Wavelength of the coarsest octave, in metres.
        octaves: How many, each of half the wavelength.
        seed: Another seed gives an unrelated field.
        footprint: Metres between neighbouring samples; octaves that they cannot carry fade out.

    Source: Perlin 1985, "An Image Synthesizer"; the fading is Norton et al. 1982, "Clamping".
    """
    total = torch.full_like(points[:, 0], 0.5)
    norm = sum(0.5**i for i in range(octaves))
    for octave in range(octaves):
        length = wavelength * 0.5**octave
        carried = None if footprint is None else visible(length, footprint)
        if carried is not None and not bool(carried.any()):
            break  # finer ones are carried even less
        # turning each octave hides that all lattices are aligned
        turned = products(points, _turn(points.shape[1], octave).to(points))
        wave = (value_noise(turned / length, seed + 101 * octave) - 0.5) * (0.5**octave / norm)
        total = total + (wave if carried is None else wave * carried)
    return total


def products(points: Float[Tensor, "n d"], matrix: Float[Tensor, "d m"]) -> Float[Tensor, "n m"]:
    """Points times a matrix, rounded alike on every machine.

    A library's product chooses its order of sums and its fused multiplications by the processor it finds
    itself on: a hundred values of a world's pictures then come out one level apart, and rows of two
    machines were scored on other images.

    Args:
        points: Row vectors.
        matrix: What multiplies each from the right.
    """
    total = points[:, :1] * matrix[0]
    for axis in range(1, points.shape[1]):
        total = total + points[:, axis : axis + 1] * matrix[axis]
    return total


def inner(points: Float[Tensor, "n d"], way: Float[Tensor, " d"]) -> Float[Tensor, " n"]:
    """Inner products of points with one vector, rounded alike on every machine.

    Args:
        points: Row vectors.
        way: What each is multiplied with.
    """
    return products(points, way[:, None])[:, 0]


def visible(wavelength: Number, footprint: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """How much of a pattern samples can carry: 1 at 4 samples a wavelength, 0 below 2.

    Args:
        wavelength: Size of the pattern's features, in metres.
        footprint: Metres between neighbouring samples.
    """
    return (wavelength / (2 * footprint) - 1).clamp(0, 1)


@cache
def _turn(dims: int, octave: int) -> Tensor:
    """A rotation that differs from octave to octave."""
    draw = np.random.Generator(np.random.PCG64((17, dims, octave))).standard_normal((dims, dims))
    q, r = np.linalg.qr(draw)
    return torch.from_numpy((q * np.sign(np.diag(r))).astype(np.float32))
