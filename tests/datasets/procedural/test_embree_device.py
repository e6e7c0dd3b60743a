"""Embree takes no wider kernels than those that nearly every processor has."""

import ctypes
import inspect
import platform

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

from splatproof.datasets.procedural import embree_device, tracing, worlds
from splatproof.datasets.procedural.embree_device import narrow_device

NATIVE = {4: 32, 8: 33, 16: 34}
"""Embree's numbers (rtcore_device.h) of the properties that say whether a device traces so many rays in a register."""


def rays_in_a_register(device: EmbreeDevice) -> set[int]:
    """Widths that the device's kernels have: 8 asks for AVX, 16 for AVX-512."""
    library = ctypes.CDLL(inspect.getfile(EmbreeDevice))
    library.rtcGetDeviceProperty.argtypes = [ctypes.c_void_p, ctypes.c_int]
    library.rtcGetDeviceProperty.restype = ctypes.c_ssize_t
    pointer = embree_device.HeldDevice.from_address(id(device)).device
    return {width for width, name in NATIVE.items() if library.rtcGetDeviceProperty(pointer, name)}


@pytest.fixture(autouse=True)
def on_x86():
    """What is asked of Embree has names on such processors alone."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        pytest.skip("Embree's instruction sets are x86's here")


def test_a_device_has_what_the_processor_has_but_avx512():
    assert rays_in_a_register(narrow_device()) == rays_in_a_register(EmbreeDevice()) - {16}


@pytest.mark.parametrize(("widest", "widths"), [(b"max_isa=sse2", {4}), (b"max_isa=avx", {4, 8})])
def test_the_configuration_is_heeded(monkeypatch, widest, widths):
    monkeypatch.setattr(embree_device, "WIDEST", widest)
    assert rays_in_a_register(narrow_device()) == widths & rays_in_a_register(EmbreeDevice())


def test_scenes_outlive_the_name_of_their_device_and_are_released():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float32)
    start, way = np.array([[0.2, 0.2, 1], [2, 2, 1]]), np.array([[0, 0, -1], [0, 0, -1]])
    for _ in range(50):
        scene = EmbreeScene(device=narrow_device())
        TriangleMesh(scene, corners, np.array([[0, 1, 2]], dtype=np.int32))
        assert scene.run(start.astype(np.float32), way.astype(np.float32)).tolist() == [0, -1]


def test_objects_of_another_shape_are_left_as_they_are(monkeypatch):
    class Larger(EmbreeDevice):
        __slots__ = ("more",)

    monkeypatch.setattr(embree_device, "EmbreeDevice", Larger)
    monkeypatch.setattr(embree_device, "WIDEST", b"max_isa=sse2")
    assert rays_in_a_register(narrow_device()) == rays_in_a_register(EmbreeDevice())


def test_on_other_processors_it_is_left_as_it_is(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(embree_device, "WIDEST", b"max_isa=sse2")
    assert rays_in_a_register(narrow_device()) == rays_in_a_register(EmbreeDevice())


def test_worlds_are_traced_with_it(monkeypatch):
    made = []
    monkeypatch.setattr(tracing, "narrow_device", lambda: made.append(narrow_device()) or made[-1])
    plan = worlds.plan("courtyard", "small", 0)
    plan.stage(plan.shots[0])
    assert made
