"""Small runs give the bytes that they gave before the trainer became one for all models.

The hashes were first written down from the code before that change, and again when the reference came
to invert covariances by their exact determinant: it draws the scene's photos, which changed in their last
bits (with the inverse of before, all hashes were the old ones). They hold for the portable kernels and
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
    "3dgs plain cpu": "e1294a57dbc81cbe9a0185486f5e62c83d87df63ff9bda87c2a5ba5bb9974c7e",
    "3dgs degree 3 cpu": "331469dc41098ca0d3383803bab20e45bdf5be1c480a64d853fe4e353c4519bf",
    "3dgs several views cpu": "21dcf1002f2c1d9449c042e1601dbe0c90a91d409c866aeeafe28494796f690d",
    "3dgs plain reference": "f93c717b225a232e18cf7e6d98ce149af08f8d779ef6c3370ebd108ae8b4d8de",
    "3dgs degree 3 reference": "2b3669e37a52d2c198a594535570d9cedc00bfe9004a68ae6f1c8bc33808f36e",
    "3dgs several views reference": "98a207d38bf14cce178a490cce0b51d49ea829d684470bde566d274f2ffec334",
    "odbp+stitch": "eedf0c874e2863e99f5f8f4240bd08a11461663fdab8722fd85445bba77a7450",
    "citygaussian": "12759f50fb42af2c6fc94303c2f51fb10ed9aff3cb3c7d5a863102e114066e99",
    "stitchgs": "2c596a530b6668240b1d09104eaa85be9649d7e121940b0340cc2d669de72b77",
    "dpgs-partition": "dd12112878d943c88f8a81da1d1db802e116c121f9d31c40cc14ccbd94864d62",
    "odbp+stitch sgd": "1e183707e5a188eba3f20bc381b42005eaced8c3b1f16c087d0f8b696a7601cd",
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
