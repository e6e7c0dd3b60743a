"""Worlds have the same pixels whichever processor's way of multiplying matrices a library takes."""

import os
import subprocess
import sys

import pytest

from helpers import world_pixels
from splatproof.methods.training.threads import threads

PLAIN = {"MKL_CBWR": "COMPATIBLE", "OPENBLAS_CORETYPE": "Haswell"}
FUSED = {"MKL_CBWR": "AVX2", "OPENBLAS_CORETYPE": "Haswell"}
"""What the libraries take on another processor: without and with fused multiplications, and without AVX-512."""


def in_mode(mode: dict[str, str]) -> list[str]:
    """The hashes from a start of python with all imports, which alone makes the libraries look at their mode."""
    done = subprocess.run(
        [sys.executable, "-P", world_pixels.__file__],
        env=os.environ | mode | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout.split()


@pytest.fixture(scope="module")
def here() -> list[str]:
    """The hashes as this processor makes them."""
    with threads(1):
        return world_pixels.hashes()


@pytest.mark.parametrize(
    "mode", [PLAIN, pytest.param(FUSED, marks=pytest.mark.slow)], ids=("plain", "fused")
)
def test_pixels_do_not_depend_on_the_libraries_kernels(here, mode):
    assert len(here) == 12
    assert in_mode(mode) == here
