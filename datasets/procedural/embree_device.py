"""Embree with the kernels of one instruction set, so that a world's photos are the same on every machine."""

import ctypes
import inspect
import platform

from embreex.rtcore import EmbreeDevice

WIDEST = b"max_isa=avx2"
"""Embree's configuration: nothing wider than AVX2, which nearly every x86 processor of today has. Kernels of
AVX-512 round other last bits, and rays that graze an edge then meet another triangle: of the aerial world town every
photo was another one."""


class HeldDevice(ctypes.Structure):
    """An EmbreeDevice as its package declares it for Cython (rtcore.pxd): a pointer behind what every object has."""

    _fields_ = (("head", ctypes.c_char * object.__basicsize__), ("device", ctypes.c_void_p))


def narrow_device() -> EmbreeDevice:
    """A device of WIDEST, to build scenes with; with a narrower instruction set where the processor has no AVX2.

    The package makes devices without any configuration, so the one that it made is exchanged. Where its objects hold
    something else besides, and on processors that are not x86, it is left as it is.
    """
    made = EmbreeDevice()
    x86 = platform.machine().lower() in ("x86_64", "amd64")
    if not x86 or EmbreeDevice.__basicsize__ != ctypes.sizeof(HeldDevice):
        return made
    library = ctypes.CDLL(inspect.getfile(EmbreeDevice))  # and what it depends on: Embree itself
    library.rtcNewDevice.restype = ctypes.c_void_p
    library.rtcReleaseDevice.argtypes = [ctypes.c_void_p]
    chosen = library.rtcNewDevice(WIDEST)
    if chosen:
        held = HeldDevice.from_address(id(made))
        library.rtcReleaseDevice(held.device)
        held.device = chosen
    return made
