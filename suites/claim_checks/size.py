"""Bytes of a trained model in our packed file against other formats, and what packing costs."""

import functools
import tempfile
import time
from pathlib import Path
from typing import Any

from splatproof.base.errors import MissingError
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.claim_checks.check import Check, Measurement
from splatproof.suites.claim_checks.trained import PROTOCOL, fit, scene
from splatproof.suites.studies import size
from splatproof.suites.studies.size_formats import formats

STEPS, QUICK_STEPS = 1000, 60
OURS = "standard"
"""Name of our packed file as it is written by default, in the study of sizes."""
READS, QUICK_READS = 15, 3
"""How often a file is read; 15 enclose the median by the 4th and the 12th."""


@functools.cache
def model(steps: int) -> ExplicitModel:
    """The model that every format stores.

    Args:
        steps: Number of its training steps.
    """
    found = fit("3dgs", steps, Run(), {})
    assert isinstance(found, ExplicitModel)
    return found


@functools.cache
def quality(steps: int) -> float:
    """PSNR of the model that every format stores, in dB on held-out views.

    Args:
        steps: Number of its training steps.
    """
    fitted = model(steps)
    return size.quality(scene(), fitted, fitted.model, load_protocol(PROTOCOL))["psnr"]


@functools.cache
def row(name: str, reduced: bool) -> dict[str, Any]:
    """Bytes a Gaussian and PSNR lost of one format of the study of sizes.

    Args:
        name: Name of the format there.
        reduced: Whether the model is trained for fewer steps.
    Raises: MissingError for a format that this machine cannot write.
    """
    kind = next(one for one in formats() if one.name == name)
    steps, protocol = QUICK_STEPS if reduced else STEPS, load_protocol(PROTOCOL)
    with tempfile.TemporaryDirectory(prefix="splatproof-") as folder:
        written = Path(folder) / "model"
        found = size.row(kind, scene(), model(steps), quality(steps), protocol, written)
    if "bytes" not in found:
        raise MissingError(str(found["note"]))
    return found


def smaller(than: str, reduced: bool, folder: Path) -> Measurement:
    """How many times as large the other format's file is.

    Args:
        than: Name of the other format in the study of sizes.
        reduced: See `row`.
        folder: Not looked at.
    """
    del folder
    ours, other = (row(name, reduced) for name in (OURS, than))
    return Measurement(
        values=(other["bytes_each"] / ours["bytes_each"],),
        compared=f"{than} {other['bytes_each']:.1f} over {ours['bytes_each']:.1f} bytes a Gaussian, "
        f"{ours['primitives']:,} Gaussians",
    )


def lost(reduced: bool, folder: Path) -> Measurement:
    """PSNR in dB that the packed file's model has less than the trained one on held-out views.

    Args:
        reduced: See `row`.
        folder: Not looked at.
    """
    del folder
    ours = row(OURS, reduced)
    return Measurement(
        values=(-ours["psnr_change"],),
        compared=f"held-out views of {ours['primitives']:,} Gaussians, before and after packing",
    )


def loss_beside(other: str, reduced: bool, folder: Path) -> Measurement:
    """PSNR in dB by which our file's model is above the other format's.

    Args:
        other: Name of the other format in the study of sizes.
        reduced: See `row`.
        folder: Not looked at.
    """
    del folder
    ours, theirs = (row(name, reduced) for name in (OURS, other))
    return Measurement(
        values=(ours["psnr_change"] - theirs["psnr_change"],),
        compared=f"loss {ours['psnr_change']:+.2f} dB, {other} {theirs['psnr_change']:+.2f} dB",
    )


def decoded(name: str, reduced: bool, folder: Path) -> Measurement:
    """Millions of Gaussians that a second of processor time decodes; threads share it out among them.

    Args:
        name: Name of the format in the study of sizes.
        reduced: See `row`; and fewer repetitions.
        folder: Where the file goes.
    """
    kind = next(one for one in formats() if one.name == name)
    gaussians, path = model(QUICK_STEPS if reduced else STEPS).model, folder / "model"
    kind.write(path, gaussians)
    kind.read(path)  # warm
    values = []
    for _ in range(QUICK_READS if reduced else READS):
        start = time.process_time()
        kind.read(path)
        values.append(len(gaussians) / (time.process_time() - start) / 1e6)
    return Measurement(
        values=tuple(values),
        compared=f"{name}, {len(gaussians):,} Gaussians, processor time of all threads",
    )


SIZE = {
    "packed_over_ply": Check(
        measure=functools.partial(smaller, "ply"), unit="times", seconds=(25.0, 5.0)
    ),
    "packed_over_spz": Check(
        measure=functools.partial(smaller, "spz 4"), unit="times", seconds=(5.0, 2.0)
    ),
    "packed_over_sog": Check(
        measure=functools.partial(smaller, "sog"), unit="times", seconds=(12.0, 2.0)
    ),
    "packed_loss": Check(measure=lost, unit="dB", seconds=(5.0, 2.0)),
    "packed_above_spz": Check(
        measure=functools.partial(loss_beside, "spz 4"), unit="dB", seconds=(5.0, 2.0)
    ),
    "packed_decode": Check(
        measure=functools.partial(decoded, OURS), unit="million a second", seconds=(5.0, 2.0)
    ),
    "packed_decode_fast": Check(
        measure=functools.partial(decoded, "fast"), unit="million a second", seconds=(3.0, 1.0)
    ),
}
