"""Twin of reference.compression.packing and reference.compression.container: models of any size, streamed both ways.

Same gate, lattice, codes and half-precision parts as the reference, in chunks that are coded on all
cores, so that neither way holds more than a few of them. What the file adds: primitives in the
order of the Morton curve, streams by part and byte, and no codes for primitives whose harmonics the
gate drops (their rest comes back as exactly 0; the reference rounds 0 to its lattice).

Layout of version 2 (records): a header in JSON, the lattice (float32 m, then r), chunks. A chunk
holds, for each of PARTS, its length in bytes (u32) and a stream (streams).
"""

import json
import os
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor
from torch.nn import functional

from splatproof.base.errors import DataError
from splatproof.base.files import whole_file
from splatproof.methods.contracts.reconstruction import Origin
from splatproof.methods.storage.morton import morton_codes
from splatproof.methods.storage.packed.records import RecordWriter
from splatproof.methods.storage.packed.rows import MemoryRows, Rows
from splatproof.methods.storage.packed.streams import Entropy, squeeze
from splatproof.reference.compression import spectral
from splatproof.reference.compression.affine_codes import STEPS, lattice
from splatproof.reference.compression.packing import PackSettings, half
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians

FORMAT = "splatproof packed model"
CHUNK = 2**17
"""Primitives of a chunk: 31 MB of degree 3 unpacked."""
PARTS = ("positions", "opacity", "rotation", "scale", "dc", "kept", "rest")
"""Streams of a chunk: float32 means; float16 logit, unit quaternion, log scales, SH 0; one bit
whether the rest is kept; the codes of those that do."""
NAMES = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class FileSettings(PackSettings):
    """How much is kept of a model, and how it is laid out."""

    sort: bool = True
    """Whether primitives are ordered along the Morton curve, so that neighbours in space are
    neighbours in the file and it gets smaller; False: they keep their order."""
    planes: bool = True
    """Whether bytes of one kind lie together, as differences where that makes the file smaller;
    False: the numbers of one primitive lie together."""
    entropy: Entropy = "zstd"
    """How the streams of the file are compressed at last. zstd: by zstd; none: not at all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PackedFacts:
    """What a packed model says beside its Gaussians."""

    mode: Mode = "classic"
    """How it is rasterized."""
    shift: Float[Tensor, "3"] = field(default_factory=lambda: torch.zeros(3, dtype=torch.float64))
    """Vector in scene units, float64; added to the means it gives positions in the original
    frame."""
    units: str = "sfm"
    """Name of the length unit."""
    origin: Origin = field(default_factory=Origin)
    """Where it comes from; the header holds its fields beside the others."""


@dataclass(frozen=True, kw_only=True)
class PackedReport:
    """What writing a packed model gave."""

    primitives: int
    """Number of primitives in the file."""
    open_share: float
    """Share of the primitives whose harmonics the gate kept."""
    bytes_by_part: Mapping[str, int]
    """Bytes of each of PARTS, and of "frame": header, lattice, lengths, seals. They sum to the
    file."""
    seconds: float
    """Wall seconds that writing took."""

    @property
    def bytes(self) -> int:
        """Size of the file."""
        return sum(self.bytes_by_part.values())


def write_packed(
    path: str | Path,
    source: Gaussians | Rows,
    *,
    settings: FileSettings | None = None,
    facts: PackedFacts | None = None,
    threads: int | None = None,
) -> PackedReport:
    """Write a packed model, reading the source twice: once for the lattice, once in file order.

    Held at once: 17 bytes a primitive (order, gate), and a few chunks.

    Args:
        path: The file, written whole or not at all.
        source: Gaussians in memory, or rows of a model folder (FolderRows).
        settings: What is kept and how; None: the defaults.
        facts: What is needed to draw and export it; None: the defaults.
        threads: Number of threads that pack; None: one for each core. The bytes do not depend on
            it.

    Raises: DataError for numbers that are not finite or do not fit half precision.

    Source: StitchGS, Sec. 3.3; layout: ours.
    """
    path = Path(path)
    start = time.perf_counter()
    settings, facts = settings or FileSettings(), facts or PackedFacts()
    rows = MemoryRows(source) if isinstance(source, Gaussians) else source
    workers = threads or os.cpu_count() or 1
    gate, low, reach, order = _survey(rows, settings, workers)
    header = {
        "format": FORMAT,
        "primitives": len(rows),
        "bands": rows.bands,
        "chunk": CHUNK,
        "packing": asdict(settings),
        "mode": facts.mode,
        "shift": facts.shift.tolist(),
        "units": facts.units,
        **asdict(facts.origin),
    }
    sizes = dict.fromkeys(PARTS, 0)

    def chunk(first: int) -> list[bytes]:
        chosen = order[first : first + CHUNK] if settings.sort else slice(first, first + CHUNK)
        return _chunk(rows.take(chosen, NAMES), gate[chosen], low, reach, settings)

    with whole_file(path) as partial, partial.open("wb") as file:
        out = RecordWriter(file)
        out.add(json.dumps(header, sort_keys=True).encode())
        out.add(torch.stack([low, reach]).numpy().astype("<f4").tobytes())
        for streams in in_order(chunk, range(0, len(rows), CHUNK), workers):
            for name, stream in zip(PARTS, streams, strict=True):
                sizes[name] += len(stream)
            out.add(b"".join(struct.pack("<I", len(s)) + s for s in streams))
        total = file.tell()
    return PackedReport(
        primitives=len(rows), open_share=float(gate.double().mean()) if len(gate) else 0.0,
        bytes_by_part=sizes | {"frame": total - sum(sizes.values())},
        seconds=time.perf_counter() - start,
    )  # fmt: skip


def in_order(work: Callable[[Any], T], items: Iterable[Any], workers: int) -> Iterator[T]:
    """Results of work(item) in the order of the items, while threads work ahead.

    Args:
        work: What is done with one item, in a thread.
        items: Any number of items, taken one by one.
        workers: Number of threads, at least 1; at most workers + 1 results are begun ahead.
    """
    ahead: deque[Future[T]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for item in items:
                ahead.append(pool.submit(work, item))
                if len(ahead) > workers + 1:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()
        finally:
            for waiting in ahead:
                waiting.cancel()


def _survey(
    rows: Rows, settings: FileSettings, workers: int
) -> tuple[Bool[Tensor, " n"], Float32[Tensor, " d"], Float32[Tensor, " d"], Int64[Tensor, " m"]]:
    """Which primitives keep their rest, the lattice of what is kept, and, if sorted, the order."""
    count, dims = len(rows), 3 * (rows.bands - 1)
    gate = torch.zeros(count, dtype=torch.bool)
    corners, ends = [], []
    zero = (torch.zeros(dims), torch.zeros(dims))

    def look(first: int) -> None:
        part = rows.take(slice(first, first + CHUNK), ("means", "sh"))
        means = part["means"].float()
        if not bool(torch.stack(means.aminmax()).isfinite().all()):  # a nan is both ends
            raise DataError("positions are not all finite in float32: clean or shift the model")
        if not bool(torch.stack(part["sh"].aminmax()).isfinite().all()):
            raise DataError("SH coefficients are not all finite: clean the model first")
        rest = part["sh"][:, 1:]
        kept = spectral.open_gate(rest, settings.gate, settings.weighting)
        gate[first : first + CHUNK] = kept
        held = rest if bool(kept.all()) else rest[kept]
        low, high = held.reshape(-1, dims).aminmax(dim=0) if len(held) and dims else zero
        if len(held) < len(rest):  # gated ones count as 0, as in the reference
            low, high = low.clamp(max=0), high.clamp(min=0)
        ends.append(torch.stack([low, high]))
        corners.append(torch.stack([means.amin(dim=0), means.amax(dim=0)]))

    for _ in in_order(look, range(0, count, CHUNK), workers):
        pass
    low, reach = lattice(torch.cat(ends)) if ends else (torch.zeros(dims), torch.zeros(dims))
    order = torch.zeros(0, dtype=torch.int64)
    if settings.sort and count:
        box = torch.stack(corners)
        bounds = box[:, 0].amin(dim=0), box[:, 1].amax(dim=0)
        codes = torch.empty(count, dtype=torch.int64)
        for first in range(0, count, CHUNK):
            part = rows.take(slice(first, first + CHUNK), ("means",))
            codes[first : first + CHUNK] = morton_codes(part["means"].float(), *bounds)
        order = torch.from_numpy(codes.numpy().argsort(kind="stable"))
    return gate, low, reach, order


def _chunk(
    part: Mapping[str, Tensor],
    kept: Bool[Tensor, " n"],
    low: Float32[Tensor, " d"],
    reach: Float32[Tensor, " d"],
    settings: FileSettings,
) -> list[bytes]:
    """The streams of one chunk, in the order of PARTS."""
    rest = part["sh"][:, 1:].flatten(start_dim=1)
    steps = rest[kept].double() if not bool(kept.all()) else rest.double()
    divisor = torch.where(reach > 0, reach.double(), torch.inf)  # r = 0 stores the constant m
    steps.sub_(low).mul_(STEPS).div_(divisor)
    whole = steps.round_() if settings.rounding == "nearest" else steps.floor_()
    arrays = (
        part["means"].float(),
        half("opacity logit", part["opacity_logits"])[:, None],
        half("rotation", functional.normalize(part["quaternions"], dim=-1)),
        half("log scale", part["log_scales"]),
        half("SH DC", part["sh"][:, 0]),
        torch.from_numpy(np.packbits(kept.numpy()))[:, None],
        whole.clamp_(0, STEPS).to(torch.uint8),
    )
    return [squeeze(a.numpy(), settings.entropy, planes=settings.planes) for a in arrays]
