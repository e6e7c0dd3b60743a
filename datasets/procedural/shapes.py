"""Meshes of simple solids, in metres, with texture coordinates and shading normals."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from splatproof.datasets.procedural.units import Number, Triple
from splatproof.datasets.procedural.vectors import norm


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """Triangles. Vertices are not shared between faces that must look flat."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    """Unit shading normals."""
    coords: Float[np.ndarray, "v 4"]
    """Texture coordinates."""


def placed(
    shape: Shape,
    offset: Triple | Float[np.ndarray, "3"],
    heading: Number = 0.0,
) -> Shape:
    """The shape turned about z and moved.

    Args:
        shape: Any shape.
        offset: Motion along x, y and z, in metres.
        heading: Turn in radians, counter-clockwise.
    """
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return replace(
        shape,
        vertices=shape.vertices @ turn.T + np.asarray(offset, dtype=float),
        normals=shape.normals @ turn.T,
    )


def joined(*shapes: Shape) -> Shape:
    """One shape of all triangles."""
    starts = np.cumsum([0] + [len(s.vertices) for s in shapes[:-1]])
    return Shape(
        vertices=np.concatenate([s.vertices for s in shapes]),
        faces=np.concatenate([s.faces + i for s, i in zip(shapes, starts, strict=True)]),
        normals=np.concatenate([s.normals for s in shapes]),
        coords=np.concatenate([s.coords for s in shapes]),
    )


def polygon(
    corners: Float[np.ndarray, "k 3"] | list, coords: Float[np.ndarray, "k 4"] | list | None = None
) -> Shape:
    """A flat convex polygon, counter-clockwise seen from its front.

    Args:
        corners: Positions in metres, three or more.
        coords: Texture coordinates of the corners. None: (u, v) in metres along the first edge
            and across it, then the polygon's extent on both axes.
    """
    corners = np.asarray(corners, dtype=float)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= norm(normal)
    if coords is None:
        along = (corners[1] - corners[0]) / norm(corners[1] - corners[0])
        uv = (corners - corners[0]) @ np.stack([along, np.cross(normal, along)]).T
        uv -= uv.min(axis=0)
        coords = np.hstack([uv, np.tile(uv.max(axis=0), (len(uv), 1))])
    fan = np.array([[0, i, i + 1] for i in range(1, len(corners) - 1)])
    return Shape(
        vertices=corners,
        faces=fan,
        normals=np.tile(normal, (len(corners), 1)),
        coords=np.asarray(coords, dtype=float),
    )


def walls(outline: Float[np.ndarray, "k 2"] | list, bottom: Number, top: Number) -> Shape:
    """Vertical walls around a counter-clockwise outline; coords (u, v, width, height) each.

    Args:
        outline: Corners (x, y) in metres, counter-clockwise seen from above.
        bottom: Height of the lower edge, in metres.
        top: Height of the upper edge, in metres.
    """
    outline = np.asarray(outline, dtype=float)
    sides = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        width, height = norm(b - a), top - bottom
        corners = [[*a, bottom], [*b, bottom], [*b, top], [*a, top]]
        coords = [
            [u, v, width, height] for u, v in ((0, 0), (width, 0), (width, height), (0, height))
        ]
        sides.append(polygon(corners, coords))
    return joined(*sides)


def box(size: Triple, bottom: Number = 0.0) -> Shape:
    """An upright box centred on the z axis, with its lid and without its floor.

    Args:
        size: Extent along x, y and z, in metres.
        bottom: Height of its open lower side, in metres.
    """
    x, y, z = size[0] / 2, size[1] / 2, bottom + size[2]
    outline = [[-x, -y], [x, -y], [x, y], [-x, y]]
    return joined(walls(outline, bottom, z), polygon([[*p, z] for p in outline]))


def gable_roof(
    length: Number, width: Number, eave: Number, rise: Number, overhang: Number = 0.4
) -> Shape:
    """Two tiled slopes with the ridge along x, as slabs 0.15 m thick; coords (u, v) up the slope.

    Args:
        length: Extent of the walls along x, in metres.
        width: Extent of the walls along y, in metres.
        eave: Height of the walls, in metres.
        rise: Height of the ridge above the walls, in metres.
        overhang: Metres by which the roof stands out on all sides.
    """
    x, y = length / 2 + overhang, width / 2 + overhang
    low = eave - rise * overhang / (width / 2)
    ridge, thick = eave + rise, 0.15
    slopes = []
    for side in (-1.0, 1.0):
        a, b = [-x * -side, y * side, low], [x * -side, y * side, low]
        c, d = [x * -side, 0, ridge], [-x * -side, 0, ridge]
        lift = np.array([0, 0, thick])
        top = [np.array(p) + lift for p in (a, b, c, d)]
        slopes.append(polygon(np.array(top)))
        slopes.append(polygon(np.array([a, d, c, b])))
        rim = [(a, b, top[1], top[0]), (b, c, top[2], top[1]), (d, a, top[0], top[3])]
        slopes += [polygon(np.array(edge)) for edge in rim]
    return joined(*slopes)


def gable_ends(length: Number, width: Number, eave: Number, rise: Number) -> Shape:
    """The two triangles of wall under a gable roof; coords continue those of the walls.

    Args:
        length: Extent of the walls along x, in metres.
        width: Extent of the walls along y, in metres.
        eave: Height of the walls, in metres.
        rise: Height of the ridge above the walls, in metres.
    """
    ends = []
    for side in (-1.0, 1.0):
        x, y = side * length / 2, side * width / 2
        corners = [[x, -y, eave], [x, y, eave], [x, 0, eave + rise]]
        coords = [[0, eave, width, eave], [width, eave, width, eave],
                  [width / 2, eave + rise, width, eave]]  # fmt: skip
        ends.append(polygon(corners, coords))
    return joined(*ends)


def blob(radii: Triple, roughness: Number, seed: int, detail: int = 3) -> Shape:
    """A lumpy ellipsoid around the origin; coords are its own position and 0.

    Args:
        radii: Half-axes in metres.
        roughness: Relative size of the lumps, 0 (smooth) to about 0.4.
        seed: Decides where the lumps are.
        detail: Subdivisions of an icosahedron; faces = 20 * 4^detail.
    """
    unit, faces = _sphere(detail)
    rng = np.random.Generator(np.random.PCG64(seed))
    lumps = np.zeros(len(unit))
    for frequency in (2.0, 4.5, 9.0):
        axes = rng.standard_normal((6, 3)) * frequency
        lumps += np.sin(unit @ axes.T + rng.uniform(0, 6.28, 6)).sum(axis=1) / (6 * frequency**0.5)
    vertices = unit * (1 + roughness * lumps[:, None] * 2) * np.array(radii)
    return smooth(vertices, faces)


@cache
def _sphere(detail: int) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Unit vertices and faces of an icosahedron subdivided `detail` times."""
    # half a second, for one shape of worlds that are seldom made
    from trimesh.creation import icosphere

    sphere = icosphere(subdivisions=detail)
    return np.asarray(sphere.vertices), np.asarray(sphere.faces)


def smooth(vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> Shape:
    """A smooth-shaded shape; coords are the position and 0.

    Args:
        vertices: Positions in metres.
        faces: Indices of each triangle's vertices, counter-clockwise seen from its front.
    """
    corner = vertices[faces]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = np.zeros_like(vertices)
    for column in range(3):
        np.add.at(normals, faces[:, column], area)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-12)
    return Shape(
        vertices=vertices,
        faces=faces.astype(np.int64),
        normals=normals,
        coords=np.hstack([vertices, np.zeros((len(vertices), 1))]),
    )


def cylinder(
    radius: Number, height: Number, sides: int = 12, top_radius: Number | None = None
) -> Shape:
    """An upright cylinder or cone frustum on z = 0 with a lid; coords are positions.

    Args:
        radius: Radius at the bottom, in metres.
        height: Height in metres.
        sides: Number of sides.
        top_radius: Radius at the top, in metres; 0: a cone without a lid; None: as at the bottom.
    """
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    upper = radius if top_radius is None else top_radius
    low = np.hstack([ring * radius, np.zeros((sides, 1))])
    high = np.hstack([ring * upper, np.full((sides, 1), height)])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.concatenate([np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)])
    side = smooth(np.concatenate([low, high]), faces)
    return joined(side, polygon(high)) if upper > 0 else side


def heightfield(
    xs: Float[np.ndarray, " nx"], ys: Float[np.ndarray, " ny"], heights: Float[np.ndarray, "ny nx"]
) -> Shape:
    """Smooth ground over a grid of positions; coords are positions.

    Args:
        xs: Positions of the columns, in metres, increasing.
        ys: Positions of the rows, in metres, increasing.
        heights: Height of the ground at each of them, in metres.
    """
    grid_x, grid_y = np.meshgrid(xs, ys)
    vertices = np.stack([grid_x, grid_y, heights], axis=2).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(heights.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3), np.stack([a, c, d], 2).reshape(-1, 3)]
    )
    return smooth(vertices, faces)
