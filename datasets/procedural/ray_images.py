"""One picture of a world: area-sampled colour, and exact depth, normal and object at pixel centres."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.procedural.surface import Surface, to_srgb
from splatproof.datasets.procedural.tracing import Caster
from splatproof.datasets.procedural.units import Number
from splatproof.reference.types.camera import Camera

RAYS_AT_ONCE = 2**16
"""Bound on samples shaded together: small enough for the cache, large enough for vectors."""


@runtime_checkable
class Lighting(Protocol):
    """What lights a world."""

    def background(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Radiance of rays that meet nothing."""
        ...

    def light(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        normals: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 3"]:
        """Irradiance over pi at points of surfaces.

        Args:
            points: Places on surfaces in metres.
            face_normals: Unit normals of the triangles there, towards the viewer.
            normals: Unit shading normals there, towards the viewer.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One view's picture and truth."""

    colour: UInt8[np.ndarray, "h w 3"]
    """sRGB, the mean of the pixel's samples in linear light."""
    depth: Float[np.ndarray, "h w"]
    """float32 z-depth in metres through the pixel's centre; inf where nothing is met."""
    normal: Float[np.ndarray, "h w 3"]
    """float32 unit normal of the triangle in the world, towards the camera; 0 for sky."""
    object: Int[np.ndarray, "h w"]
    """Object id; 0 for sky."""


def pixel_rays(
    camera: Camera, pixels: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Rays through positions in an image.

    Args:
        camera: Pinhole camera in metres.
        pixels: Positions (x, y) in pixels, pixel centres at .5.
    Returns: Origins and directions in the world; the camera's z of a direction is 1.
    """
    intrinsics = camera.K.numpy()
    x = (pixels[:, 0] - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (pixels[:, 1] - intrinsics[1, 2]) / intrinsics[1, 1]
    ways = np.stack([x, y, np.ones_like(x)], axis=1) @ camera.rotation.numpy()
    return np.broadcast_to(camera.centre.numpy(), ways.shape), ways


def take(
    caster: Caster,
    lighting: Lighting,
    camera: Camera,
    *,
    samples: int,
    seed: int,
    exposure: Number = 1.0,
    seeds: Float[np.ndarray, " objects"],
) -> Frame:
    """Picture and truth of one view.

    Args:
        caster: The world.
        lighting: What lights it.
        camera: Pinhole camera in metres.
        samples: Strata a pixel on each axis; samples^2 rays, one at random in each stratum.
        seed: Decides where in its stratum each ray lies.
        exposure: Factor on linear light before it is clamped and encoded.
        seeds: A number in [0, 1) for each object id, for textures.
    """
    width, height = camera.width, camera.height
    rng = np.random.Generator(np.random.PCG64(seed))
    rows = max(1, RAYS_AT_ONCE // (width * samples * samples))
    linear = []
    for top in range(0, height, rows):
        count = min(rows, height - top)
        pixels = strata(width, top, count, samples, rng)
        colour = shade(caster, lighting, camera, pixels, samples, seeds)
        linear.append(colour.reshape(count, width, samples * samples, 3).mean(dim=2))
    picture = to_srgb(torch.cat(linear) * exposure)
    depth, normal, object_ids = truth(caster, camera)
    encoded = (picture * 255 + 0.5).floor().to(torch.uint8).numpy()
    return Frame(colour=encoded, depth=depth, normal=normal, object=object_ids)


def strata(
    width: int, top: int, rows: int, samples: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 2"]:
    """One random position in each of samples x samples cells of every pixel of some rows.

    Args:
        width: Pixels in a row.
        top: First of the rows.
        rows: Number of rows.
        samples: Cells of a pixel on each axis.
        rng: Draws the positions inside the cells.
    Returns: Positions (x, y) in pixels, row by row, pixel by pixel.
    """
    y, x, j, i = np.meshgrid(
        np.arange(rows) + top, np.arange(width), np.arange(samples), np.arange(samples),
        indexing="ij",
    )  # fmt: skip
    jitter = rng.random((2, x.size))
    return np.stack([x.ravel() + (i.ravel() + jitter[0]) / samples,
                     y.ravel() + (j.ravel() + jitter[1]) / samples], axis=1)  # fmt: skip


def truth(
    caster: Caster, camera: Camera
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w 3"], Int[np.ndarray, "h w"]]:
    """Depth, normal and object id through the centre of every pixel.

    Args:
        caster: The world.
        camera: Pinhole camera in metres.
    Returns: As the fields `depth`, `normal` and `object` of a Frame.
    """
    size = (camera.height, camera.width)
    y, x = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5, indexing="ij")
    origins, ways = pixel_rays(camera, np.stack([x.ravel(), y.ravel()], axis=1))
    hits = caster.first(origins, ways)
    met = hits.face >= 0
    normal = caster.face_normals[hits.face]
    normal = normal * -np.sign(np.einsum("ij,ij->i", normal, ways))[:, None]
    objects = np.where(met, caster.world.face_objects[hits.face], 0)
    return (
        hits.distance.astype(np.float32).reshape(size),
        np.where(met[:, None], normal, 0).astype(np.float32).reshape(*size, 3),
        objects.astype(np.int32).reshape(size),
    )


def shade(
    caster: Caster,
    lighting: Lighting,
    camera: Camera,
    pixels: Float[np.ndarray, "n 2"],
    samples: int,
    seeds: Float[np.ndarray, " objects"],
) -> Float[Tensor, "n 3"]:
    """Linear radiance along the rays through image positions.

    Args:
        caster: The world.
        lighting: What lights it.
        camera: Pinhole camera in metres.
        pixels: Positions (x, y) in pixels, pixel centres at .5.
        samples: Rays a pixel on each axis; textures show no finer detail than these can carry.
        seeds: A number in [0, 1) for each object id, for textures.
    """
    world = caster.world
    origins, ways = pixel_rays(camera, pixels)
    hits = caster.first(origins, ways)
    unit = torch.from_numpy(ways).float()
    unit = functional.normalize(unit, dim=1)
    met = np.flatnonzero(hits.face >= 0)
    colour = torch.empty(len(ways), 3)
    missed = torch.from_numpy(hits.face < 0)
    if bool(missed.any()):
        colour[missed] = lighting.background(unit[missed])
    if not len(met):
        return colour
    face, view = hits.face[met], unit[torch.from_numpy(met)]
    points = origins[met] + ways[met] * hits.distance[met, None]
    geometric = caster.face_normals[face]
    side = -np.sign(np.einsum("ij,ij->i", geometric, ways[met]))[:, None]
    geometric = geometric * side
    weights = caster.weights(face, points)
    corners = world.faces[face]
    normals = np.einsum("nk,nki->ni", weights, world.normals[corners]) * side
    coords = np.einsum("nk,nki->ni", weights, world.coords[corners])
    spacing = hits.distance[met] / float(camera.K[0, 0]) / samples
    surface = Surface(
        points=torch.from_numpy(points).float(),
        normals=functional.normalize(torch.from_numpy(normals).float(), dim=1),
        coords=torch.from_numpy(coords).float(),
        seeds=torch.from_numpy(seeds[world.face_objects[face]]).float(),
        footprint=torch.from_numpy(spacing).float(),
    )
    material = torch.from_numpy(world.face_materials[face])
    albedo, gloss, bumped = _paint(world.materials, material, surface)
    reflected = albedo * lighting.light(points, geometric, bumped)
    mirror = view - 2 * (view * bumped).sum(dim=1, keepdim=True) * bumped
    grazing = (1 + (view * bumped).sum(dim=1)).clamp(0, 1)
    share = (gloss * (0.08 + 0.92 * grazing**5))[:, None]  # Schlick 1994
    shiny = share[:, 0] > 0
    if bool(shiny.any()):
        reflected[shiny] = (
            reflected[shiny] * (1 - share[shiny])
            + lighting.background(functional.normalize(mirror[shiny], dim=1)) * share[shiny]
        )
    colour[~missed] = reflected
    return colour


def _paint(
    materials: tuple, material: Int[Tensor, " n"], surface: Surface
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"], Float[Tensor, "n 3"]]:
    """Albedo, gloss and bumped unit normal of every point, material by material."""
    albedo = torch.zeros_like(surface.points)
    gloss = torch.zeros_like(surface.seeds)
    normals = surface.normals.clone()
    for index in torch.unique(material).tolist():
        rows = torch.nonzero(material == index)[:, 0]
        part = surface.part(rows)
        paint = materials[index](part)
        albedo[rows] = paint.albedo.clamp(0, 1)
        if paint.gloss is not None:
            gloss[rows] = paint.gloss
        if paint.bump is not None:
            normals[rows] = functional.normalize(part.normals + paint.bump, dim=1)
    return albedo, gloss, normals
