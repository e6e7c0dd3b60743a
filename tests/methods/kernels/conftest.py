"""Kernels are tested in two threads, also where a worker of pytest-xdist has only one, and at each SIMD level."""

import pytest
import torch

from splatproof import _ext


@pytest.fixture(autouse=True)
def _two_threads():
    """Two threads share a picture: what they would do to each other's pixels is seen."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.fixture(params=_ext.simd_levels())
def simd_level(request):
    """Each level that this machine has, in use for the test."""
    before = _ext.simd_level()
    _ext.set_simd_level(request.param)
    yield request.param
    _ext.set_simd_level(before)
