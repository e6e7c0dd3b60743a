"""From a model to a file's bytes and back: what each way of packing keeps."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.storage.packed.reader import read_packed
from splatproof.methods.storage.packed.writer import FileSettings, write_packed
from splatproof.reference.compression import container, packing
from splatproof.reference.compression.packing import PackSettings
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.twins.twin import Case, Component, Leaves, Problem, Size, Twin, functional


def model(size: Size) -> Problem:
    """Random Gaussians of degree 3; the value is all their numbers after the way there and back."""
    draw = torch.Generator().manual_seed(size[0])
    shapes = {"means": (3,), "quaternions": (4,), "log_scales": (3,), "opacity_logits": (),
              "sh": (16, 3)}  # fmt: skip
    leaves = {n: torch.randn(size[0], *s, generator=draw) for n, s in shapes.items()}
    leaves["quaternions"] /= leaves["quaternions"].norm(dim=1, keepdim=True)
    leaves["sh"][:, 1:] *= 0.1
    return Problem(leaves=leaves)


def numbers(g: Gaussians) -> Tensor:
    """All numbers of a model in one row each, [n, 59]."""
    rows = (g.means, g.quaternions, g.log_scales, g.opacity_logits[:, None], g.sh.flatten(1))
    return torch.cat(rows, dim=1)


def untouched(leaves: Leaves, _: Mapping[str, Any]) -> Tensor:
    """The model as it is.

    Args:
        leaves: Inputs by name; outputs depend on them.
        _: Everything else of the problem, by name; not needed here.
    """
    return numbers(Gaussians(**leaves))


def returns(settings: PackSettings, kind: container.Packing) -> Callable[..., Any]:
    """`start` of packing, writing, reading and unpacking.

    Args:
        settings: How the model is packed.
        kind: How the file is written.
    """

    def call(leaves: Leaves, _: Mapping[str, Any]) -> Tensor:
        data = container.encode(packing.pack(Gaussians(**leaves), settings), kind)
        return numbers(packing.unpack(container.decode(data)))

    return functional(call)


def streams(settings: FileSettings) -> Callable[..., Any]:
    """`start` of writing and reading a file in chunks."""

    def call(leaves: Leaves, _: Mapping[str, Any]) -> Tensor:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model"
            write_packed(path, Gaussians(**leaves), settings=settings)
            return numbers(read_packed(path)[0])

    return functional(call)


HALF = "half precision, 8-bit harmonics"
PACKING = Component(
    name="packing",
    problem=model,
    reference=Twin(name="unpacked float64", start=functional(untouched), dtype=torch.float64),
    twins=(
        Twin(name="file, 8 bit, zstd", approximates=HALF,
             start=streams(FileSettings(gate=0.0, sort=False))),
        Twin(name="8 bit, zstd", start=returns(PackSettings(gate=0.0), "zstd"), approximates=HALF),
        Twin(name="8 bit, plain", start=returns(PackSettings(gate=0.0), "none"), approximates=HALF),
        Twin(name="8 bit, gated", start=returns(PackSettings(), "zstd"),
             approximates=f"{HALF}, weak harmonics dropped"),
        Twin(name="8 bit, truncated", approximates=f"{HALF} that are rounded down",
             start=returns(PackSettings(gate=0.0, rounding="truncate"), "zstd")),
    ),
    usual="file, 8 bit, zstd", judged=(2_000,), tiny=(40,),
    cases=(Case(size=(10_000,), quick=True), Case(size=(100_000,))),
)  # fmt: skip
