"""Side views of method dpgs: where they are, when they come, what they are targets of, and rounds."""

import weakref
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.testing import assert_close

from helpers.tiny_scene import camera, sparse_points, tiny_scene
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.dpgs.refiners import read_refiner
from splatproof.methods.dpgs.settings import SideSettings
from splatproof.methods.dpgs.side_views import KEPT, Guide, SideOrder, SideViews
from splatproof.methods.dpgs.spirals import least_turn, parts, side_cameras
from splatproof.reference.supervision.side_views import warp_and_fill
from splatproof.reference.supervision.spiral_path import SpiralSettings
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View

SMALL = SideSettings(spiral=SpiralSettings(layers=2, views=3))


def flight() -> Scene:
    """Cameras 10 above points on a ground of 8 x 4, which ends at 2 % of them."""
    scene = tiny_scene()
    generator = torch.Generator().manual_seed(0)
    ground = torch.rand(500, 3, generator=generator).double() * torch.tensor([8.0, 4.0, 0.1])
    down = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))
    down[2, 3] = 10
    views = [replace(v, camera=replace(v.camera, world_to_camera=down)) for v in scene.views]
    up = torch.tensor([0.0, 0, 1], dtype=torch.float64)
    return replace(scene, views=tuple(views), points=sparse_points(ground), up=up)


def test_a_spiral_circles_the_points_from_the_flights_height_with_the_flights_lens():
    scene = flight()
    cameras = side_cameras(scene, SMALL)
    assert len(cameras) == 6
    eyes = torch.stack([one.centre for one in cameras])
    assert eyes[:3, 2].tolist() == pytest.approx([10] * 3, abs=0.1)
    assert eyes[3:, 2].tolist() == pytest.approx([5] * 3, abs=0.1)
    half = 0.96 * (8**2 + 4**2) ** 0.5 / 2
    away = (eyes[:, :2] - torch.tensor([4.0, 2.0])).norm(dim=1)
    assert away.tolist() == pytest.approx([half] * 6, abs=0.3)
    lens = scene.train_views[0].camera
    assert all(torch.equal(one.K, lens.K) for one in cameras)
    assert {(one.width, one.height) for one in cameras} == {(lens.width, lens.height)}


def test_several_spirals_stand_side_by_side_along_the_longer_side():
    scene = flight()
    cameras = side_cameras(scene, replace(SMALL, spirals=2))
    middles = torch.stack([one.centre for one in cameras]).reshape(2, 6, 3)[:, :3].mean(dim=1)
    assert middles[:, 0].tolist() == pytest.approx([2, 6], abs=0.2)
    assert middles[:, 1].tolist() == pytest.approx([2, 2], abs=0.2)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**16), count=st.sampled_from([1, 4]))
def test_side_views_stand_over_the_ground_whatever_way_the_scenes_axes_lie(seed, count):
    """Structure from motion hands out worlds at any tilt; boxes along their axes would reach far below the ground."""
    scene, turn = flight(), turned(seed)
    whole = torch.eye(4).double()
    whole[:3, :3] = turn.T
    views = [
        replace(v, camera=replace(v.camera, world_to_camera=v.camera.world_to_camera @ whole))
        for v in scene.views
    ]
    points = sparse_points(scene.points.positions @ turn.T)
    tilted = replace(scene, views=tuple(views), points=points, up=turn @ scene.up)
    cameras = side_cameras(tilted, replace(SMALL, spirals=count))
    rise = tilted.points.positions @ tilted.up
    heights = torch.stack([one.centre for one in cameras]) @ tilted.up - rise.quantile(0.02)
    assert heights.reshape(count, 2, 3)[:, 0].flatten().tolist() == pytest.approx(
        [10] * 3 * count, abs=0.1
    )
    assert heights.reshape(count, 2, 3)[:, 1].flatten().tolist() == pytest.approx(
        [5] * 3 * count, abs=0.1
    )


@given(seed=st.integers(0, 2**16))
def test_the_least_turn_puts_up_along_the_nearest_axis_and_leaves_an_axis_alone(seed):
    axis = torch.eye(3).double()[seed % 3] * (-1) ** seed
    assert torch.equal(least_turn(axis), torch.eye(3).double())
    up = turned(seed)[2]
    found = least_turn(up)
    assert_close(found @ found.T, torch.eye(3).double())
    assert float(torch.linalg.det(found)) == pytest.approx(1)
    nearest = up.abs().argmax()
    assert float((found @ up)[nearest]) == pytest.approx(float(up[nearest].sign()))
    # trace = 1 + 2 cos: as far as up is from the axis, and no further
    assert (float(found.trace()) - 1) / 2 == pytest.approx(float(up[nearest].abs()))


def turned(seed: int) -> torch.Tensor:
    """A rotation drawn at random."""
    generator = torch.Generator().manual_seed(seed)
    square = torch.randn(3, 3, generator=generator).double()
    turn = torch.linalg.qr(square).Q
    return turn * torch.linalg.det(turn)


def test_a_stray_point_moves_no_side_view():
    scene = flight()
    far = torch.tensor([[900.0, -700.0, -50.0]]).double()
    strayed = sparse_points(torch.cat([scene.points.positions, far]))
    eyes, others = (
        torch.stack([one.centre for one in side_cameras(of, SMALL)])
        for of in (scene, replace(scene, points=strayed))
    )
    assert_close(others, eyes, atol=0.1, rtol=0)


@given(count=st.integers(1, 12), up=st.integers(0, 2))
def test_the_parts_are_as_many_and_cover_the_ground_once(count, up):
    generator = torch.Generator().manual_seed(count)
    points = torch.rand(300, 3, generator=generator).double()
    axis = torch.eye(3, dtype=torch.float64)[up]
    found = parts(points, axis, count)
    ((low, high),) = parts(points, axis, 1)
    assert len(found) == count
    volume = sum(float((b - a).prod()) for a, b in found)
    assert volume == pytest.approx(float((high - low).prod()))
    assert all(torch.equal((b - a)[up], (high - low)[up]) for a, b in found)


def test_there_are_no_side_views_without_ground_or_height():
    scene = flight()
    assert (
        side_cameras(replace(scene, points=sparse_points(torch.zeros(0, 3).double())), SMALL) == ()
    )
    below = replace(scene, up=-scene.up)
    assert side_cameras(below, SMALL) == ()


@given(
    photos=st.integers(1, 6), sides=st.integers(1, 5), steps=st.integers(2, 80),
    every=st.integers(1, 7), refresh=st.integers(1, 30), views=st.integers(1, 3),
)  # fmt: skip
def test_every_nth_step_of_the_second_half_begins_with_a_side_view_of_its_round(
    photos, sides, steps, every, refresh, views
):
    order = SideOrder(
        photos, sides, steps=steps, every=every, refresh=refresh, views_per_step=views
    )
    generator = torch.Generator().manual_seed(0)
    for step in range(steps):
        drawn = [order.next(generator) for _ in range(views)]
        since = step - steps // 2
        sided = since >= 0 and since % every == 0
        assert [index >= photos for index in drawn] == [sided, *[False] * (views - 1)]
        if sided:
            number = (drawn[0] - photos) // sides
            assert number == since // refresh < order.rounds


def test_an_order_goes_on_where_it_stopped():
    def fresh() -> SideOrder:
        return SideOrder(5, 4, steps=40, every=3, refresh=8, views_per_step=1)

    whole, generator = fresh(), torch.Generator().manual_seed(1)
    want = [whole.next(generator) for _ in range(40)]
    for stop in (0, 7, 20, 33):
        first, generator = fresh(), torch.Generator().manual_seed(1)
        have = [first.next(generator) for _ in range(stop)]
        again = fresh()
        again.restore(first.state(), stop)
        assert have + [again.next(generator) for _ in range(40 - stop)] == want
    off = SideOrder(5, 4, steps=40, every=0, refresh=8, views_per_step=1)
    assert max(off.next(generator) for _ in range(40)) < 5
    assert off.rounds == 0


class Wall:
    """A wall at z = 4 before all cameras of the row, black but for the left half of its views."""

    def __init__(self, depth: float = 4.0) -> None:
        self.drawn: list[str] = []
        self.depth = depth

    def __call__(self, view: View) -> RenderOutput:
        self.drawn.append(view.name)
        height, width = view.size
        solid = torch.ones(height, width)
        if view.name.startswith("side"):
            solid[:, : width // 4] = 0.2  # a hole
        return RenderOutput(
            colour=0.5 * solid[..., None].expand(height, width, 3), alpha=solid,
            depth=torch.full((height, width), self.depth), radii=torch.zeros(0),
        )  # fmt: skip


def side_views(
    refiner, folder=None, told=lambda number, share: None, photos=None, *, holes=True
) -> SideViews:
    middle: Camera = camera(2)
    views = tiny_scene().train_views if photos is None else photos
    refine = read_refiner(SideSettings(refiner=refiner))
    return SideViews([middle, middle], views, Wall(), refine, folder, told, holes=holes)


def test_a_target_is_the_photos_texture_and_what_is_proven_is_left_to_photos():
    shares = {}
    made = side_views("warp", told=shares.__setitem__)
    first, *_ = made.views(1)
    assert first.load_mask is not None
    target, unproven = first.load(), first.load_mask()
    (same,) = [v for v in tiny_scene().views if torch.equal(v.camera.centre, camera(2).centre)]
    solid = slice(24 // 4, None)
    # 8 bits, and a bilinear sample at pixel centres that are hit to 1e-6
    torch.testing.assert_close(
        target[:, solid], same.load()[:, solid], atol=0.5 / 255 + 1e-3, rtol=0
    )
    assert unproven[:, : 24 // 4].all()
    assert not unproven[:, 8:20].any()
    assert shares == {0: pytest.approx(float(unproven.float().mean()))}


def test_our_own_network_corrects_the_warp_and_leaves_what_is_proven_as_it_was():
    warped, *_ = side_views("warp").views(1)
    refined, *_ = side_views("own").views(1)
    assert warped.load_mask is not None
    assert refined.load_mask is not None
    assert torch.equal(warped.load_mask(), refined.load_mask())
    assert 0.5 / 255 < float((warped.load() - refined.load()).abs().mean()) < 0.3


def test_holes_are_left_alone_unless_asked_for():
    shares = {}
    with_holes, without = (
        side_views("warp", holes=True),
        side_views("warp", told=shares.__setitem__, holes=SideSettings().holes),
    )
    (first, *_), (other, *_) = with_holes.views(1), without.views(1)
    assert first.load_mask is not None
    assert other.load_mask is not None
    hole = torch.zeros_like(first.load_mask())
    hole[:, : 24 // 4] = True
    assert (first.load_mask() & hole).any()
    assert torch.equal(other.load_mask(), first.load_mask() & ~hole)
    assert torch.equal(other.load(), first.load())
    assert shares == {0: pytest.approx(float(other.load_mask().float().mean()))}


def test_without_a_refiner_the_target_is_the_render_and_no_photo_is_read():
    def unread() -> torch.Tensor:
        raise AssertionError("a photo was read")

    photos = [replace(view, load=unread) for view in tiny_scene().train_views]
    first, *_ = side_views("none", photos=photos).views(1)
    assert float((first.load()[:, 8:] - 0.5).abs().max()) <= 0.51 / 255


def test_one_photo_proves_nothing():
    (photo,) = tiny_scene().train_views[:1]
    first, *_ = side_views("warp", photos=(photo,)).views(1)
    assert first.load_mask is not None
    assert first.load_mask().all()


def test_a_round_is_made_once_and_found_again(tmp_path):
    made = side_views("warp", tmp_path)
    views = made.views(2)
    assert len({view.name for view in views}) == len(views) == 4
    targets = [view.load() for view in views[:2]]
    assert isinstance(made.draw, Wall)
    count = len(made.draw.drawn)
    # each photo, each side view before and after, and the photo that guides both
    assert count == 5 + 2 + 2 + 1
    views[3].load()
    assert len(made.draw.drawn) == 2 * count
    shares = {}
    again = side_views("none", tmp_path, shares.__setitem__)  # reads what is there
    assert all(torch.equal(v.load(), t) for v, t in zip(again.views(1), targets, strict=True))
    assert isinstance(again.draw, Wall)
    assert again.draw.drawn == []
    assert shares.keys() == {0}


@pytest.mark.parametrize("content", [b"cut short", None])
def test_a_round_whose_file_is_damaged_or_something_else_is_made_again(tmp_path, content):
    want = [view.load() for view in side_views("warp").views(1)]
    file = tmp_path / "0.safetensors"
    if content is None:
        write_tensors(file, {"targets": torch.zeros(1)})
    else:
        file.write_bytes(content)
    found = [view.load() for view in side_views("warp", tmp_path).views(1)]
    assert all(map(torch.equal, found, want))
    assert read_tensors(file)[0].keys() == {"targets", "unproven"}


def test_what_photos_mask_is_neither_evidence_nor_texture():
    """Photos that are masked all over prove nothing and paint nothing: the render stays."""
    blind = [
        replace(view, load_mask=lambda: torch.zeros(18, 24).bool())
        for view in tiny_scene().train_views
    ]
    first, *_ = side_views("warp", photos=blind).views(1)
    assert first.load_mask is not None
    assert first.load_mask().all()
    assert float((first.load()[:, 8:] - 0.5).abs().max()) <= 0.51 / 255


def test_the_unit_of_the_scene_does_not_matter():
    def found(unit: float) -> tuple[torch.Tensor, torch.Tensor]:
        def larger(lens: Camera) -> Camera:
            pose = lens.world_to_camera.clone()
            pose[:3, 3] *= unit
            return replace(lens, world_to_camera=pose)

        photos = [replace(v, camera=larger(v.camera)) for v in tiny_scene().train_views]
        made = SideViews(
            [larger(camera(2))], photos, Wall(4.0 * unit), warp_and_fill, None,
            lambda number, share: None, holes=True,
        ).round(0)  # fmt: skip
        return made["targets"], made["unproven"]

    want = found(1.0)
    assert not want[1].all()
    for unit in (2.0**17, 2.0**-6):
        assert all(map(torch.equal, found(unit), want))


def test_views_of_thousands_of_photos_are_not_kept():
    alive: weakref.WeakSet[torch.Tensor] = weakref.WeakSet()
    most, wall = 0, Wall()

    def draw(view: View) -> RenderOutput:
        nonlocal most
        output = wall(view)
        alive.add(output.depth)
        most = max(most, len(alive))
        return output

    photos = tiny_scene(views=21).train_views
    assert len(list(Guide(photos, draw).of([camera(2)]))) == 1
    assert most <= 4  # of 20 photos


def test_a_photo_that_guides_its_neighbours_is_read_once_and_no_more_than_a_few_are_kept():
    read = []

    def counting(index: int, view: View) -> View:
        return replace(view, load=lambda: read.append(index) or view.load())

    given = tiny_scene(views=KEPT + 3).train_views
    guide = Guide([counting(index, view) for index, view in enumerate(given)], Wall())
    first = guide.texture(0)
    assert guide.texture(1).camera is given[1].camera
    assert guide.texture(0) is first
    assert read == [0, 1]
    for index in range(2, KEPT + 1):  # the oldest, which is 1 now, goes
        guide.texture(index)
    assert guide.texture(0) is first
    guide.texture(1)
    assert read == [*range(KEPT + 1), 1]
    again = Guide(given, Wall()).texture(1)
    assert torch.equal(guide.texture(1).image, again.image)


def test_a_photos_exposure_is_taken_from_it():
    photos = tiny_scene().train_views
    dark = [replace(view, load=lambda view=view: 0.5 * view.load()) for view in photos]
    made = SideViews(
        [camera(2)], dark, Wall(), warp_and_fill, None, lambda number, share: None,
        lambda view, photo: 2 * photo, holes=True,
    ).round(0)  # fmt: skip
    want = side_views("warp").round(0)
    assert torch.equal(made["targets"][0], want["targets"][0])
