"""Small seeded pieces of kernel work, run as a script under `valgrind --tool=callgrind`.

    python -s -S -P workloads.py PATH/OF/_ext.so

Imports nothing but the standard library and the compiled module: torch alone would take minutes under
valgrind. Each piece runs once unmeasured, which fills its buffers, and once between two calls of
`os.getppid`, at which callgrind is told to write down what it has counted (--dump-before=getppid).
On stdout goes one line of JSON a piece: its name and what it worked on.
"""

import importlib.util
import json
import os
import sys
from array import array
from collections.abc import Callable, Iterator
from math import prod
from random import Random
from types import ModuleType
from typing import Any

WIDTH, HEIGHT = 96, 64
"""Pixels of the images: 24 tiles."""
GAUSSIANS, ANCHORS = 600, 120
K, FEATURES, HIDDEN = 5, 16, 16
"""Gaussians an anchor, features of an anchor, and width of the networks' hidden layers."""


def floats(*shape: int, draw: Callable[[], float] = float) -> memoryview:
    """Float32 numbers of a shape that the kernels take: zeros, or what `draw` gives."""
    return _shaped(array("f", (draw() for _ in range(prod(shape)))), "f", shape)


def doubles(rows: list[list[float]]) -> memoryview:
    """A float64 matrix."""
    return _shaped(array("d", sum(rows, [])), "d", (len(rows), len(rows[0])))


def integers(count: int) -> memoryview:
    """Int64 zeros."""
    return memoryview(array("q", [0] * count))


def _shaped(values: array, kind: str, shape: tuple[int, ...]) -> memoryview:
    return memoryview(values).cast("B").cast(kind, shape)


class Scene:
    """Seeded Gaussians before a camera, and a photo that they do not match."""

    def __init__(self, ext: Any) -> None:
        """Draw everything.

        Args:
            ext: The compiled module.
        """
        random, n = Random(1), GAUSSIANS
        self.raw = {
            "means": floats(n, 3, draw=lambda: random.uniform(-1, 1)),
            "quaternions": floats(n, 4, draw=lambda: random.gauss(0, 1)),
            "log_scales": floats(n, 3, draw=lambda: random.uniform(-3.2, -2.0)),
            "opacity_logits": floats(n, draw=lambda: random.uniform(-2, 2)),
            "sh_dc": floats(n, 1, 3, draw=lambda: random.gauss(0, 0.5)),
            "sh_rest": floats(n, 3, 3, draw=lambda: random.gauss(0, 0.1)),
        }
        self.gradients = {name: floats(*value.shape) for name, value in self.raw.items()}
        self.moments = [
            [floats(*value.shape) for value in self.raw.values()] for _ in range(2)
        ]
        self.photo = floats(HEIGHT, WIDTH, 3, draw=random.random)
        intrinsics = [[80.0, 0.0, WIDTH / 2], [0.0, 80.0, HEIGHT / 2], [0.0, 0.0, 1.0]]
        pose = [[float(i == j) for j in range(4)] for i in range(4)]
        pose[2][3] = 3.0
        self.camera = (doubles(intrinsics), doubles(pose), WIDTH, HEIGHT, 0.01)
        self.model = ext.Model(
            *list(self.raw.values())[:4], None, self.raw["sh_dc"], 4, True, False, self.raw["sh_rest"]
        )
        self.flat = [floats(HEIGHT, WIDTH) for _ in range(2)]
        self.image = floats(HEIGHT, WIDTH, 3)
        self.radii, self.screen = floats(n), floats(n, 2)


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
        values, by = list(scene.raw.values()), list(scene.gradients.values())
        ext.adam(values, by, *scene.moments, [1e-3] * len(values), 1, 0.9, 0.999, 1e-15, None)

    gradient = floats(HEIGHT, WIDTH, 3)
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
        floats(ANCHORS, 3, draw=normal), floats(ANCHORS, K, 3, draw=normal),
        floats(ANCHORS, FEATURES, draw=normal), floats(ANCHORS, 6, draw=normal),
    ]  # fmt: skip
    networks = [
        floats(*shape, draw=normal)
        for outputs in (K, 7 * K, 3 * K)
        for shape in ((FEATURES + 3, HIDDEN), (HIDDEN,), (HIDDEN, outputs), (outputs,))
    ]
    centre = floats(3)
    anchors = ext.Anchors(*stored, None, centre, False, False, networks)
    by_stored = [floats(*value.shape) for value in stored]
    by_networks = [floats(*value.shape) for value in networks]
    count = ext.open_anchors(anchors).count
    made = [floats(count, 3), floats(count, 4), floats(count, 3), floats(count), floats(count, 3)]
    by_made = [floats(*value.shape, draw=normal) for value in made]
    rows, slots = integers(count), integers(count)

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
