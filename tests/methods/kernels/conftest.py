"""Kernels are tested in two threads, also where a worker of pytest-xdist has only one."""

import pytest
import torch


@pytest.fixture(autouse=True)
def _two_threads():
    """Two threads share a picture: what they would do to each other's pixels is seen."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)
