"""What the merge keeps of each block, and the merged model, written slice by slice: never in memory as a whole."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.methods.city.block_model import BlockModel
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.city.stitch import block_shares, cut_hard, draw_shares, stitch, widened
from splatproof.methods.contracts.reconstruction import (
    ARRAYS,
    DESCRIPTION,
    Origin,
    write_description,
)
from splatproof.methods.models.explicit import EXPLICIT, FIELDS, explicit_facts
from splatproof.methods.storage.float_file import write_float_stream
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.stitching.stochastic import faded


def kept_rows(
    blocks: Sequence[BlockModel], settings: CitySettings, seed: int, threads: int | None
) -> tuple[tuple[Bool[Tensor, " _"], ...], tuple[Float64[Tensor, " _"], ...] | None]:
    """Which Gaussians of each block the merge keeps, and shares of their optical depth if they fade.

    One block loses nothing.

    Args:
        blocks: All blocks, in the order in which a hard merge resolves ties.
        settings: Merge, overlap, outside and stitch count.
        seed: Seed of the draws of a merge by "sis" or "shares".
        threads: For its neighbour search; None: all cores. The result does not depend on it.

    Returns: Masks, and what of its optical depth each Gaussian of each block keeps; None: all of it.
    """
    if len(blocks) == 1:
        return (torch.ones(len(blocks[0]), dtype=torch.bool),), None
    if settings.merge == "hard":
        return cut_hard(blocks, settings.outside, settings.overlap), None
    blocks, generator = widened(blocks, settings.overlap), torch.Generator().manual_seed(seed)
    if settings.merge == "sis":
        return stitch(blocks, settings.stitch, generator, threads=threads), None
    held = block_shares(blocks)
    if settings.merge == "fade":
        return tuple(share > 0 for share in held), held
    return draw_shares(blocks, held, generator), None


def write_merged(
    folder: Path,
    blocks: Sequence[BlockModel],
    kept: Sequence[Bool[Tensor, " _"]],
    *,
    origin: Origin,
    mode: Mode = "classic",
    shift: Float[Tensor, "3"],
    units: str = "sfm",
    fade: Sequence[Float64[Tensor, " _"]] | None = None,
) -> tuple[int, ...]:
    """Write what each block keeps as one model folder, as save_model does, but streaming.

    Primitives lie block after block, in their own order: the numbers returned say whose is whose.

    Args:
        folder: Where the merged model is written; one whose writing was interrupted is refused by
            load_reconstruction.
        blocks: All blocks, of the same SH degree, in float32.
        kept: Which primitives of each block stay (stitch, cut_hard).
        origin: Where the merged model comes from.
        mode: How it is rasterized.
        shift: Vector in scene units, float64; added to positions it gives those in the original
            frame.
        units: Name of the length unit.
        fade: Share of its optical depth that each primitive of each block keeps; None: all of it.

    Returns: Number of primitives that each block contributes.

    Raises: DataError for blocks of different SH degree, or when nothing is kept.
    """
    bands = {block.bands for block in blocks}
    if len(bands) != 1:
        raise DataError(f"blocks with {sorted(bands)} SH bands: expected the same in all")
    (count,) = bands
    counts = tuple(int(mask.sum()) for mask in kept)
    total = sum(counts)
    if total == 0:
        raise DataError(
            f"all {len(blocks)} blocks lost every primitive in the merge: were they trained in the "
            "frame of their regions?"
        )
    (folder / DESCRIPTION).unlink(missing_ok=True)
    shapes = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (),
              "sh": (count, 3)}  # fmt: skip
    layout = {name: (total, *shapes[name]) for name in FIELDS}
    write_float_stream(folder / ARRAYS, layout, _kept_slices(blocks, kept, fade))
    facts = explicit_facts(
        mode=mode, shift=shift, units=units, primitives=total, degree=round(count**0.5) - 1
    )
    write_description(folder, EXPLICIT, origin, facts)
    return counts


def _kept_slices(
    blocks: Sequence[BlockModel],
    kept: Sequence[Bool[Tensor, " _"]],
    fade: Sequence[Float64[Tensor, " _"]] | None,
) -> Iterator[dict[str, Tensor]]:
    """Everything that is kept, block after block."""
    for i, (block, mask) in enumerate(zip(blocks, kept, strict=True)):
        start = 0
        for part in block.slices():
            here = slice(start, start + len(part["means"]))
            start, held = here.stop, mask[here]
            taken = {name: values[held] for name, values in part.items()}
            if fade is not None:
                taken["opacity_logits"] = faded(taken["opacity_logits"], fade[i][here][held])
            yield taken
