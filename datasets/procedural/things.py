"""Houses, trees, walls and cars, built of simple solids around the origin."""

import numpy as np

from splatproof.datasets.procedural.facades import Solid, Tiles, flat_roof
from splatproof.datasets.procedural.plants import Bark, Leaves
from splatproof.datasets.procedural.shapes import (
    Shape,
    blob,
    box,
    cylinder,
    gable_ends,
    gable_roof,
    joined,
    placed,
    polygon,
    walls,
)
from splatproof.datasets.procedural.surface import Material
from splatproof.datasets.procedural.units import Number, Triple
from splatproof.datasets.procedural.vectors import norm

Parts = list[tuple[Shape, Material]]

TILES = Tiles()
LEAVES = Leaves()
BARK = Bark()
CHIMNEY = Solid(tone="8c5a45", dirt=0.9)
GLASS = Solid(tone="1d242b", gloss=1.0, dirt=0.2)
CONCRETE = Solid(tone="a8a399", dirt=0.6)
METAL = Solid(tone="8e9499", dirt=0.5)
TYRE = Solid(tone="1b1b1c", dirt=0.3)


def moved(parts: Parts, offset: Triple, heading: Number = 0.0) -> Parts:
    """Every part turned about z and moved.

    Args:
        parts: Shapes with their materials.
        offset: Motion along x, y and z, in metres.
        heading: Turn in radians, counter-clockwise.
    """
    return [(placed(shape, offset, heading), material) for shape, material in parts]


def house(
    length: Number,
    width: Number,
    eave: Number,
    rise: Number,
    wall: Material,
    roof: Material = TILES,
) -> Parts:
    """A gabled house with the ridge along x and a chimney.

    Args:
        length: Extent along x, in metres.
        width: Extent along y, in metres.
        eave: Height of the walls, in metres.
        rise: Height of the ridge above the walls, in metres.
        wall: Material of walls and gables.
        roof: Material of the roof.
    Returns: Walls, roof and chimney, in this order.
    """
    x, y = length / 2, width / 2
    outline = [[-x, -y], [x, -y], [x, y], [-x, y]]
    chimney = placed(box((0.9, 0.7, rise * 0.75 + 1.0)), (0.22 * length, 0.12 * width, eave))
    return [
        (joined(walls(outline, 0.0, eave), gable_ends(length, width, eave, rise)), wall),
        (gable_roof(length, width, eave, rise), roof),
        (chimney, CHIMNEY),
    ]


def dormer(width: Number, depth: Number, height: Number, wall: Material) -> Parts:
    """A small gabled window house that faces -y, for a roof slope.

    Args:
        width: Extent along x, in metres.
        depth: Extent along +y, into the roof, in metres.
        height: Height of its walls, in metres.
        wall: Material of walls and gable.
    """
    outline = [[-width / 2, 0], [width / 2, 0], [width / 2, depth], [-width / 2, depth]]
    roof = placed(gable_roof(depth, width, height, width * 0.35, 0.2), (0, depth / 2, 0), np.pi / 2)
    front = placed(gable_ends(depth, width, height, width * 0.35), (0, depth / 2, 0), np.pi / 2)
    return [(joined(walls(outline, 0, height), front), wall), (roof, TILES)]


def tree(
    height: Number, spread: Number, seed: int, detail: int = 3, crown: Material = LEAVES
) -> Parts:
    """A broad-leaved tree: a trunk and a crown of several lumps.

    Args:
        height: Metres.
        spread: Width of the crown, in metres, about.
        seed: Decides the shape of the crown.
        detail: Subdivisions of each lump, of 20 * 4^detail triangles.
        crown: Material of the crown.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    lumps = []
    for index in range(7):
        size = spread * rng.uniform(0.30, 0.42) * (1.25 if index == 0 else 1.0)
        angle, away = rng.uniform(0, 2 * np.pi), spread * rng.uniform(0.15, 0.34) * (index > 0)
        z = height * (0.64 + 0.02 * index) if index else height * 0.66
        lump = blob((size, size, size * rng.uniform(0.75, 1.0)), 0.28, seed * 31 + index, detail)
        lumps.append(placed(lump, (away * np.cos(angle), away * np.sin(angle), z - 0.15 * away)))
    trunk = cylinder(0.05 * height * 0.6, height * 0.62, 8, 0.02 * height)
    return [(joined(*lumps), crown), (trunk, BARK)]


def conifer(height: Number, spread: Number, seed: int, detail: int = 3) -> Parts:
    """A spruce: stacked skirts of needles.

    Args:
        height: Metres.
        spread: Width of the lowest skirt, in metres, about.
        seed: Decides the shape of the skirts.
        detail: Subdivisions of each skirt, of 20 * 4^detail triangles.
    """
    needles = Leaves(tones=("2f4a2c", "3a5433", "2c4433"), clump=0.7)
    skirts = []
    for index in range(5):
        share = index / 5
        size = spread * 0.5 * (1 - 0.82 * share)
        shape = blob((size, size, height * 0.17), 0.3, seed * 17 + index, detail)
        skirts.append(placed(shape, (0, 0, height * (0.22 + 0.72 * share))))
    return [(joined(*skirts), needles), (cylinder(0.2, height * 0.5, 7, 0.08), BARK)]


def hedge(length: Number, width: Number, height: Number, seed: int) -> Parts:
    """A trimmed hedge along x, as a row of lumps.

    Args:
        length: Extent along x, in metres.
        width: Extent along y, in metres, about.
        height: Metres, about.
        seed: Decides the shape of the lumps.
    """
    count = max(2, int(length / (0.9 * width)))
    places = np.linspace(-length / 2, length / 2, count)
    lumps = [
        placed(
            blob((width * 0.75, width * 0.55, height * 0.6), 0.2, seed + i, 2),
            (x, 0, height * 0.45),
        )
        for i, x in enumerate(places)
    ]
    return [(joined(*lumps), LEAVES)]


def car(paint: str, length: Number = 4.3) -> Parts:
    """A car along +x on z = 0: body, cabin, windows, wheels.

    Args:
        paint: Colour of the body as an sRGB code.
        length: Metres.
    """
    half, wide = length / 2, 0.88
    profile = np.array(  # side view (x, z) of the body with its cabin, counter-clockwise
        [[-half, 0.35], [half, 0.35], [half, 0.75], [half - 0.75, 0.92], [0.55, 0.98],
         [-0.05, 1.45], [-1.25, 1.46], [-half + 0.25, 0.98], [-half, 0.85]]
    )  # fmt: skip
    body = _extruded(profile, wide)
    # panes sit a hair outside the body
    side = np.array([[-1.55, 1.0], [0.42, 1.0], [-0.05, 1.38], [-1.22, 1.39]])
    panes = [polygon([[x, -wide - 0.01, z] for x, z in side]),
             polygon([[x, wide + 0.01, z] for x, z in side[::-1]])]  # fmt: skip
    panes.append(_strip([0.57, 1.0], [0.0, 1.44], wide - 0.1))
    panes.append(_strip([-1.30, 1.45], [-half + 0.24, 1.0], wide - 0.1))
    wheels = []
    for x in (-half + 0.8, half - 0.85):
        for y in (-wide, wide):
            wheels.append(_wheel(x, y))
    return [(body, Solid(tone=paint, gloss=0.35, dirt=0.12)), (joined(*panes), GLASS),
            (joined(*wheels), TYRE)]  # fmt: skip


def _extruded(profile: np.ndarray, wide: Number) -> Shape:
    """A solid with a polygonal side view (x, z), from y = -wide to wide."""
    rim = []
    for a, b in zip(profile, np.roll(profile, -1, axis=0), strict=True):
        rim.append(
            polygon(
                [[a[0], wide, a[1]], [b[0], wide, b[1]], [b[0], -wide, b[1]], [a[0], -wide, a[1]]]
            )
        )
    lower, cabin = profile[[0, 1, 2, 3, 4, 7, 8]], profile[[7, 4, 5, 6]]
    for part in (lower, cabin):
        rim.append(polygon([[x, -wide, z] for x, z in part]))
        rim.append(polygon([[x, wide, z] for x, z in part[::-1]]))
    return joined(*rim)


def _strip(low: list[float], high: list[float], wide: Number) -> Shape:
    """A pane across the car between two heights of its profile, 1 cm outside it."""
    a, b = np.array(low), np.array(high)
    out = np.array([b[1] - a[1], a[0] - b[0]])
    out = out / norm(out) * 0.012 * np.sign(out[1])
    a, b = a + out, b + out
    return polygon(
        [
            [a[0], -wide, a[1]],
            [a[0], wide, a[1]],
            [b[0], wide * 0.9, b[1]],
            [b[0], -wide * 0.9, b[1]],
        ]
    )


def _wheel(x: Number, y: Number) -> Shape:
    """A wheel that stands across the car."""
    disc = cylinder(0.33, 0.22, 14)
    out = np.sign(y)  # the lid looks away from the car
    turn = np.array([[1, 0, 0], [0, 0, out], [0, -out, 0]], dtype=float)
    vertices = disc.vertices @ turn.T + np.array([x, y - out * 0.16, 0.33])
    return Shape(
        vertices=vertices, faces=disc.faces, normals=disc.normals @ turn.T, coords=disc.coords
    )


def flat_house(size: Triple, wall: Material, rng: np.random.Generator) -> Parts:
    """A block with a flat gravel roof, a parapet, vents and a lift house.

    Args:
        size: Extent along x, y and z, in metres.
        wall: Material of the walls.
        rng: Draws number, places and sizes of the vents.
    """
    x, y, tall = size[0] / 2, size[1] / 2, float(size[2])
    outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    inner = outline * (1 - 0.35 / np.array([x, y]))
    roof = polygon([[*p, tall - 0.5] for p in inner])
    rim = [walls(inner[::-1], tall - 0.5, tall)]
    for index in range(4):
        a, b = outline[index], outline[(index + 1) % 4]
        c, d = inner[(index + 1) % 4], inner[index]
        rim.append(polygon([[*a, tall], [*b, tall], [*c, tall], [*d, tall]]))
    vents = [placed(box((3.2, 3.0, 2.6)), (0.25 * x, 0.3 * y * rng.choice([-1, 1]), tall - 0.5))]
    for _ in range(int(rng.integers(4, 9))):
        place = (rng.uniform(-0.7, 0.7) * x, rng.uniform(-0.8, 0.8) * y, tall - 0.5)
        vents.append(
            placed(
                box((rng.uniform(0.7, 2.0), rng.uniform(0.7, 1.6), rng.uniform(0.6, 1.3))), place
            )
        )
    return [(walls(outline, 0.0, tall), wall), (roof, flat_roof), (joined(*rim), CONCRETE),
            (joined(*vents), METAL)]  # fmt: skip
