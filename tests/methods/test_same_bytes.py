"""Small runs give the bytes that they gave before the trainer became one for all models.

The hashes were written down from the code before that change. They hold for the portable kernels and
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
    "3dgs plain cpu": "426b36e5651e396e393550254f247e68b1be7a33b79627803436e4ed3784fbc6",
    "3dgs degree 3 cpu": "15020235153471b7e1fc22a2b8fbf6071d61f191996de139209fd87256dbcfc9",
    "3dgs several views cpu": "1e0283218042258f9732fa14a61ce7005c42ecfb7c2fa4f707c3ea876b1870d5",
    "3dgs plain reference": "09be80ffb571cff684f28a150ff6c8da3f0fadb0d8fdd6e9a88e8adbc82f3a84",
    "3dgs degree 3 reference": "e92daca420c17be271f2f39013324e44ab17ea53d3a0669d2c0353005971566f",
    "3dgs several views reference": "768879790905e0df555c9ce13c6395e3bceb7f5a2d6ffbca50fb127b5b6b00d2",
    "odbp+stitch": "b21bbc7f812e7e94f87e13258694c1c03e228907841701ea646e6439eb77e4fe",
    "citygaussian": "d3233905b7788e865959f006b2c84bf456cabbbfc245be1eeb72fcec24ad16f0",
    "stitchgs": "bd1807e3ae877905a5cffa0273fb2d33bd5cb5407afbe9bf213139f771305077",
    "dpgs-partition": "a23846fe3a9faf3b7a9628acad798e77d1fe002ef392305a3d71f51f7afc6175",
    "odbp+stitch sgd": "9d3ee036fd59b5b84104c2aa0bd81953afbcffd9cde65defa2b0ac59e1628209",
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
