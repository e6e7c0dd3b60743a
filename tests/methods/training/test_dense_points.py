"""Points from matched photos: on the true surface, merged as the reference merges, from training views."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial import KDTree

from helpers.tiny_scene import sparse_points, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.base.files import sha256, tree_sha256
from splatproof.base.typed_toml import build
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.priors.matches import match_by_prior
from splatproof.methods.priors.own_matcher import SHIPPED, MatchNetwork, OwnMatcher
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import dense_points
from splatproof.methods.training.dense_points import Voxels, extended, with_dense_points
from splatproof.methods.training.initialise import with_points
from splatproof.methods.training.matchers import MATCHER, matcher_facts
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.supervision.dense_initialisation import (
    DensePoints,
    DenseSettings,
    merge_in_voxels,
    observations,
    rows_of,
    seen_by_both,
)
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, SparsePoints

CELL = 4.0


@pytest.fixture(scope="module")
def yard() -> Scene:
    """Six neighbouring views of it for training."""
    scene = open_scene("courtyard", load_protocol("quick"))
    return replace(scene, train=scene.train[:6])


@pytest.fixture(scope="module")
def dense(yard: Scene) -> Scene:
    return with_dense_points(yard, CELL, 2**28, DenseSettings())


def edge_of(scene: Scene) -> float:
    """Edge of the voxels in scene units."""
    seen = rows_of(observations(scene.points, len(scene.views)), scene.train)
    return CELL * dense_points.footprint(scene.train_views, scene.points.positions, seen)


@pytest.fixture(scope="module")
def surface(yard: Scene) -> KDTree:
    """What the photos truly show: every pixel of the training views at its true depth."""
    clouds = []
    for view in yard.train_views:
        camera = view.camera
        assert view.load_depth is not None
        rows, columns = torch.meshgrid(
            torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
        )
        pixels = torch.stack([columns + 0.5, rows + 0.5, torch.ones(rows.shape)], dim=-1).double()
        depth = view.load_depth().double()
        local = (pixels @ camera.K.inverse().T) * depth[..., None]
        clouds.append((local[depth > 0] - camera.world_to_camera[:3, 3]) @ camera.rotation)
    return KDTree(torch.cat(clouds).numpy())


def cells_away(scene: Scene, points: torch.Tensor, surface: KDTree) -> np.ndarray:
    """Distance of points to the true surface in cells."""
    return surface.query(points.numpy())[0] / edge_of(scene)


def test_points_lie_on_the_true_surface(yard: Scene, dense: Scene, surface: KDTree):
    own = len(yard.points)
    away = cells_away(yard, dense.points.positions[own:], surface)
    assert len(away) > 1000
    # 0.27 cells (1.1 pixels) at the median and 14 % beyond one cell were measured
    assert np.median(away) < 0.35
    assert (away > 1).mean() < 0.2


def test_the_truth_check_sees_points_that_are_off(yard: Scene, dense: Scene, surface: KDTree):
    """The control: the same points, a cell higher."""
    own = len(yard.points)
    assert yard.up is not None
    raised = dense.points.positions[own:] + edge_of(yard) * yard.up
    assert np.median(cells_away(yard, raised, surface)) > 0.5


def test_own_points_stay_and_tracks_are_whole(yard: Scene, dense: Scene):
    own, points = yard.points, dense.points
    count = len(own)
    assert torch.equal(points.positions[:count], own.positions)
    assert torch.equal(points.colours[:count], own.colours)
    assert torch.equal(points.track_starts[: count + 1], own.track_starts)
    assert int(points.track_starts[-1]) == len(points.track_views)
    for i in range(count, len(points), 50):
        track = points.track_views[points.track_starts[i] : points.track_starts[i + 1]]
        assert len(track) >= 2
        assert torch.equal(track, track.unique())
        assert set(track.tolist()) <= set(yard.train)


def test_held_out_photos_are_not_looked_at(yard: Scene, dense: Scene):
    def forbidden():
        raise AssertionError("a held-out photo was read")

    views = tuple(
        replace(view, load=forbidden) if i in yard.test else view
        for i, view in enumerate(yard.views)
    )
    again = with_dense_points(replace(yard, views=views), CELL, 0, DenseSettings())
    assert torch.equal(again.points.positions, dense.points.positions)


def test_threads_of_the_flow_do_not_matter(yard: Scene, dense: Scene):
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        alone = with_dense_points(yard, CELL, 2**28, DenseSettings())
    finally:
        cv2.setNumThreads(before)
    assert torch.equal(alone.points.positions, dense.points.positions)
    assert torch.equal(alone.points.colours, dense.points.colours)


def test_threads_that_match_do_not_matter(yard: Scene, dense: Scene):
    before = torch.get_num_threads()
    torch.set_num_threads(3 if before == 1 else 1)
    try:
        other = with_dense_points(yard, CELL, 2**28, DenseSettings())
    finally:
        torch.set_num_threads(before)
    assert torch.equal(other.points.positions, dense.points.positions)
    assert torch.equal(other.points.track_views, dense.points.track_views)


def test_a_pair_that_fails_says_so():
    def work(pair: tuple[int, int]) -> DensePoints:
        raise UsageError(f"pair {pair}")

    with pytest.raises(UsageError, match=r"pair \(0, 1\)"):
        list(dense_points.in_order(work, [(0, 1), (1, 2)]))


def test_matches_beyond_all_voxels_are_no_points():
    far = torch.tensor(
        [[0.5, 0.5, 0.5]] * 4 + [[1e300, 0, 0]] * 4 + [[-(2.0**21), 0, 0]] * 4
    ).double()
    voxels = Voxels(1.0, torch.zeros(3))
    voxels.add(
        DensePoints(positions=far, colours=torch.zeros(12, 3), scores=torch.ones(12).double()),
        (0, 1),
    )
    assert voxels.points().positions.tolist() == [[0.5, 0.5, 0.5]]


def test_masked_pixels_give_no_points(yard: Scene):
    """With everything masked but the left half, no point is seen first in a right half."""
    camera = yard.train_views[0].camera
    left = torch.zeros(camera.height, camera.width, dtype=torch.bool)
    left[:, : camera.width // 2] = True
    views = tuple(replace(view, load_mask=left.clone) for view in yard.views)
    a, b = replace(yard, views=views).train_views[:2]
    seen = observations(yard.points, len(yard.views))
    shared = yard.points.positions[seen_by_both(seen, yard.train[0], yard.train[1])]
    images = dense_points.ImageCache(0)
    found = dense_points.match(a, b, shared, images, DenseSettings())
    at, _ = project_points(a.camera, found.positions)
    assert len(at) > 100
    # triangulation moves a point by up to a pixel or two from the pixel it was matched at
    assert float(at[:, 0].max()) < camera.width // 2 + 3


def test_pixels_that_are_masked_in_the_other_photo_give_no_points(yard: Scene):
    """What is hidden there is not what the first photo shows, however alike it looks."""
    a, b = yard.train_views[:2]
    left = torch.zeros(b.size, dtype=torch.bool)
    left[:, : b.camera.width // 2] = True
    seen = observations(yard.points, len(yard.views))
    shared = yard.points.positions[seen_by_both(seen, yard.train[0], yard.train[1])]
    images = dense_points.ImageCache(2**28)
    open_, found = (
        dense_points.match(a, one, shared, images, DenseSettings())
        for one in (b, replace(b, load_mask=left.clone))
    )
    at, _ = project_points(b.camera, open_.positions)
    assert 100 < len(found.positions) < len(open_.positions)
    # those well to the left of the wall stay, all of them
    assert len(found.positions) >= int((at[:, 0] < b.camera.width // 2 - 3).sum())
    at, _ = project_points(b.camera, found.positions)
    assert float(at[:, 0].max()) < b.camera.width // 2 + 3


def test_a_match_is_where_its_warp_lands():
    mask = torch.tensor([[True, False, True], [False, True, True]])
    nowhere, far = float("nan"), float("inf")
    warp = torch.tensor(
        [[[0.0, 0.0], [0.4, 0.0], [-1.6, 1.4]], [[1.6, -1.0], [nowhere, far], [-far, 0.0]]]
    )
    found = dense_points.landing(mask, warp)
    assert found.dtype == torch.bool
    # pixel (1, 0) lands in itself, (2, 0) at (0.9, 1.9), (0, 1) at (2.1, 0.5)
    assert found[0].tolist() == [True, False, False]
    assert bool(found[1, 0])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**31), batches=st.integers(1, 4))
def test_voxels_merge_as_the_reference_does(seed: int, batches: int):
    """In any number of batches, on the grid of the reference, which starts at the lowest corner."""
    generator = torch.Generator().manual_seed(seed)
    count = 200
    positions = 5 * torch.rand(count, 3, generator=generator, dtype=torch.float64) - 2
    low = positions.amin(dim=0)
    scores = 0.1 + torch.rand(count, generator=generator, dtype=torch.float64)
    cloud = DensePoints(
        positions=positions, colours=torch.rand(count, 3, generator=generator), scores=scores
    )
    want = merge_in_voxels(cloud, 1.3)
    voxels = Voxels(1.3, low)
    for i, rows in enumerate(torch.arange(count).chunk(batches)):
        part = DensePoints(positions=positions[rows], colours=cloud.colours[rows],
                           scores=scores[rows])  # fmt: skip
        voxels.add(part, (i, i + 1))
    cells = np.floor((positions - low).numpy() / 1.3)
    members = np.unique(cells, axis=0, return_counts=True)[1]
    enough = members >= dense_points.LEAST_MATCHES
    got = voxels.points()
    assert len(got) == enough.sum()
    # the mean of a single point at the corner may be rounded to just below it
    order = np.lexsort(np.floor(((want.positions - low).numpy() / 1.3).clip(min=0)).T[::-1])
    expected = want.positions.numpy()[order][enough]
    assert_allclose(got.positions.numpy(), expected, rtol=0, atol=1e-12)
    colours = want.colours.numpy()[order][enough]
    assert np.abs(got.colours.numpy() / 255 - colours).max() <= 0.5 / 255 + 1e-6


def test_tracks_name_the_views_of_each_voxel():
    def cloud(x: float) -> DensePoints:
        return DensePoints(
            positions=torch.tensor([[x, 0.1, 0.1]] * 4, dtype=torch.float64),
            colours=torch.zeros(4, 3), scores=torch.ones(4, dtype=torch.float64),
        )  # fmt: skip

    voxels = Voxels(1.0, torch.zeros(3))
    voxels.add(cloud(0.5), (3, 5))
    voxels.add(cloud(-7.5), (1, 2))
    voxels.add(cloud(0.2), (5, 8))
    points = voxels.points()
    assert points.positions[:, 0].tolist() == pytest.approx([-7.5, 0.35])
    assert points.track_starts.tolist() == [0, 2, 5]
    assert points.track_views.tolist() == [1, 2, 3, 5, 8]


def moved(scene: Scene, by: torch.Tensor) -> Scene:
    """Cameras and points together, somewhere else."""
    views = []
    for view in scene.views:
        pose = view.camera.world_to_camera.clone()
        pose[:3, 3] -= view.camera.rotation @ by
        views.append(replace(view, camera=replace(view.camera, world_to_camera=pose)))
    points = replace(scene.points, positions=scene.points.positions + by)
    return replace(scene, views=tuple(views), points=points)


@pytest.mark.parametrize(
    "cells",
    [pytest.param((0.37, 0.0, 0.0), marks=pytest.mark.slow), (-120.5, 7.71, 40.23)],
    ids=str,
)
def test_a_scene_that_was_moved_gets_the_same_points_moved(
    yard: Scene, cells: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch
):
    """By shares of a voxel, so that a grid that stays behind would cut elsewhere.

    Without the plane that brings photos together: RANSAC and fixed-point resampling make jumps of
    the last bit of its points.
    """
    monkeypatch.setattr(dense_points, "plane_between", lambda *_: None)
    by = edge_of(yard) * torch.tensor(cells, dtype=torch.float64)
    here = with_dense_points(yard, CELL, 2**28, DenseSettings()).points
    there = with_dense_points(moved(yard, by), CELL, 2**28, DenseSettings()).points
    assert len(here) > len(yard.points) + 200
    assert torch.equal(there.track_views, here.track_views)
    off = (there.positions - by - here.positions).norm(dim=1) / edge_of(yard)
    assert float(off.max()) < 1e-9


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    by=st.tuples(*[st.integers(-(2**20), 2**20)] * 3),
)
def test_voxels_move_with_their_corner(seed: int, by: tuple[int, int, int]):
    """On a grid of 2^-20, where adding is exact: the same voxels, tracks and, but for rounding, means."""
    generator = torch.Generator().manual_seed(seed)
    at = torch.randint(0, 5 * 2**20, (100, 3), generator=generator) / 2**20
    shift = torch.tensor(by, dtype=torch.float64) * 7 / 2**20
    found = []
    for offset in (torch.zeros(3, dtype=torch.float64), shift):
        cloud = DensePoints(
            positions=at.double() + offset, colours=torch.zeros(100, 3),
            scores=torch.ones(100, dtype=torch.float64),
        )  # fmt: skip
        voxels = Voxels(1.3, offset)
        voxels.add(cloud, (0, 1))
        found.append(voxels.points())
    here, there = found
    assert torch.equal(here.track_views, there.track_views)
    assert_allclose((there.positions - shift).numpy(), here.positions.numpy(), rtol=0, atol=1e-13)


def test_thresholds_of_the_settings_are_obeyed(yard: Scene, dense: Scene):
    strict = Settings(dense_cell=CELL, dense=DenseSettings(partners=1, sigma=0.3))
    fewer = with_points(yard, Run(), dense_cell=strict.dense_cell, dense=strict.dense)
    added = len(dense.points) - len(yard.points)
    assert 0 < len(fewer.points) - len(yard.points) < 0.7 * added


def test_new_points_keep_their_distance():
    scene = replace(tiny_scene(), points=sparse_points(torch.zeros(1, 3, dtype=torch.float64)))
    found = SparsePoints(
        positions=torch.tensor([[0.4, 0, 0], [0.6, 0, 0]], dtype=torch.float64),
        colours=torch.zeros(2, 3, dtype=torch.uint8),
        track_starts=torch.tensor([0, 2, 5]),
        track_views=torch.tensor([1, 2, 1, 3, 4]),
    )
    points = extended(scene, found, 0.5).points
    assert points.positions[:, 0].tolist() == pytest.approx([0, 0.6])
    assert points.track_starts.tolist() == [0, 0, 3]
    assert points.track_views.tolist() == [1, 3, 4]


def test_a_scene_without_tracks_is_returned_as_it_is():
    scene, heard = tiny_scene(), []
    assert with_dense_points(scene, CELL, 2**28, DenseSettings()) is scene
    assert with_points(scene, Run(say=heard.append), dense_cell=CELL) is scene
    (line,) = heard
    assert "for no sparse point says which training views see it; dense_cell 0 goes" in line


def in_tracks(*tracks: tuple[int, ...]) -> Scene:
    """The tiny scene, the points of which are seen by the views of a track each."""
    scene = tiny_scene(points=len(tracks))
    starts = torch.tensor([0, *(len(track) for track in tracks)]).cumsum(0)
    views = torch.tensor([view for track in tracks for view in track])
    return replace(scene, points=replace(scene.points, track_starts=starts, track_views=views))


ALONE = replace(in_tracks(*[(0, 1), (1, 2)] * 5), train=(1,))
APART = in_tracks(*[(1,), (2,), (3,), (5,), (0, 4)] * 2)


@pytest.mark.parametrize(
    ("scene", "why"),
    [(ALONE, "the only training view has no partner"),
     (APART, "no two of 5 training views see the same sparse points under 2 to 45 degrees (dense.angles)")],
)  # fmt: skip
def test_where_photos_cannot_be_matched_one_line_says_so_and_training_goes_on(scene, why):
    line = (
        f"dense_cell 4: no points of matched photos are added, for {why}; dense_cell 0 goes without"
    )
    for name in ("dpgs", "fsgs", "dropgaussian", "cor-gs", "3dgs"):
        heard: list[str] = []
        method = get_method(name)
        more = {"side": {"every": 0}} if name == "dpgs" else {}
        given = {"iterations": 1, "sh_degree": 0, "dense_cell": CELL} | more
        chosen = build(method.settings, given, "suite.toml")
        method.fit(scene, chosen, Run(threads=1, say=heard.append))
        assert heard == [line]


def test_where_no_match_becomes_a_point_one_line_says_so(yard: Scene):
    heard: list[str] = []
    few = replace(yard, train=yard.train[:2])
    made = with_dense_points(few, CELL, 2**28, DenseSettings(certainty=1.0), heard.append)
    assert len(made.points) == len(yard.points)
    (line,) = heard
    assert "for 1 pairs of photos gave none that is sure" in line
    assert line.endswith("dense_cell 0 goes without")


def test_a_point_far_beyond_all_others_takes_no_match_away(yard: Scene):
    """Structure from motion leaves such points; the voxels' corner went there, and all matches were beyond reach."""
    few = replace(yard, train=yard.train[:2])
    seen = rows_of(observations(few.points, len(few.views)), few.train)
    positions = few.points.positions.clone()
    positions[int(seen.indices[0])] -= 1e5 * (positions.amax(dim=0) - positions.amin(dim=0))
    heard: list[str] = []
    far = replace(few, points=replace(few.points, positions=positions))
    added = [
        len(with_dense_points(one, CELL, 2**28, DenseSettings(), heard.append).points)
        for one in (few, far)
    ]
    assert heard == []
    assert added[1] == pytest.approx(added[0], rel=0.01)


def test_points_that_are_added_need_no_words(yard: Scene):
    heard: list[str] = []
    few = replace(yard, train=yard.train[:2])
    assert len(with_dense_points(few, CELL, 2**28, DenseSettings(), heard.append).points) > 0
    assert heard == []


def test_roma_matches_every_pair_by_one_network_whose_weights_are_told(
    yard: Scene, monkeypatch, tmp_path
):
    """A network that says what true depths say gives the points that these give."""
    scene = with_priors(replace(yard, train=yard.train[:3]), "oracle", 0)
    seen, loaded, asked = observations(scene.points, len(scene.views)), [], []
    photos = {index: scene.views[index].load() for index in scene.train}

    def load(folder):
        loaded.append(folder)

        def says(image_a, image_b):
            a, b = (
                next(index for index, photo in photos.items() if torch.equal(photo, image))
                for image in (image_a, image_b)
            )
            asked.append((a, b))
            shared = scene.points.positions[seen_by_both(seen, a, b)]
            return match_by_prior(scene.views[a], scene.views[b], shared)

        return says

    monkeypatch.setattr(dense_points, "load_matcher", load)
    (tmp_path / "w").write_text("weights")
    facts: dict[str, str] = {}
    run, chosen = (
        Run(on_fact=facts.__setitem__),
        DenseSettings(matcher="roma", weights=str(tmp_path)),
    )
    found = with_points(scene, run, dense_cell=CELL, dense=chosen)
    true = with_points(scene, Run(), dense_cell=CELL, dense=DenseSettings(matcher="prior"))
    assert loaded == [tmp_path]
    assert len(set(asked)) == len(asked) > 1
    assert len(found.points) > len(scene.points)
    assert torch.equal(found.points.positions, true.points.positions)
    assert facts == {"matcher": f"weights {tree_sha256(tmp_path)}"}


class TrueMatcher(OwnMatcher):
    """Says what the depth priors of the views of two cameras say."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(MatchNetwork())
        self.scene = scene

    def __call__(self, first, second, image, other, shared):
        a, b = (
            next(view for view in self.scene.views if view.camera is camera)
            for camera in (first, second)
        )
        assert torch.equal(image, a.load())
        assert torch.equal(other, b.load())
        return match_by_prior(a, b, shared)


def test_our_own_network_is_told_cameras_photos_and_points_and_the_record_its_domain(
    yard: Scene, monkeypatch
):
    """A network that says what true depths say gives the points that these give."""
    scene = with_priors(replace(yard, train=yard.train[:2]), "oracle", 0)
    monkeypatch.setattr(dense_points, "load_own_matcher", lambda: TrueMatcher(scene))
    facts: dict[str, str] = {}
    run = Run(on_fact=facts.__setitem__)
    found = with_points(scene, run, dense_cell=CELL, dense=DenseSettings(matcher="own"))
    true = with_points(scene, Run(), dense_cell=CELL, dense=DenseSettings(matcher="prior"))
    assert len(found.points) > len(scene.points)
    assert torch.equal(found.points.positions, true.points.positions)
    (said,) = facts.values()
    assert said.startswith("in domain: trained on courtyard, aerial-sparse, used on courtyard; ")
    assert said.endswith(f"weights {sha256(SHIPPED)}")
    elsewhere = replace(scene, facts={"world": "city"})
    with_points(elsewhere, run, dense_cell=CELL, dense=DenseSettings(matcher="own"))
    assert facts["matcher"].startswith(
        "out of domain: trained on courtyard, aerial-sparse, used on"
    )


def test_whose_weights_match_is_a_fact_of_a_case(tmp_path):
    own = DenseSettings(matcher="own")
    assert matcher_facts(Settings(dense_cell=4.0, dense=own)) == {MATCHER: sha256(SHIPPED)}
    roma = DenseSettings(matcher="roma", weights=str(tmp_path))
    (tmp_path / "w").write_text("weights")
    assert matcher_facts(Settings(dense_cell=4.0, dense=roma)) == {MATCHER: tree_sha256(tmp_path)}
    assert matcher_facts(Settings(dense=own)) == {}
    assert matcher_facts(Settings(dense_cell=4.0)) == {}
    assert matcher_facts(object()) == {}


@pytest.mark.parametrize("wrong", [-1.0, float("nan"), float("inf")])
def test_an_impossible_cell_is_refused(wrong: float):
    with pytest.raises(UsageError, match="dense_cell"):
        Settings(dense_cell=wrong)


def test_a_cloud_of_no_pair_is_empty():
    points = Voxels(1.0, torch.zeros(3).double()).points()
    assert len(points) == 0
    assert points.positions.dtype == torch.float64
