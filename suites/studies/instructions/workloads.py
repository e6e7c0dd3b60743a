"""Small seeded pieces of kernel work, run as a script under `valgrind --tool=callgrind`.

    python -s -S -P workloads.py PATH/OF/_ext.so

Imports nothing but the standard library and the compiled module: torch alone would take minutes under
valgrind. Each piece runs once unmeasured, which fills its buffers, and once between two calls of
`os.getppid`, at which callgrind is told to write down what it has counted (--dump-before=getppid).
On stdout goes one line of JSON a piece: its name and what it worked on.
"""

import ctypes
import importlib.util
import json
import os
import sys
from array import array
from collections.abc import Callable, Iterator
from math import prod
from random import Random
from types import ModuleType
from typing import Any, Literal

WIDTH, HEIGHT = 96, 64
"""Pixels of the images: 24 tiles."""
GAUSSIANS, ANCHORS = 600, 120
K, FEATURES, HIDDEN = 5, 16, 16
"""Gaussians an anchor, features of an anchor, and width of the networks' hidden layers."""


def zeros(*shape: int, kind: Literal["f", "d", "q"] = "f") -> memoryview:
    """Zeros, as the kernels take them.

    Args:
        shape: Length of each axis.
        kind: Type code of module array.
    """
    found: Any = memoryview(bytearray(array(kind).itemsize * prod(shape))).cast(kind, shape)
    return found


def zeros_like(values: memoryview) -> memoryview:
    """Float32 zeros of another array's shape."""
    assert values.shape is not None
    return zeros(*values.shape)


def address(values: memoryview) -> int:
    """Where an array lies in memory.

    Args:
        values: One that outlives what is done with its address.
    """
    return ctypes.addressof(ctypes.c_char.from_buffer(values.cast("B")))


def filled(values: memoryview, draw: Callable[[], float]) -> memoryview:
    """The array itself, with every number drawn anew.

    Args:
        values: Array that is written to.
        draw: Gives the next number.
    """
    kind: Any = values.format
    flat = values.cast("B").cast(kind)
    for i in range(len(flat)):
        flat[i] = draw()
    return values


def matrix(rows: list[list[float]]) -> memoryview:
    """A float64 matrix."""
    numbers = (x for row in rows for x in row)
    return filled(zeros(len(rows), len(rows[0]), kind="d"), lambda: next(numbers))


class Scene:
    """Seeded Gaussians before a camera, and a photo that they do not match."""

    def __init__(self, ext: Any) -> None:
        """Draw everything.

        Args:
            ext: The compiled module.
        """
        random, n = Random(1), GAUSSIANS
        self.raw = {
            "means": filled(zeros(n, 3), lambda: random.uniform(-1, 1)),
            "quaternions": filled(zeros(n, 4), lambda: random.gauss(0, 1)),
            "log_scales": filled(zeros(n, 3), lambda: random.uniform(-3.2, -2.0)),
            "opacity_logits": filled(zeros(n), lambda: random.uniform(-2, 2)),
            "sh_dc": filled(zeros(n, 1, 3), lambda: random.gauss(0, 0.5)),
            "sh_rest": filled(zeros(n, 3, 3), lambda: random.gauss(0, 0.1)),
        }
        self.gradients = {name: zeros_like(value) for name, value in self.raw.items()}
        self.moments = [[zeros_like(value) for value in self.raw.values()] for _ in range(2)]
        self.photo = filled(zeros(HEIGHT, WIDTH, 3), random.random)
        intrinsics = [[80.0, 0.0, WIDTH / 2], [0.0, 80.0, HEIGHT / 2], [0.0, 0.0, 1.0]]
        pose = [[float(i == j) for j in range(4)] for i in range(4)]
        pose[2][3] = 3.0
        self.camera = (matrix(intrinsics), matrix(pose), WIDTH, HEIGHT, 0.01)
        self.model = ext.Model(
            *list(self.raw.values())[:4],
            None,
            self.raw["sh_dc"],
            4,
            True,
            False,
            self.raw["sh_rest"],
        )
        self.flat = [zeros(HEIGHT, WIDTH) for _ in range(2)]
        self.image = zeros(HEIGHT, WIDTH, 3)
        self.radii, self.screen = zeros(n), zeros(n, 2)


def pieces(ext: Any) -> Iterator[tuple[str, Callable[[], None], dict[str, int]]]:
    """Name, work, and numbers of what is worked on.

    Args:
        ext: The compiled module.
    """
    scene = Scene(ext)
    none = (None,) * 5

    def render() -> Any:
        return ext.render(
            scene.model, *scene.camera, None, scene.image, *scene.flat, scene.radii, *none
        )

    def step() -> None:
        ext.step(
            scene.model, *scene.camera, None, scene.photo, None, 0.2, *scene.gradients.values(),
            scene.screen, None, scene.radii,
        )  # fmt: skip

    def loss() -> None:
        ext.photometric(scene.image, scene.photo, None, 0.2, gradient)

    def adam() -> None:
        ext.adam(*places, lengths, sizes, rates, 1, 0.9, 0.999, 1e-15, None)

    values, by = list(scene.raw.values()), list(scene.gradients.values())
    places = [[address(one) for one in many] for many in (values, by, *scene.moments)]
    lengths, sizes = [len(one) for one in values], [one.nbytes // 4 for one in values]
    rates = [1e-3] * len(values)
    gradient = zeros(HEIGHT, WIDTH, 3)
    size = {"gaussians": GAUSSIANS, "pixels": WIDTH * HEIGHT}
    size["pairs"] = render().pairs
    yield "render", render, size
    yield "photometric loss", loss, {"pixels": WIDTH * HEIGHT}
    yield "training step", step, size
    yield "adam", adam, {"gaussians": GAUSSIANS}
    yield anchor_decoding(ext)


def anchor_decoding(ext: Any) -> tuple[str, Callable[[], None], dict[str, int]]:
    """Anchors decoded to Gaussians, and the gradients of all of them.

    Args:
        ext: The compiled module.
    """
    random = Random(2)

    def normal() -> float:
        return random.gauss(0, 0.5)

    stored = [
        filled(zeros(ANCHORS, 3), normal), filled(zeros(ANCHORS, K, 3), normal),
        filled(zeros(ANCHORS, FEATURES), normal), filled(zeros(ANCHORS, 6), normal),
    ]  # fmt: skip
    networks = [
        filled(zeros(*shape), normal)
        for outputs in (K, 7 * K, 3 * K)
        for shape in ((FEATURES + 3, HIDDEN), (HIDDEN,), (HIDDEN, outputs), (outputs,))
    ]
    centre = zeros(3)
    anchors = ext.Anchors(*stored, None, centre, False, False, networks)
    by_stored = [zeros_like(value) for value in stored]
    by_networks = [zeros_like(value) for value in networks]
    count = ext.open_anchors(anchors).count
    made = [zeros(count, 3), zeros(count, 4), zeros(count, 3), zeros(count), zeros(count, 3)]
    by_made = [filled(zeros_like(value), normal) for value in made]
    rows, slots = zeros(count, kind="q"), zeros(count, kind="q")

    def decode() -> None:
        state = ext.open_anchors(anchors)
        ext.fill_anchors(state, anchors, *made, rows, slots)
        _, quaternions, scales, _, colours = made
        ext.decode_backward(
            state, anchors, quaternions, scales, colours, *by_made, *by_stored, by_networks
        )

    return "anchor decoding", decode, {"anchors": ANCHORS, "gaussians": count}


def load(path: str) -> ModuleType:
    """The compiled module of that file, without the package around it."""
    spec = importlib.util.spec_from_file_location("_ext", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    """Run all pieces, each between two marks, and say what they were."""
    ext: Any = load(sys.argv[1])
    ext.set_threads(1)
    told = [{"simd": ext.simd_level(), "compiler": ext.compiler()}]
    for name, work, size in pieces(ext):
        work()
        os.getppid()
        work()
        os.getppid()
        told.append({"workload": name, **size})
    print("\n".join(map(json.dumps, told)))


if __name__ == "__main__":
    main()
