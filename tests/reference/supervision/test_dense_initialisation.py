import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from torch import Tensor
from torch.testing import assert_close

from helpers.tiny_scene import sparse_points
from splatproof.base.errors import UsageError
from splatproof.reference.supervision import dense_initialisation as dense
from splatproof.reference.supervision.dense_matching import match_by_flow, plane_between
from splatproof.reference.types.camera import Camera, project_points

D = torch.float64
SETTINGS = dense.DenseSettings()


def camera(x: float, width: int = 64, height: int = 48) -> Camera:
    pose = torch.eye(4, dtype=D)
    pose[0, 3] = -x
    intrinsics = torch.tensor([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=width, height=height)


def points(n: int, seed: int) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.rand(n, 3, generator=g, dtype=D) * 2 + torch.tensor([-1.0, -1, 4], dtype=D)


@given(n=st.integers(0, 20), seed=st.integers(0, 2**16))
def test_triangulation_finds_the_points_that_were_projected(n, seed):
    a, b, want = camera(0), camera(0.7), points(n, seed)
    got, angle = dense.triangulate(a, b, project_points(a, want)[0], project_points(b, want)[0])
    assert_close(got, want, atol=1e-9, rtol=0)
    for i in range(n):  # the angle by the law of cosines
        p, q = want[i] - a.centre, want[i] - b.centre
        cosine = float((p @ p + q @ q - 0.49) / (2 * p.norm() * q.norm()))
        assert float(angle[i]) == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)


@given(n=st.integers(1, 10), seed=st.integers(0, 2**16))
def test_triangulation_matches_opencv_under_noise(n, seed):
    a, b, want = camera(0), camera(0.7), points(n, seed)
    noise = torch.randn(2, n, 2, generator=torch.Generator().manual_seed(seed), dtype=D)
    at = [project_points(c, want)[0] + e for c, e in zip((a, b), noise, strict=True)]
    flat = [(u - c.K[:2, 2]) / 60.0 for c, u in zip((a, b), at, strict=True)]
    # OpenCV takes the frame it is given: the one with camera A at the origin and baseline 1
    other = b.world_to_camera[:3].clone()
    other[:, 3] /= 0.7
    found = cv2.triangulatePoints(
        a.world_to_camera[:3].numpy(), other.numpy(), flat[0].T.numpy(), flat[1].T.numpy()
    )
    oracle = 0.7 * torch.from_numpy(found[:3] / found[3:]).T
    assert_close(dense.triangulate(a, b, at[0], at[1])[0], oracle.to(D), atol=1e-6, rtol=1e-6)


@given(
    seed=st.integers(0, 2**16), scale=st.floats(0.01, 100),
    by=st.tuples(*[st.floats(-100, 100)] * 3),
)  # fmt: skip
def test_noisy_matches_give_the_same_points_wherever_the_scene_lies(seed, scale, by):
    """Moved, turned and scaled scenes; noise, because without it any frame gives the truth."""
    g = torch.Generator().manual_seed(seed)
    a, b = camera(0), camera(0.7)
    noise = torch.randn(2, 8, 2, generator=g, dtype=D)
    at = [project_points(c, points(8, seed))[0] + e for c, e in zip((a, b), noise, strict=True)]
    turn = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=D)).Q
    turn = turn * torch.linalg.det(turn)
    shift = torch.tensor(by, dtype=D)
    placed = []
    for one in (a, b):
        pose = torch.eye(4, dtype=D)
        pose[:3, :3] = one.rotation @ turn.T
        pose[:3, 3] = scale * one.world_to_camera[:3, 3] - pose[:3, :3] @ shift
        placed.append(replace(one, world_to_camera=pose))
    want, angle = dense.triangulate(a, b, at[0], at[1])
    got, angle_there = dense.triangulate(placed[0], placed[1], at[0], at[1])
    assert_close(angle_there, angle)
    # noise of a pixel moves a point to a hundred baselines away at times, where 1e-16 weighs more
    near = want.norm(dim=1) < 100
    back = (got - shift) @ turn / scale
    assert_close(back[near], want[near], atol=1e-6, rtol=1e-6)


unit = st.floats(0, 1)
error = st.floats(0, 20)


@given(certainty=unit, a=error, b=error, more=st.floats(0, 5), sigma=st.floats(0.1, 5))
def test_score_is_bounded_and_falls_with_either_error(certainty, a, b, more, sigma):
    def score(first: float, second: float) -> float:
        c, e, f = (torch.tensor([x], dtype=D) for x in (certainty, first, second))
        return float(dense.reliability(c, e, f, sigma))

    assert 0 <= score(a, b) <= certainty
    assert score(0, 0) == certainty
    assert score(a + more, b) <= score(a, b)
    assert score(a, b + more) <= score(a, b)
    assert score(a, b) == pytest.approx(score(b, a))


def test_score_by_hand():
    # 0.8 exp(-(1 + 4) / (2 * 4)) = 0.8 exp(-0.625) = 0.42821
    s = dense.reliability(*(torch.tensor([x], dtype=D) for x in (0.8, 1.0, 2.0)), sigma=2.0)
    assert float(s) == pytest.approx(0.42821, abs=1e-5)


def plane_pair(depth: float = 5.0, x: float = 0.5):
    """A fronto-parallel plane: the true warp is a constant shift of -60 x / depth pixels."""
    a, b = camera(0), camera(x)
    warp = torch.zeros(48, 64, 2, dtype=D)
    warp[..., 0] = -60.0 * x / depth
    image = torch.rand(48, 64, 3, generator=torch.Generator().manual_seed(0))
    return a, b, image, warp


def test_a_true_warp_gives_the_plane_with_full_score():
    a, b, image, warp = plane_pair()
    got = dense.points_of_pair(a, b, image, warp, torch.full((48, 64), 0.9), SETTINGS)
    assert len(got.scores) == 48 * (64 - 6)  # the left six columns leave image B
    assert_close(got.positions[:, 2], torch.full_like(got.scores, 5.0))
    assert_close(got.scores, torch.full_like(got.scores, 0.9), atol=1e-6, rtol=0)
    assert_close(got.colours, image[:, 6:].reshape(-1, 3))
    first = project_points(a, got.positions[:1])[0][0]
    assert_close(first, torch.tensor([6.5, 0.5], dtype=D))  # the centre of the first pixel kept


def test_uncertain_matches_change_nothing():
    a, b, image, warp = plane_pair()
    certainty = torch.full((48, 64), 0.9)
    certainty[:, 30:] = SETTINGS.certainty - 1e-6
    lenient = dense.DenseSettings(score=0.0)  # only the certainty may drop them
    got = dense.points_of_pair(a, b, image, warp, certainty, lenient)
    wild = warp.clone()
    wild[:, 30:] = 7.0
    again = dense.points_of_pair(a, b, image, wild, certainty, lenient)
    assert len(got.scores) == 48 * 24
    assert_close(again.positions, got.positions)


@pytest.mark.parametrize(
    ("x", "shift"),
    [(0.0, 0.0), (0.5, 3.0), (0.05, -0.6)],
    ids=["one place", "behind the cameras", "rays nearly parallel"],
)
def test_matches_that_prove_nothing_give_no_points(x, shift):
    a, b, image, warp = plane_pair(x=max(x, 0.01))
    b = camera(x)
    warp[..., 0] = shift
    got = dense.points_of_pair(a, b, image, warp, torch.ones(48, 64), SETTINGS)
    assert len(got.scores) == 0


def test_points_off_the_epipolar_line_are_scored_down():
    a, b, image, warp = plane_pair()
    warp[..., 1] = 4.0  # two pixels in each image: exp(-(4 + 4) / 2) = 0.018 < 0.3
    got = dense.points_of_pair(a, b, image, warp, torch.ones(48, 64), SETTINGS)
    assert len(got.scores) == 0


@given(n=st.integers(0, 40), seed=st.integers(0, 2**16), size=st.floats(0.05, 3))
def test_voxel_merge_is_the_weighted_mean_of_each_voxel(n, seed, size):
    g = torch.Generator().manual_seed(seed)
    cloud = dense.DensePoints(
        positions=points(n, seed),
        colours=torch.rand(n, 3, generator=g, dtype=D),
        scores=0.1 + torch.rand(n, generator=g, dtype=D),
    )
    got = dense.merge_in_voxels(cloud, size)
    cells: dict[tuple, list[int]] = {}
    for i in range(n):
        low = cloud.positions.amin(dim=0)
        cells.setdefault(tuple(((cloud.positions[i] - low) / size).floor().tolist()), []).append(i)
    assert len(got.scores) == len(cells)
    for k, members in enumerate(cells[key] for key in sorted(cells)):
        weight = cloud.scores[members] / cloud.scores[members].sum()
        assert_close(got.positions[k], weight @ cloud.positions[members])
        assert_close(got.colours[k], weight @ cloud.colours[members])
        assert float(got.scores[k]) == float(cloud.scores[members].max())


def test_the_same_pair_twice_does_not_grow_the_cloud():
    a, b, image, warp = plane_pair()
    once = dense.points_of_pair(a, b, image, warp, torch.ones(48, 64), SETTINGS)
    twice = dense.DensePoints(
        positions=once.positions.repeat(2, 1), colours=once.colours.repeat(2, 1),
        scores=once.scores.repeat(2),
    )  # fmt: skip
    first, second = dense.merge_in_voxels(once, 0.2), dense.merge_in_voxels(twice, 0.2)
    assert_close(first.positions, second.positions)


def sparse(seen: Tensor) -> csr_array:
    return csr_array(seen.numpy())


def test_pairs_are_the_most_covisible_at_a_useful_angle():
    cloud = points(30, 1)
    centres = torch.tensor([[0.0, 0, 0], [0.01, 0, 0], [0.5, 0, 0], [60.0, 0, 5]], dtype=D)
    seen = torch.ones(4, 30, dtype=torch.bool)
    seen[2, 20:] = False
    # 0-1: too close; 3 sees all from 90 degrees: too far; 0-2 and 1-2 share 20 at about 6 degrees.
    assert dense.select_pairs(centres, cloud, sparse(seen), SETTINGS) == [(0, 2), (1, 2)]
    seen[2] = False
    assert dense.select_pairs(centres, cloud, sparse(seen), SETTINGS) == []


@given(partners=st.integers(1, 3), seed=st.integers(0, 2**10))
@settings(max_examples=20)
def test_no_image_asks_for_more_partners_than_set(partners, seed):
    g = torch.Generator().manual_seed(seed)
    centres = torch.rand(6, 3, generator=g, dtype=D)
    seen = torch.rand(6, 40, generator=g) > 0.4
    few = dense.DenseSettings(partners=partners, angles=(0.0, 180.0))
    pairs = dense.select_pairs(centres, points(40, seed), sparse(seen), few)
    assert len(pairs) <= 6 * partners
    assert all(a < b for a, b in pairs)
    assert pairs == sorted(set(pairs))


def pairs_of_a_dense_matrix(centres: Tensor, cloud: Tensor, seen: Tensor, chosen):
    """The definition read aloud: all views against all views, over a views x points matrix."""
    shared = seen.double() @ seen.double().T
    shared.fill_diagonal_(0)
    pairs = set()
    for a in range(len(centres)):
        found = 0
        for b in torch.sort(shared[a], descending=True, stable=True).indices.tolist():
            if found == chosen.partners or shared[a, b] == 0:
                break
            median = cloud[seen[a] & seen[b]].median(dim=0).values
            to_a, to_b = centres[a] - median, centres[b] - median
            across = torch.linalg.cross(to_a, to_b).norm()
            angle = float(torch.rad2deg(torch.atan2(across, to_a @ to_b)))
            if chosen.angles[0] <= angle <= chosen.angles[1]:
                pairs.add((min(a, b), max(a, b)))
                found += 1
    return sorted(pairs)


@given(
    views=st.integers(1, 9), n=st.integers(0, 60), partners=st.integers(1, 4),
    share=st.floats(0.05, 0.9), seed=st.integers(0, 2**16),
)  # fmt: skip
def test_sparse_counting_chooses_the_same_pairs(views, n, partners, share, seed):
    g = torch.Generator().manual_seed(seed)
    centres = 3 * torch.rand(views, 3, generator=g, dtype=D)
    seen = torch.rand(views, n, generator=g) < share
    cloud, chosen = points(n, seed), dense.DenseSettings(partners=partners)
    tracks = replace(
        sparse_points(cloud),
        track_starts=torch.cat([torch.zeros(1, dtype=torch.int64), seen.sum(dim=0).cumsum(0)]),
        track_views=torch.where(seen.T)[1],
    )
    turned = dense.observations(tracks, views)
    assert np.array_equal(turned.toarray(), seen.numpy())
    for a in range(views):
        assert torch.equal(dense.points_of(turned, a), torch.where(seen[a])[0])
        for b in range(views):
            assert torch.equal(dense.seen_by_both(turned, a, b), torch.where(seen[a] & seen[b])[0])
    want = pairs_of_a_dense_matrix(centres, cloud, seen, chosen)
    assert dense.select_pairs(centres, cloud, turned, chosen) == want


LARGE = """
import resource, torch
from splatproof.reference.supervision import dense_initialisation as dense
from splatproof.reference.types.scene import SparsePoints

torch.set_num_threads(1)
views, n, length = 2_000, 500_000, 5
used = int(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmData")))
limit = used * 1024 + 350 * 2**20
resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
first = torch.arange(n) * (views - length + 1) // n
points = SparsePoints(
    positions=torch.stack([first.double(), torch.arange(n).double() % 7, torch.zeros(n)], dim=1),
    colours=torch.zeros(n, 3, dtype=torch.uint8),
    track_starts=torch.arange(n + 1) * length,
    track_views=(first[:, None] + torch.arange(length)).flatten(),
)
centres = torch.zeros(views, 3, dtype=torch.float64)
centres[:, 0], centres[:, 2] = torch.arange(views), 10
seen = dense.observations(points, views)
print(len(dense.select_pairs(centres, points.positions, seen, dense.DenseSettings())))
"""
"""A drone's strip of 2,000 photos, every point in five in a row, in a process that may take 350 MiB
more than its libraries. Measured of twice as many points: 400 MiB are enough, 350 are not; the scene itself
has 36. A boolean views x points matrix alone is 950 MiB."""


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on a process's memory")
def test_pairs_of_a_large_scene_take_little_memory():
    done = subprocess.run(
        [sys.executable, "-c", LARGE], check=False, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    # each photo's four partners are the two on either side; the ends find theirs further in
    assert 2 * 2_000 <= int(done.stdout) <= 2 * 2_000 + 10


def test_rays_at_less_than_the_smallest_angle_give_no_points():
    """1.5 degrees at the default: at depth 18 the rays of the image's middle have 1.59, its edges 1.2."""
    a, b, image, warp = plane_pair(depth=18.0)
    got = dense.points_of_pair(a, b, image, warp, torch.ones(48, 64, dtype=D), SETTINGS)
    rows, columns = torch.meshgrid(torch.arange(48), torch.arange(64), indexing="ij")
    x, y = 18 * (columns.to(D) + 0.5 - 32) / 60, 18 * (rows.to(D) + 0.5 - 24) / 60
    to_a, to_b = (torch.stack([x - at, y, torch.full_like(x, 18)], dim=-1) for at in (0.0, 0.5))
    cosine = (to_a * to_b).sum(dim=-1) / (to_a.norm(dim=-1) * to_b.norm(dim=-1))
    landed = columns + 0.5 - 60 * 0.5 / 18 >= 0
    wide = (torch.rad2deg(torch.arccos(cosine)) >= 1.5) & landed
    assert 0 < int(wide.sum()) < int(landed.sum())
    assert len(got.scores) == int(wide.sum())
    assert_close(got.positions, torch.stack([x, y, 18 + 0 * x], dim=-1)[wide])


@pytest.mark.parametrize(
    ("name", "value"),
    [("certainty", 1.5), ("sigma", 0.0), ("score", float("nan")), ("partners", 0),
     ("angles", (45.0, 2.0)), ("ray_angle", -1.0), ("weights", "w")],
)  # fmt: skip
def test_thresholds_that_mean_nothing_are_refused(name, value):
    with pytest.raises(UsageError, match=name):
        dense.DenseSettings(**{name: value})


def test_weights_are_for_the_matcher_that_has_none_of_its_own():
    with pytest.raises(UsageError, match="weights = '': expected the folder"):
        dense.DenseSettings(matcher="roma")
    assert dense.DenseSettings(matcher="roma", weights="w").weights == "w"
    with pytest.raises(UsageError, match="weights = 'w': expected none: matcher is 'own'"):
        dense.DenseSettings(matcher="own", weights="w")


def textured(seed: int = 0) -> np.ndarray:
    """A smooth random texture, wider than the views that are cut from it."""
    noise = np.random.default_rng(seed).random((120, 220, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return (smooth - smooth.min()) / (smooth.max() - smooth.min())


def test_flow_finds_a_shift_and_is_sure_of_it():
    texture = textured()
    a, b = (torch.from_numpy(texture[:, x : x + 160].copy()) for x in (20, 26))
    warp, certainty = match_by_flow(a, b)
    inner = (slice(10, -10), slice(20, -20))
    assert_close(warp[inner].mean(dim=(0, 1)), torch.tensor([-6.0, 0.0]), atol=0.1, rtol=0)
    assert float(certainty[inner].median()) > 0.8


def test_flow_is_unsure_where_there_is_no_texture_and_where_images_differ():
    texture = textured()
    flat = torch.full((120, 160, 3), 0.5)
    assert float(match_by_flow(flat, flat)[1].max()) == 0
    a, b = torch.from_numpy(texture[:, :160].copy()), torch.from_numpy(textured(9)[:, :160].copy())
    assert float(match_by_flow(a, b)[1].median()) < 0.3


@pytest.mark.parametrize("size", [(1, 1), (40, 7), (7, 40), (11, 11), (8, 12)])
def test_flow_is_sure_of_nothing_in_photos_that_are_too_small_for_it(size):
    height, width = size
    image = torch.from_numpy(textured()[:height, :width].copy())
    warp, certainty = match_by_flow(image, image)
    assert warp.shape == (height, width, 2)
    assert certainty.isfinite().all()
    assert bool(certainty.any()) == (size == (8, 12))


def turned_pair() -> tuple[Tensor, Tensor, Tensor]:
    """Two views of one texture, turned by 40 degrees and moved by half an image; A to B."""
    texture = cv2.resize(textured(3), (640, 360))
    to_a = np.array([[1.0, 0, -150], [0, 1, -100], [0, 0, 1]])
    angle = np.radians(40)
    c, s = np.cos(angle), np.sin(angle)
    to_b = np.array([[c, -s, 20.0], [s, c, -240], [0, 0, 1]])
    views = [cv2.warpPerspective(texture, h, (160, 120)) for h in (to_a, to_b)]
    # warpPerspective counts from pixel centres: shift by half a pixel on both sides
    half = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    plane = half @ to_b @ np.linalg.inv(to_a) @ np.linalg.inv(half)
    a, b = (torch.from_numpy(view) for view in views)
    return a, b, torch.from_numpy(plane / plane[2, 2])


def test_a_homography_lets_flow_match_what_is_turned_and_far_away():
    a, b, plane = turned_pair()
    warp, certainty = match_by_flow(a, b, plane)
    sure = certainty > 0.5
    assert int(sure.sum()) > 1500
    rows, columns = torch.where(sure)
    here = torch.stack([columns, rows], dim=1).double() + 0.5
    lifted = torch.cat([here, torch.ones(len(here), 1, dtype=D)], dim=1) @ plane.T
    want = lifted[:, :2] / lifted[:, 2:]
    off = (here + warp[sure] - want).norm(dim=1)
    assert float(off.median()) < 0.1
    # The control: without the homography hardly anything is found, and what is, is wrong.
    unsure = match_by_flow(a, b)[1]
    found = unsure > 0.5
    assert int((found & sure).sum()) < 0.2 * int(sure.sum())


def test_pixels_that_the_other_image_does_not_reach_are_unsure():
    a, b, plane = turned_pair()
    _, certainty = match_by_flow(a, b, plane)
    rows, columns = torch.meshgrid(torch.arange(120), torch.arange(160), indexing="ij")
    here = torch.stack([columns + 0.5, rows + 0.5, torch.ones_like(rows)], dim=-1).double()
    there = here @ plane.T
    there = there[..., :2] / there[..., 2:]
    outside = ((there < 0) | (there >= torch.tensor([160, 120]))).any(dim=-1)
    assert int(outside.sum()) > 1000
    assert float(certainty[outside].max()) == 0


def test_plane_between_shared_points():
    g = torch.Generator().manual_seed(0)
    here = 100 * torch.rand(30, 2, generator=g, dtype=D)
    plane = torch.tensor([[0.9, -0.2, 5], [0.1, 1.1, -3], [1e-4, 2e-4, 1]], dtype=D)
    lifted = torch.cat([here, torch.ones(30, 1, dtype=D)], dim=1) @ plane.T
    there = lifted[:, :2] / lifted[:, 2:]
    there[0] += 40  # an outlier
    found = plane_between(here, there)
    assert found is not None
    assert_close(found, plane, atol=1e-6, rtol=1e-4)
    assert plane_between(here[:7], there[:7]) is None
