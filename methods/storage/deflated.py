"""Deflated bytes inside of safetensors: for arrays that repeat themselves, as block numbers do."""

import zlib

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor


def deflated(values: UInt8[Tensor, "*n"]) -> UInt8[Tensor, " m"]:
    """The bytes of a tensor, deflated.

    Args:
        values: In row-major order; their shape is not stored.
    """
    packed = zlib.compress(values.contiguous().numpy().tobytes(), level=9)
    return torch.from_numpy(np.frombuffer(packed, dtype=np.uint8).copy())


def inflated(packed: UInt8[Tensor, " m"], count: int) -> UInt8[Tensor, " n"]:
    """The bytes that `deflated` was given, in one row.

    Args:
        packed: What it returned.
        count: How many bytes that were; no more are unpacked.

    Raises: ValueError if they are damaged, cut short or of another number.
    """
    if packed.dtype != torch.uint8 or packed.ndim != 1:
        raise ValueError(f"deflated bytes of type {packed.dtype} and shape {tuple(packed.shape)}")
    if count < 0:
        raise ValueError(f"{count} bytes")
    stream = zlib.decompressobj()
    try:
        values = stream.decompress(packed.numpy().tobytes(), count + 1)
    except (zlib.error, OverflowError) as error:
        raise ValueError(f"damaged deflated bytes ({error})") from None
    if len(values) != count or not stream.eof or stream.unused_data:
        raise ValueError(f"deflated bytes that are not {count} whole ones")
    return torch.from_numpy(np.frombuffer(values, dtype=np.uint8).copy())
