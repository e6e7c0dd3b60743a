"""Small runs give the bytes that they gave before the trainer became one for all models.

The hashes were first written down from the code before that change, and again when the reference came
to invert covariances by their exact determinant: it draws the scene's photos, which changed in their last
bits (with the inverse of before, all hashes were the old ones). A third time when the kernels came to draw
four Gaussians in step and to compare images in strips, which sums in another order (with the kernels of before,
all hashes were the old ones). They hold for the portable kernels and
torch's default instructions, in a process of its own, with the pinned torch: another one may round
differently.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from helpers import small_runs

TORCH = "2.13.0"
BEFORE = {
    "3dgs plain cpu": "5dd9899ddf669b9b26ddc3f514463750842ab5881732c3e4f43c446d1790785f",
    "3dgs degree 3 cpu": "c89012bd32c230897591dbd3dd154d3ef75a94ca2f44dac2a1dd82f13dd36d88",
    "3dgs several views cpu": "a573836a756fe09f35caef3e78a6e784394d748e2e1e266751902d4654a39949",
    "3dgs plain reference": "b198e75fb96e47430956d5a4ab6046ef6f09d251e9e9c72c49665121e0940aa5",
    "3dgs degree 3 reference": "05bfcfb241854171cd559450d2940fbb2a863e4f9ec7cf0919448b2134937ef3",
    "3dgs several views reference": "6dbc5d6e96966083ca55691c0c5b9dd972f789c5a14981befcaef79c6517d258",
    "odbp+stitch": "e7549a15a336951c97e005ad3bc3625bf84e904b6d0a5cd0d2ad82e84750b55b",
    "citygaussian": "88257898c0a478d5d30feaefaa908ed63310e1618b915c6beb13be1f86fd2f15",
    "stitchgs": "437bde2dc537df513eab3f0152ea54ef1de4ccb010665503dc97d809c6475b4d",
    "dpgs-partition": "227d5cdf8072e325f7a9c568e80a8d922478015fb51a98025175710434b31878",
    "odbp+stitch sgd": "3d922ec3a16300a7f917ff9d8b810c2c6d29664feebedc4fe151d714d7b39b00",
}


@pytest.fixture(scope="module")
def now() -> dict[str, str]:
    """Hashes of all runs, made with kernels and torch at their lowest level."""
    process = subprocess.run(
        [sys.executable, "-P", str(Path(small_runs.__file__))],
        env=os.environ | {
            "SPLATPROOF_SIMD": "portable", "ATEN_CPU_CAPABILITY": "default",
            "PYTHONPATH": str(Path(__file__).parents[1]),
        },
        capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip
    return dict(line.split("\t") for line in process.stdout.splitlines())


@pytest.mark.skipif(
    torch.__version__.split("+")[0] != TORCH, reason=f"the hashes were made with torch {TORCH}"
)
@pytest.mark.parametrize("run", BEFORE)
def test_the_model_is_the_same_to_the_bit(now, run):
    assert now[run] == BEFORE[run]


def test_another_seed_gives_another_hash():
    same, other = (small_runs.threedgs("plain", "cpu", seed) for seed in (3, 4))
    assert same == small_runs.threedgs("plain", "cpu", 3)
    assert same != other
