"""Which pixels a training photo can have shown: planes, walls and skies whose answer is known."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.flat_ground import (
    FOCAL,
    GROUND,
    HEIGHT,
    PLANE,
    WIDTH,
    looking_down,
    plane_points,
    view,
)
from splatproof.datasets import seen
from splatproof.datasets.image_cache import TensorCache
from splatproof.reference.types.scene import SparsePoints, View


def seen_pixels(
    scored: View, training: list[View], points: SparsePoints, number: int = 0
) -> Tensor:
    """`seen.seen_pixels` where something is known."""
    found = seen.seen_pixels(scored, training, points, number)
    assert found is not None
    return found


def overlap(shift: float) -> Tensor:
    """Columns of the view at 0 whose ground the one at `shift` shows: x + 0.5 - FOCAL shift / GROUND >= 0."""
    columns = torch.arange(WIDTH) + 0.5 - FOCAL * shift / GROUND
    return ((columns >= 0) & (columns < WIDTH)).expand(HEIGHT, WIDTH)


@pytest.mark.parametrize("shift", [-5.0, 0.0, 3.0, 7.05])
def test_with_true_depth_a_plane_is_seen_where_the_images_overlap(shift):
    found = seen_pixels(view(0, PLANE), [view(shift, PLANE)], plane_points())
    assert torch.equal(found, overlap(shift))


@pytest.mark.parametrize("shift", [-5.0, 0.0, 3.0])
def test_without_it_a_plane_is_seen_where_the_images_may_overlap(shift):
    found = seen_pixels(view(0), [view(shift)], plane_points())
    # a point at 0.8 to 1.25 of its depth moves by up to a quarter of the shift in pixels
    certain, possible = overlap(shift), overlap(0.8 * shift)
    assert (found | ~certain).all()
    assert (possible | ~found).all()


def test_a_view_that_looks_elsewhere_shows_nothing():
    assert not seen_pixels(view(0), [view(100.0)], plane_points()).any()
    assert not seen_pixels(view(0, PLANE), [view(100.0, PLANE)], plane_points()).any()


@pytest.mark.parametrize("depth", [PLANE, None])
def test_a_photo_shows_nothing_where_its_mask_hides_it(depth):
    scored, counted = view(0, depth), torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    counted[10:20, 30:50] = False
    masked = replace(view(0, depth), load_mask=counted.clone)
    assert torch.equal(seen_pixels(scored, [masked], plane_points()), counted)
    assert seen_pixels(scored, [masked, view(0, depth)], plane_points()).all()


def test_masks_are_read_once_while_there_is_room():
    reads = []

    def load_mask() -> Tensor:
        reads.append(1)
        return torch.ones(HEIGHT, WIDTH, dtype=torch.bool)

    training, kept = [replace(view(0), load_mask=load_mask)], TensorCache(2**20)
    for _ in range(3):
        seen.seen_pixels(view(90.0), training, plane_points(), 0, kept)
        seen.seen_pixels(view(4.0), training, plane_points(), 0, kept)
    assert len(reads) == 1


def test_more_photos_never_show_less():
    few = seen_pixels(view(0, PLANE), [view(4.0, PLANE)], plane_points())
    more = seen_pixels(view(0, PLANE), [view(4.0, PLANE), view(-9.0, PLANE)], plane_points())
    assert (more | ~few).all()
    assert more.sum() > few.sum()


def test_what_stands_before_a_surface_hides_it():
    wall = PLANE.clone()
    wall[:, 20:40] = 4.0  # of the photo; the scored view beside it looks past the wall
    found = seen_pixels(view(0, PLANE), [view(0, wall)], plane_points())
    assert found[:, :19].all()
    assert not found[:, 21:39].any()


def test_sky_is_seen_where_a_photo_has_sky():
    sky = PLANE.clone()
    sky[:30] = torch.inf
    assert seen_pixels(view(0, sky), [view(3.0, sky)], plane_points())[:29].all()
    found = seen_pixels(view(0, sky), [view(3.0, PLANE)], plane_points())
    assert not found[:29].any()


def test_what_moves_is_seen_where_a_photo_looks_whatever_stands_there_then():
    car = PLANE.clone()
    car[20:30, 20:40] = 5.0
    moving = torch.zeros(HEIGHT, WIDTH, dtype=torch.bool)
    moving[20:30, 20:40] = True
    scored = view(0, car)
    assert not seen_pixels(scored, [view(0, PLANE)], plane_points())[21:29, 21:39].any()
    known = replace(scored, load_moving=lambda: {"vehicles": moving})
    assert seen_pixels(known, [view(0, PLANE)], plane_points()).all()
    assert not seen_pixels(known, [view(90, PLANE)], plane_points()).any()


def test_a_view_that_trains_itself_is_seen_whole():
    own = view(0, PLANE)
    assert seen_pixels(own, [own], plane_points()).all()


def test_points_of_the_views_own_track_are_asked_first():
    """Points behind the plane that the photo cannot show would double the depth."""
    near, far = plane_points(), plane_points()
    positions = torch.cat([near.positions, far.positions * torch.tensor([2.0, 2.0, 2.0])])
    inside = (near.positions[:, :2].abs() * FOCAL / GROUND < torch.tensor([40.0, 30.0])).all(dim=1)
    counts = torch.cat([inside, torch.zeros_like(inside)]).long()
    points = SparsePoints(
        positions=positions, colours=torch.zeros(len(positions), 3, dtype=torch.uint8),
        track_starts=torch.cat([torch.zeros(1, dtype=torch.int64), counts.cumsum(0)]),
        track_views=torch.full((int(counts.sum()),), 5),
    )  # fmt: skip
    training = [view(6.0)]
    assert torch.equal(
        seen_pixels(view(0), training, points, 5), seen_pixels(view(0), training, near, 5)
    )


def test_points_on_one_line_are_points():
    line = plane_points(20)
    line.positions[:, :2] = torch.linspace(-4, 4, 20, dtype=torch.float64)[:, None] * torch.tensor(
        [1.0, 0.0]
    )
    assert seen_pixels(view(0), [view(0)], line).all()


def test_too_few_points_say_nothing():
    assert seen.seen_pixels(view(0), [view(0)], plane_points(5), 0) is None


def test_a_large_image_is_looked_at_coarsely():
    """Every second pixel of 320 x 240 and less: the rim of the overlap moves by less than a step."""
    large = replace(looking_down(0), width=WIDTH * 6, height=HEIGHT * 6)
    large = replace(large, K=large.K * torch.tensor([[6.0], [6.0], [1.0]]))
    beside = replace(large, world_to_camera=looking_down(3.0).world_to_camera)
    depth = torch.full((HEIGHT * 6, WIDTH * 6), GROUND)
    views = [
        View(name=name, camera=camera, load=lambda: depth, load_depth=lambda: depth)
        for name, camera in (("a", large), ("b", beside))
    ]
    found = seen_pixels(views[0], views[1:], plane_points())
    assert found.shape == depth.shape
    exact = torch.arange(WIDTH * 6) + 0.5 >= 6 * FOCAL * 3.0 / GROUND
    assert (found != exact).double().mean() < 3 / (WIDTH * 6)


@pytest.fixture
def asked(monkeypatch) -> list[int]:
    """How many points were projected, call by call."""
    calls: list[int] = []
    real = seen.project_points

    def counted(camera, points):
        calls.append(len(points))
        return real(camera, points)

    monkeypatch.setattr(seen, "project_points", counted)
    return calls


def test_pixels_that_are_seen_are_not_looked_for_again(asked):
    """A photo of the view itself shows all of it: no other photo is asked, nor any other depth."""
    points = plane_points()
    assert seen_pixels(view(0), [view(3.0), view(0), view(-3.0)], points).all()
    assert asked == [len(points), HEIGHT * WIDTH]  # the sparse points, then every pixel once


def test_pixels_that_no_photo_shows_are_looked_for_in_all_at_each_depth(asked):
    points = plane_points()
    assert not seen_pixels(view(0), [view(100.0), view(-100.0)], points).any()
    assert asked == [len(points), *[HEIGHT * WIDTH] * 2 * (1 + len(seen.UNSURE))]
