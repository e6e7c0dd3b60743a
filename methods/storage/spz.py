"""Gaussians as .spz, the small format of the web viewers, through the public package gsply."""

import gzip
import struct
import zlib
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np
import torch
import zstandard
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import DataError, MissingError
from splatproof.base.files import whole_file
from splatproof.methods.models.explicit import check_gaussians
from splatproof.methods.storage.morton import morton_order
from splatproof.methods.storage.spz_claims import FLAGS, GZIP, check_claims, read_flags
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians

Version = Literal[3, 4]
"""3: gzip, which every viewer reads; 4: zstd."""
GZIP_TIME = range(4, 8)
"""Bytes of gzip's header that say when it was written (RFC 1952, Section 2.3.1); 0: not said."""
ANTIALIASED = 1
"""Bit of the header's flags that is set where a model was trained antialiased."""
WHOLE_BITS = 24
"""Bits of a stored coordinate, fraction and sign included."""
ALL_BITS = (8, 8)
"""Bits of a harmonic that are kept, in degree 1 and above: all that the format has room for."""
SCALES = (-10.0, 5.9375, 1 / 16)
"""Lowest and highest log scale, and the step between two."""
DC = (-0.5 / 0.15, 0.5 / 0.15, 1 / (255 * 0.15))
"""The same of SH coefficient 0."""
HARMONICS = (-1.0, 127 / 128, 1 / 128)
"""The same of the others."""
USUAL_BITS = (5, 4)
"""The same as the format's own encoder keeps them, which makes the file about half as large."""


def write_spz(
    path: str | Path,
    gaussians: Gaussians,
    *,
    version: Version = 3,
    harmonics: tuple[int, int] = ALL_BITS,
    mode: Mode = "classic",
) -> None:
    """Write positions in fixed point, 8-bit colour, opacity and scale, harmonics in 8 bits or what `harmonics` says.

    Gaussians lie in the order of the Morton curve through their positions, which makes the file smaller; what is
    beyond the format's ranges is clipped (`clipped` counts it). Positions get as many fractional bits as their extent leaves of 24: the package's fixed 12 are
    0.24 mm in metres, and anything in other units.

    Args:
        path: The file, written whole or not at all.
        gaussians: The model, in float32, in a frame whose origin is near it.
        version: Version of the format: 3 opens in every viewer, 4 is compressed with zstd.
        harmonics: Bits of each that are kept, 1 to 8, in degree 1 and above; the others are 0, and compress.
        mode: How the model is rasterized; the file says where that is antialiased.

    Raises: MissingError without the package; DataError for no Gaussians, which no reader takes, and for positions
        beyond 2^22.

    Source: the format's public description and its encoder's bits of harmonics (Niantic Labs, spz); extent-aware bits: ours.
    """
    path = Path(path)
    gsply = _package()
    if not len(gaussians):
        raise DataError(f"{path}: 0 Gaussians. Expected at least one")
    bits = fractional_bits(gaussians)
    if bits < 1:
        reach = float(gaussians.means.abs().max())
        raise DataError(f"{path}: positions up to {reach:.3g}; .spz holds less than 2^22")
    order = morton_order(gaussians.means)
    gaussians = Gaussians(**{name: values[order] for name, values in vars(gaussians).items()})
    data = gsply.GSData(
        means=gaussians.means.numpy(), scales=gaussians.log_scales.numpy(),
        quats=gaussians.unit_quaternions.numpy(), opacities=gaussians.opacity_logits.numpy(),
        sh0=gaussians.sh[:, 0].numpy(), shN=in_buckets(gaussians.sh[:, 1:], harmonics).numpy(),
    )  # fmt: skip
    with whole_file(path) as partial:
        gsply.write_spz(partial, data, version=version, fractional_bits=bits)
        if mode == "antialiased":
            _flag(partial)
        if version == 3:
            _forget_time(partial)


def fractional_bits(gaussians: Gaussians) -> int:
    """Bits of a coordinate that are left for its fraction: positions are stored in steps of two to their negative power.

    Args:
        gaussians: The model that is written, at least one.
    Returns: 24 at most; below 1 where the format has no room for the positions.

    Source: ours.
    """
    reach = float(gaussians.means.abs().max())
    whole = max(0, int(np.floor(np.log2(max(reach, 1e-6)))) + 1) + 1  # and the sign
    return WHOLE_BITS - whole


def clipped(gaussians: Gaussians) -> dict[str, int]:
    """Gaussians of which a number is off by more than half a step because .spz has no room for it, by what it is of.

    Args:
        gaussians: The model that is written.
    Returns: "log scales", "colours" (SH coefficient 0) and "harmonics" (the others), those alone that lose something.

    Source: ranges of the format's public description (Niantic Labs, spz).
    """
    parts = {
        "log scales": (gaussians.log_scales, SCALES),
        "colours": (gaussians.sh[:, 0], DC),
        "harmonics": (gaussians.sh[:, 1:].flatten(start_dim=1), HARMONICS),
    }
    found = {
        name: int(((values < low - step / 2) | (values > high + step / 2)).any(dim=1).sum())
        for name, (values, (low, high, step)) in parts.items()
    }
    return {name: count for name, count in found.items() if count}


def _flag(path: Path) -> None:
    """Set the bit of what was trained antialiased, which the package has no word for."""
    packed = path.read_bytes()
    whole = bytearray(gzip.decompress(packed) if packed.startswith(GZIP) else packed)
    whole[FLAGS] |= ANTIALIASED
    path.write_bytes(gzip.compress(whole) if packed.startswith(GZIP) else whole)


def _forget_time(path: Path) -> None:
    """Take the time of writing out of a gzip header: the same model gives the same bytes."""
    with path.open("r+b") as file:
        file.seek(GZIP_TIME.start)
        file.write(bytes(len(GZIP_TIME)))


def in_buckets(rest: Float[Tensor, "n r 3"], bits: tuple[int, int]) -> Float[Tensor, "n r 3"]:
    """Harmonics of degree 1 and above whose stored bytes are multiples of 2^(8 - bits).

    A byte is round(128 x) + 128, then the nearest multiple, halves up, and 255 where that would be 256.

    Args:
        rest: SH coefficients without DC.
        bits: Bits that are kept of those of degree 1, and of all others.

    Source: quantizeSH of Niantic Labs' spz.
    """
    if bits == ALL_BITS:
        return rest.contiguous()
    found = (128 * rest).round() + 128
    for part, kept in ((slice(0, 3), bits[0]), (slice(3, None), bits[1])):
        step = 2 ** (8 - kept)
        found[:, part] = ((found[:, part] + step // 2) / step).floor() * step
    return (found.clamp(0, 255) - 128) / 128


def read_spz(path: str | Path) -> Gaussians:
    """The Gaussians of an .spz file.

    Raises: MissingError without the package; DataError for a file that is missing or damaged.
    """
    path = Path(path)
    gsply = _package()
    check_claims(path)
    try:
        data = gsply.read_spz(path)
    except (
        OSError,
        ValueError,
        EOFError,
        MemoryError,
        zlib.error,
        struct.error,
        zstandard.ZstdError,
    ) as error:
        raise DataError(f"{path}: not a whole .spz file ({error})") from None
    dc, rest = np.asarray(data.sh0), np.asarray(data.shN)
    if not len(dc):
        raise DataError(f"{path}: 0 Gaussians. Expected at least one")
    if rest.ndim < 3:  # degree 0
        rest = np.zeros((len(dc), 0, 3))
    sh = np.concatenate([dc[:, None], rest], axis=1)
    parts = {"means": data.means, "quaternions": data.quats, "log_scales": data.scales,
             "opacity_logits": data.opacities, "sh": sh}  # fmt: skip
    model = Gaussians(
        **{
            name: torch.from_numpy(np.ascontiguousarray(part, dtype=np.float32))
            for name, part in parts.items()
        }
    )
    check_gaussians(model, path)
    return model


def read_mode(path: str | Path) -> Mode:
    """How the model of an .spz file is drawn.

    Args:
        path: A file that `read_spz` has read.
    Returns: "antialiased" where the file says so, else "classic".

    Source: the format's public description (Niantic Labs, spz).
    """
    return "antialiased" if read_flags(Path(path)) & ANTIALIASED else "classic"


def _package() -> ModuleType:
    """The package gsply.

    Raises: MissingError without it.
    """
    try:
        import gsply
    except ImportError:
        raise MissingError(
            "no package gsply, which reads and writes .spz; pip install 'splatproof[spz]'"
        ) from None
    return gsply
