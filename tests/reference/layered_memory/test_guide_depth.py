import itertools
import math
import time

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.layered_memory import guide_depth
from splatproof.reference.layered_memory import layered_depth as ldi
from splatproof.reference.supervision.side_views import unproject
from splatproof.reference.supervision.spiral_path import look_at
from splatproof.reference.types.camera import Camera, project_points

D = torch.float64
UP = torch.tensor([0.0, 0, 1], dtype=D)


def camera(pose: Tensor | None = None, width: int = 6, height: int = 5, focal: float = 6.0):
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=D)
    pose = torch.eye(4, dtype=D) if pose is None else pose
    return Camera(K=K, world_to_camera=pose, width=width, height=height)


def held(view: Camera, points: Tensor, eps: float = 0.1, cap: int = 100) -> ldi.LayeredDepth:
    return ldi.insert(ldi.empty(view, eps, cap), points, torch.zeros_like(points))


def ends_by_loop(memory: ldi.LayeredDepth) -> list[float]:
    """Each layer on its own: the next one of its pixel, the nearest of each pixel around it."""
    layers: dict[tuple[int, int], list[float]] = {}
    width = memory.camera.width
    for pixel, depth in zip(memory.pixels.tolist(), memory.depths.tolist(), strict=True):
        layers.setdefault((pixel // width, pixel % width), []).append(depth)
    ends = []
    for (row, column), stack in sorted(layers.items()):
        for i, z in enumerate(stack):
            near = stack[i + 1 : i + 2]
            for y, x in set(itertools.product((-1, 0, 1), repeat=2)) - {(0, 0)}:
                beside = layers.get((row + y, column + x), [])
                near = near + sorted(beside, key=lambda other: abs(other - z))[:1]
            reach = z + 10 * 2 * z / float(memory.camera.K[0, 0])
            ends.append(max([z, *(other for other in near if other <= reach)]))
    return ends


def drawn_by_loop(positions: Tensor, depths: Tensor, memory: ldi.LayeredDepth, view: Camera):
    """One square after the other, each over what is farther."""
    got = torch.full((view.height, view.width), torch.inf, dtype=D)
    at, z = project_points(view, positions)
    for (x, y), own, depth in zip(at.tolist(), z.tolist(), depths.tolist(), strict=True):
        if own > view.near:
            half = max(0.5, depth / float(memory.camera.K[0, 0]) * float(view.K[0, 0]) / own / 2)
            for row in range(view.height):
                for column in range(view.width):
                    if abs(column + 0.5 - x) <= half and abs(row + 0.5 - y) <= half:
                        got[row, column] = min(float(got[row, column]), own)
    return torch.where(got.isfinite(), got, 0), got.isfinite()


def some_memory(n: int, seed: int) -> ldi.LayeredDepth:
    g = torch.Generator().manual_seed(seed)
    pixel = torch.rand(n, 2, generator=g, dtype=D) * torch.tensor([6.0, 5.0], dtype=D)
    z = 1 + 9 * torch.rand(n, 1, generator=g, dtype=D) ** 2
    ray = torch.cat([pixel, torch.ones(n, 1, dtype=D)], dim=1) @ torch.linalg.inv(camera().K).T
    return held(camera(focal=40.0), ray * z * torch.tensor([0.15, 0.15, 1], dtype=D), 0.05)


def some_view(seed: int) -> Camera:
    g = torch.Generator().manual_seed(seed)
    eye = torch.randn(3, generator=g, dtype=D)
    target = torch.tensor([0.0, 0, 4], dtype=D) + torch.randn(3, generator=g, dtype=D)
    return camera(look_at(eye, target, UP), 7, 8, 6.0)


@settings(max_examples=40)
@given(n=st.integers(0, 60), seed=st.integers(0, 2**16))
def test_columns_end_where_the_loop_ends_them(n, seed):
    memory = some_memory(n, seed)
    assert guide_depth.column_ends(memory).tolist() == pytest.approx(ends_by_loop(memory))


@settings(max_examples=25, deadline=None)
@given(n=st.integers(0, 30), seed=st.integers(0, 2**16))
def test_render_is_the_loop_over_squares(n, seed):
    memory, view = some_memory(n, seed), some_view(seed)
    samples = guide_depth.column_samples(memory, view)
    want = drawn_by_loop(*samples, memory, view)
    got = guide_depth.render(memory, view)
    assert_close(got[0], want[0])
    assert torch.equal(got[1], want[1])


@given(seed=st.integers(0, 2**16))
def test_a_view_rendered_back_into_itself_is_the_same(seed):
    view = camera()
    depth = 1 + torch.rand(5, 6, generator=torch.Generator().manual_seed(seed), dtype=D)
    got, seen = guide_depth.render(held(view, unproject(view, depth)), view)
    assert seen.all()
    assert_close(got, depth, atol=1e-12, rtol=0)


def test_hidden_layers_do_not_leak_through_a_nearer_surface():
    view = camera()
    both = [unproject(view, torch.full((5, 6), z, dtype=D)) for z in (2.0, 4.0)]
    closer = camera(view.world_to_camera, 12, 10, 12.0)
    got, seen = guide_depth.render(held(view, torch.cat(both)), closer)
    assert seen.all()
    assert_close(got, torch.full((10, 12), 2.0, dtype=D))


def test_squares_shrink_with_depth_and_grow_with_the_focal_length():
    """A layer at reference depth 2, seen from half as far at twice the focal length: 4 pixels wide."""
    memory = held(camera(), torch.tensor([[0.01, 0.01, 2.0]], dtype=D))
    pose = torch.eye(4, dtype=D)
    pose[2, 3] = -1.0
    _, seen = guide_depth.render(memory, camera(pose, 20, 20, 12.0))
    assert int(seen.sum()) == 16
    _, seen = guide_depth.render(memory, camera(width=20, height=20, focal=12.0))
    assert int(seen.sum()) == 4


def cliff(slope: float, turn: float) -> tuple[ldi.LayeredDepth, Camera, Tensor, Tensor]:
    """A slope between a high and a low plain, seen from above, and something hidden behind it.

    Returns: The memory, a view of the slope from the side, the slope's true depth in it, and the
        pixels that see the slope's middle.
    """
    top, low = 3.0, 0.0
    across = torch.tensor([math.cos(turn), math.sin(turn), 0], dtype=D)
    above = camera(look_at(20 * UP, 0 * UP, UP), 160, 160, 160.0)
    ray = unproject(above, torch.ones(160, 160, dtype=D)) - above.centre
    # height = slope * (across . p), between low and top
    t = (20 + 0 * ray[:, 0]) / (slope * (ray @ across) - ray[:, 2])
    height = 20 + t * ray[:, 2]
    t = torch.where((height > top) & (t > 0), (top - 20) / ray[:, 2], t)
    t = torch.where((height < low) | (t < 0), (low - 20) / ray[:, 2], t)
    surface = above.centre + t[:, None] * ray
    # a floor behind the slope, that another view put into the memory
    grid = torch.cartesian_prod(*[torch.arange(-4, 4, 0.05, dtype=D)] * 2)
    hidden = torch.cat([grid, torch.full_like(grid[:, :1], -4.0)], dim=1)
    memory = ldi.insert(ldi.empty(above, 0.05), surface, torch.zeros_like(surface))
    memory = ldi.insert(memory, hidden, torch.zeros_like(hidden))
    middle = across * (1.5 / slope) + 1.5 * UP
    side = camera(look_at(middle - 9 * across + 3 * UP, middle, UP), 120, 90, 130.0)
    look = unproject(side, torch.ones(90, 120, dtype=D)) - side.centre
    true = (slope * (side.centre @ across) - side.centre[2]) / (
        look[:, 2] - slope * (look @ across)
    )
    meets = side.centre + true[:, None] * look
    shown = (meets[:, 2] > 0.3) & (meets[:, 2] < 2.7) & (meets[:, :2].norm(dim=1) < 5)
    return memory, side, true.reshape(90, 120), shown.reshape(90, 120)


@pytest.mark.parametrize("slope", [1.0, 4.0, 10.0])
@pytest.mark.parametrize("turn", [0.0, 0.4, math.pi / 4])
def test_steep_surfaces_hide_what_lies_behind(slope, turn):
    memory, side, truth, shown = cliff(slope, turn)
    got, seen = guide_depth.render(memory, side)
    assert int(shown.sum()) > 1000
    # Flat squares leave 7 to 93 % of these pixels to what is behind. Columns leave 0.71 % at
    # most (turn 0.4): a square cell seen across a corner is up to 1.41 wide, and drawn 1 wide.
    assert float(seen[shown].double().mean()) > 0.99
    # A reference pixel is 0.12 wide there; so far may a column stand from the surface.
    assert float((got - truth)[shown & seen].abs().max()) < 0.25


def test_thirty_thousand_layers_take_a_fraction_of_a_second():
    """A Python loop took 0.68 s. Five draws took 0.09 to 0.35 CPU s on a machine that others used."""
    view = camera(look_at(20 * UP, 0 * UP, UP), 180, 180, 180.0)
    g = torch.Generator().manual_seed(0)
    depth = 20 - torch.rand(180, 180, generator=g, dtype=D).cumsum(0) * 0.01
    memory = held(view, unproject(view, depth))
    assert len(memory) == 180 * 180
    side = camera(look_at(torch.tensor([8.0, 0, 12], dtype=D), 0 * UP, UP), 200, 150, 180.0)
    taken = []
    for _ in range(5):
        start = time.process_time()
        guide_depth.render(memory, side)
        taken.append(time.process_time() - start)
    assert min(taken) < 0.4


def test_layers_behind_the_view_are_not_drawn():
    memory = held(camera(), torch.tensor([[0.01, 0.01, 2.0]], dtype=D))
    pose = torch.eye(4, dtype=D)
    pose[2, 3] = -5.0
    assert not guide_depth.render(memory, camera(pose))[1].any()
