"""Whether the kernels of small networks may read some tensors, and a way to do without these kernels."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

_by_torch = False
"""Whether networks are left to their twins in torch."""


def readable(tensors: Iterable[Tensor]) -> bool:
    """Whether all of some tensors are float32 on the CPU; False wherever torch is to compute.

    Args:
        tensors: What kernels would read.
    """
    return not _by_torch and all(
        t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors
    )


@contextmanager
def by_torch() -> Iterator[None]:
    """Inside, decoding, attention, colour head and consistency step are those of torch, whatever the tensors.

    Studies compare a method with itself so. It holds for the whole process.
    """
    global _by_torch
    before, _by_torch = _by_torch, True
    try:
        yield
    finally:
        _by_torch = before
