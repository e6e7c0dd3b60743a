"""Run by test_writer: 20 million primitives in 8 blocks, stitched, merged, packed as each kind of file, unpacked.

Everything goes through the disk. Prints a line of JSON with counts, seconds and the peak memory.
"""

import json
import resource
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import torch

from splatproof.methods.city.block_model import BlockModel
from splatproof.methods.city.merge import write_merged
from splatproof.methods.city.stitch import stitch
from splatproof.methods.contracts.reconstruction import ARRAYS, Origin, write_description
from splatproof.methods.models.explicit import EXPLICIT, explicit_facts
from splatproof.methods.storage.float_file import write_float_stream
from splatproof.methods.storage.packed.coded_writer import write_coded
from splatproof.methods.storage.packed.reader import unpack_packed
from splatproof.methods.storage.packed.rows import FolderRows
from splatproof.methods.storage.packed.writer import write_packed
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.reference.stitching.stochastic import StitchSettings

BLOCKS, EACH, SLICE = 8, 2_500_000, 250_000
SHAPES = {
    "means": (3,),
    "quaternions": (4,),
    "log_scales": (3,),
    "opacity_logits": (),
    "sh": (16, 3),
}


def main(folder: Path) -> dict[str, float]:
    """Do it all; what came out."""
    generator = torch.Generator().manual_seed(0)
    zero = torch.zeros(3, dtype=torch.float64)
    blocks = []
    for i in range(BLOCKS):
        centre = torch.tensor([2.0 * (i % 4), 2.0 * (i // 4), 0.0], dtype=torch.float64)
        box = OrientedBox(
            centre=centre, rotation=torch.eye(3, dtype=torch.float64),
            half=torch.ones(3, dtype=torch.float64),
        )  # fmt: skip
        place = folder / f"block{i}"
        shapes = {name: (EACH, *shape) for name, shape in SHAPES.items()}
        write_float_stream(place / ARRAYS, shapes, slices(centre, generator))
        facts = explicit_facts(mode="classic", shift=zero, units="sfm", primitives=EACH, degree=3)
        write_description(place, EXPLICIT, Origin(method="synthetic"), facts)
        blocks.append(BlockModel(region=box, model=place))
    seconds = {}
    start = time.perf_counter()
    kept = stitch(blocks, StitchSettings(), generator)
    seconds["stitch"] = time.perf_counter() - start
    start = time.perf_counter()
    origin = Origin(method="synthetic")
    counts = write_merged(folder / "merged", blocks, kept, origin=origin, shift=zero)
    seconds["merge"] = time.perf_counter() - start
    for block in blocks:
        assert isinstance(block.model, Path)
        shutil.rmtree(block.model)
    files: dict[str, float] = {}
    for name, write in (("version_2", write_packed), ("small", write_coded)):
        report = write(folder / f"{name}.spgs", FolderRows(folder / "merged"))
        start = time.perf_counter()
        files |= {
            f"{name}_pack": report.seconds,
            f"{name}_unpacked": unpack_packed(folder / f"{name}.spgs", folder / "unpacked"),
            f"{name}_unpack": time.perf_counter() - start,
            f"{name}_bytes_each": report.bytes / report.primitives,
        }
        shutil.rmtree(folder / "unpacked")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return {
        "primitives": BLOCKS * EACH, "merged": sum(counts), "peak_gib": peak, **seconds, **files,
    }  # fmt: skip


def slices(centre: torch.Tensor, generator: torch.Generator) -> Iterator[dict[str, torch.Tensor]]:
    """A flat block whose primitives reach a little beyond its box."""
    for _ in range(EACH // SLICE):
        at = 2.2 * torch.rand(SLICE, 3, generator=generator) - 1.1
        at[:, 2] *= 0.2
        sh = torch.randn(SLICE, 16, 3, generator=generator) * 0.3
        sh[:, 1:] *= 0.1 * torch.rand(SLICE, 1, 1, generator=generator)
        yield {
            "means": at + centre.float(),
            "quaternions": torch.randn(SLICE, 4, generator=generator),
            "log_scales": torch.randn(SLICE, 3, generator=generator) - 5,
            "opacity_logits": torch.randn(SLICE, generator=generator),
            "sh": sh,
        }


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
