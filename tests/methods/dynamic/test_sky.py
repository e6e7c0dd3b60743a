"""The learnt sky: where rays meet the cube, no steps at its edges, gradients, and what is in front."""

import math
from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera
from splatproof.methods.dynamic.settings import SkySettings
from splatproof.methods.dynamic.sky import (
    SKY,
    Sky,
    around,
    in_order,
    off_cube,
    on_cube,
    places,
    started,
)
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.render import RenderOutput


def directions(count: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)).double()


def seen(cube: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    texels, shares = around(rays, cube.shape[1])
    return (cube.reshape(-1, 3)[texels] * shares[..., None]).sum(dim=1)


def output(alpha: torch.Tensor, colour: torch.Tensor) -> RenderOutput:
    return RenderOutput(colour=colour, alpha=alpha, depth=alpha, radii=torch.zeros(0))


def turned(where, degrees: float, axis: int):
    """The camera turned in its place by so much around an axis of its own."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    first, second = (i for i in range(3) if i != axis)
    turn = torch.eye(4, dtype=torch.float64)
    turn[first, first] = turn[second, second] = cos
    turn[first, second], turn[second, first] = sin, -sin
    return replace(where, world_to_camera=turn @ where.world_to_camera)


def test_places_on_the_cube_lead_back_to_the_directions():
    rays = directions(500)
    face, place = on_cube(rays)
    assert set(face.tolist()) == set(range(6))
    back = off_cube(face, place)
    torch.testing.assert_close(
        back / back.norm(dim=1, keepdim=True), rays / rays.norm(dim=1, keepdim=True)
    )


@pytest.mark.parametrize("side", [1, 2, 5, 16])
def test_shares_are_those_of_the_four_texels_around(side):
    texels, shares = around(directions(2000), side)
    torch.testing.assert_close(shares.sum(dim=1), torch.ones(2000), atol=1e-6, rtol=0)
    assert (shares >= 0).all()
    assert int(texels.min()) >= 0
    assert int(texels.max()) < 6 * side * side


@pytest.mark.parametrize("side", [1, 3, 8])
def test_texels_within_a_face_are_those_of_the_directions_to_them(side):
    """The texel around each corner, looked up by the direction of its place as those over an edge are."""
    rays = directions(2000)
    texels, _ = around(rays, side)
    face, place = on_cube(rays)
    low = ((place + 1) / 2 * side - 0.5).floor()
    for corner, found in zip([(0, 0), (1, 0), (0, 1), (1, 1)], texels.unbind(dim=1), strict=True):
        centre = (low + torch.tensor(corner) + 0.5) * 2 / side - 1
        hair = 1 + 1e-3 / side
        beyond = torch.where(centre.abs() > 1, centre.sign() * hair, centre)
        other, there = on_cube(off_cube(face, beyond))
        cell = ((there + 1) / 2 * side).floor().clamp(0, side - 1).long()
        assert torch.equal(found, (other * side + cell[:, 1]) * side + cell[:, 0])


@pytest.mark.parametrize("count", [7, 2**16, 2**16 + 1])
def test_short_numbers_are_sorted_as_long_ones_are(count):
    draw = torch.Generator().manual_seed(count)
    values = torch.randint(max(0, count - 9), count, (500,), generator=draw)
    assert torch.equal(in_order(values, count), values.argsort(stable=True))


def test_at_the_centre_of_a_texel_it_is_that_texel():
    side = 4
    face = torch.arange(6).repeat_interleave(side * side)
    v, u = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    place = (torch.stack([u, v], dim=-1).reshape(-1, 2).double() + 0.5) * 2 / side - 1
    cube = torch.rand(6, side, side, 3, generator=torch.Generator().manual_seed(1))
    found = seen(cube, off_cube(face, place.repeat(6, 1)))
    torch.testing.assert_close(found, cube.reshape(-1, 3), atol=1e-5, rtol=0)


def test_there_is_no_step_at_the_edges_and_corners_of_the_cube():
    cube = torch.rand(6, 8, 8, 3, generator=torch.Generator().manual_seed(2))
    along = torch.linspace(-1, 1, 41).double()
    one = torch.ones_like(along)
    edges = torch.cat(
        [
            torch.stack([f(along, a * one, b * one) for f in (first, second, third)], dim=1)
            for a in (-1, 1)
            for b in (-1, 1)
            for first, second, third in (
                (lambda s, p, q: s, lambda s, p, q: p, lambda s, p, q: q),
                (lambda s, p, q: p, lambda s, p, q: s, lambda s, p, q: q),
                (lambda s, p, q: p, lambda s, p, q: q, lambda s, p, q: s),
            )
        ]
    )
    sides = [seen(cube, edges * (1 + 1e-7 * directions(len(edges), seed))) for seed in range(12)]
    for other in sides[1:]:  # texels differ by 1 at a distance of 2 / 8: 1e-7 is 4e-6 of colour
        torch.testing.assert_close(other, sides[0], atol=2e-5, rtol=0)


def test_a_sky_that_is_a_smooth_function_of_direction_is_seen_as_it_is():
    side = 64
    face = torch.arange(6).repeat_interleave(side * side)
    v, u = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="ij")
    place = (torch.stack([u, v], dim=-1).reshape(-1, 2).double() + 0.5) * 2 / side - 1
    centres = off_cube(face, place.repeat(6, 1))
    cube = (centres / centres.norm(dim=1, keepdim=True)).reshape(6, side, side, 3).float()
    # The camera's own rotation equals its transpose, which would hide one the wrong way round.
    where = turned(camera(2), 40, 1)
    image = Sky().image(cube, where)
    # The middle of pixel (3, 5) as projection sees it, an arbitrary way off.
    for row, column in ((3, 5), (17, 0), (0, 23)):
        ray = image[row, column].double()
        pixel, depth = project_points(where, (where.centre + 7 * ray)[None])
        assert float(depth) > 0
        wanted = torch.tensor([[column + 0.5, row + 0.5]], dtype=torch.float64)
        torch.testing.assert_close(pixel, wanted, atol=0.05, rtol=0)  # bilinear: 1e-3 of a radian


def test_pixels_are_in_the_order_of_rows():
    texels, shares = places(camera(0), 8)
    assert len(texels) == len(shares) == 18 * 24


def test_it_is_behind_what_is_there_and_learns_only_there():
    where = camera(1)
    cube = started(SkySettings(resolution=4, initial=0.25))[SKY].requires_grad_()
    alpha = torch.zeros(18, 24)
    alpha[:, :12] = 1.0
    alpha[0, 12] = 0.5
    colour = torch.full((18, 24, 3), 0.75) * alpha[..., None]
    image = Sky().behind({SKY: cube}, where, output(alpha, colour))
    torch.testing.assert_close(image[:, :12], colour[:, :12])
    torch.testing.assert_close(image[1:, 13:], torch.full((17, 11, 3), 0.25))
    torch.testing.assert_close(image[0, 12], torch.full((3,), 0.5))
    image[:, :12].sum().backward()
    assert cube.grad is not None
    assert not cube.grad.any()
    again = cube.detach().clone().requires_grad_()
    Sky().behind({SKY: again}, where, output(alpha, colour)).sum().backward()
    assert again.grad is not None
    # every transparent pixel's three channels leave exactly their share
    assert float(again.grad.sum()) == pytest.approx(3 * float((1 - alpha).sum()), rel=1e-5)


@pytest.mark.parametrize("covered", [0.3, 0.8])
def test_covered_pixels_teach_it_nothing_and_look_the_same(covered):
    alpha = torch.rand(18, 24, generator=torch.Generator().manual_seed(4))
    colour = torch.zeros(18, 24, 3)
    cubes = [torch.rand(6, 4, 4, 3).requires_grad_() for _ in range(2)]
    cubes[1].data.copy_(cubes[0].data)
    images = [
        Sky(share).behind({SKY: cube}, camera(1), output(alpha, colour))
        for cube, share in zip(cubes, (covered, 1.0), strict=True)
    ]
    torch.testing.assert_close(images[0], images[1])
    images[0].sum().backward()
    assert cubes[0].grad is not None
    left = (1 - alpha)[alpha < covered].sum()
    assert float(cubes[0].grad.sum()) == pytest.approx(3 * float(left), rel=1e-5)


def test_the_gradient_by_each_texel_is_that_of_plain_indexing():
    where = camera(1)
    weights = torch.rand(18, 24, 3, generator=torch.Generator().manual_seed(5))
    cubes = [torch.rand(6, 3, 3, 3).requires_grad_() for _ in range(2)]
    (Sky().image(cubes[0], where) * weights).sum().backward()
    texels, shares = places(where, 3)
    plain = (cubes[1].reshape(-1, 3)[texels] * shares[..., None]).sum(dim=1)
    (plain.reshape(18, 24, 3) * weights).sum().backward()
    assert cubes[0].grad is not None
    assert cubes[1].grad is not None
    torch.testing.assert_close(cubes[0].grad, cubes[1].grad)
    assert (cubes[0].grad == 0).any()  # what no pixel sees


def test_without_a_sky_the_colours_stay():
    assert started(SkySettings(resolution=0)) == {}
    colour = torch.rand(18, 24, 3)
    assert Sky().behind({}, camera(0), output(torch.zeros(18, 24), colour)) is colour


def test_another_camera_of_the_same_size_sees_another_part():
    cube = torch.rand(6, 8, 8, 3, generator=torch.Generator().manual_seed(2))
    one = camera(0)
    other = turned(one, 90, 1)
    sky = Sky()
    first = sky.image(cube, one)
    assert not torch.allclose(first, sky.image(cube, other), atol=0.05)
    assert torch.equal(first, sky.image(cube, one))
