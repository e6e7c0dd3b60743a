"""Threads that torch lends to the kernels, and takes back."""

import pytest
import torch

from splatproof import _ext
from splatproof.methods.kernels.threads import lent, use_threads


@pytest.fixture(autouse=True)
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


def kernel_threads() -> int:
    use_threads()
    return _ext.threads()


def test_kernels_have_as_many_as_torch():
    assert kernel_threads() == 3
    torch.set_num_threads(2)
    assert kernel_threads() == 2


def test_torch_leaves_all_but_one_to_them_inside():
    with lent():
        assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
        with lent():  # as where a step calls what lends, too
            assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
        assert (torch.get_num_threads(), kernel_threads()) == (1, 3)
    assert (torch.get_num_threads(), kernel_threads()) == (3, 3)


def test_they_are_given_back_after_an_error():
    with pytest.raises(RuntimeError), lent():
        raise RuntimeError
    assert (torch.get_num_threads(), kernel_threads()) == (3, 3)
