import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from splatproof.datasets.ingesting.alignment import Alignment, align, local_metres

DOWN = np.diag([1.0, -1.0, -1.0])


def flight(seed: int, *, tilt: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """(rotations, centres) of a nadir survey in metres, z up: 5 strips of 8 photos at 80 m."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(8) * 20.0, np.arange(5) * 25.0), -1).reshape(-1, 2)
    centres = np.column_stack([grid, 80 + rng.normal(0, 0.5, len(grid))])
    shaken = Rotation.from_rotvec(rng.normal(0, tilt, (len(grid), 3))).as_matrix()
    return shaken @ DOWN, centres


def in_sfm_frame(rotations: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    turn = Rotation.from_rotvec([0.7, -1.1, 2.0]).as_matrix()
    return rotations @ turn.T, (0.07 * centres + [3.0, -1.0, 2.0]) @ turn.T


def errors(found: Alignment, centres: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.array([found.transform * c for c in centres]) - truth, axis=1)


def test_exact_gps_gives_the_exact_frame():
    rotations, truth = flight(0)
    r, c = in_sfm_frame(rotations, truth)
    found = align(r, c, truth, 0)
    assert isinstance(found, Alignment)
    assert found.how == "positions and altitudes"
    assert errors(found, c, truth).max() < 1e-9
    assert found.transform.scale == pytest.approx(1 / 0.07)


def test_noise_and_a_few_wild_positions():
    rotations, truth = flight(1)
    rng = np.random.default_rng(1)
    r, c = in_sfm_frame(rotations, truth)
    gps = truth + rng.normal(0, 0.5, truth.shape)
    gps[[3, 17, 30]] += [[80, 0, 0], [0, -60, 0], [0, 0, 400]]
    found = align(r, c, gps, 0)
    assert isinstance(found, Alignment)
    # 40 positions of 0.5 m each place the frame to about 0.5 sqrt(7 / 40) m
    assert errors(found, c, truth).max() < 0.6
    assert np.sort(found.residuals)[-3:].min() > 50


def test_drifting_altitudes_do_not_tilt_the_scene():
    """A barometer that climbs 100 m over the flight: the camera plane keeps the scene level."""
    rotations, truth = flight(2)
    r, c = in_sfm_frame(rotations, truth)
    gps = truth + np.array([0, 0, 1.0]) * np.linspace(0, 100, len(truth))[:, None]
    found = align(r, c, gps, 0)
    assert isinstance(found, Alignment)
    assert found.how == "positions, levelled by the camera plane"
    off = np.array([found.transform * x for x in c]) - truth
    assert np.abs(off[:, :2]).max() < 0.2
    assert np.ptp(off[:, 2]) < 2.0
    naive = pycolmap.estimate_sim3d(c, gps)  # what the check is for: this one tilts
    assert naive is not None
    assert np.ptp(np.array([naive * x for x in c])[:, 2]) > 20


def test_no_altitudes_at_all():
    rotations, truth = flight(3)
    r, c = in_sfm_frame(rotations, truth)
    gps = truth.copy()
    gps[:, 2] = np.nan
    found = align(r, c, gps, 0)
    assert isinstance(found, Alignment)
    assert found.how == "positions, levelled by the camera plane"
    assert np.abs(np.array([found.transform * x for x in c]) - truth)[:, :2].max() < 0.5


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("few", "2 registered photos have GPS, at least 3 are needed"),
        ("line", "on one line"),
        ("same", "on one line"),
        ("noise", "scale uncertain"),
    ],
)
def test_positions_that_cannot_serve_are_refused(change, why):
    rotations, truth = flight(4)
    r, c = in_sfm_frame(rotations, truth)
    gps = truth.copy()
    if change == "few":
        r, c, gps = r[:2], c[:2], gps[:2]
    elif change == "line":
        r, c, gps = r[:8], c[:8], gps[:8]
    elif change == "same":
        gps[:] = [1.0, 2.0, 3.0]
    else:
        gps += np.random.default_rng(0).normal(0, 60, gps.shape)
    found = align(r, c, gps, 0)
    assert isinstance(found, str)
    assert why in found


def test_local_metres_are_east_north_up():
    """Against the WGS 84 ellipsoid's radii of curvature at 46 degrees."""
    degrees = np.array([[46.0, -91.0, 300.0], [46.001, -91.0, 300.0], [46.0, -90.999, 310.0]])
    metres, origin = local_metres(degrees)
    assert origin == pytest.approx([46.0, -91.0, 300.0])
    a, e2 = 6_378_137.0, 0.00669437999014
    s = np.sin(np.radians(46)) ** 2
    north = np.radians(0.001) * (a * (1 - e2) / (1 - e2 * s) ** 1.5 + 300)
    east = np.radians(0.001) * (a / np.sqrt(1 - e2 * s) + 300) * np.cos(np.radians(46))
    assert metres[1] - metres[0] == pytest.approx([0, north, 0], abs=2e-2)
    assert metres[2] - metres[0] == pytest.approx([east, 0, 10], abs=2e-2)
    unknown = degrees.copy()
    unknown[1, 2] = np.nan
    assert np.isnan(local_metres(unknown)[0][1, 2])
    assert np.isfinite(local_metres(unknown)[0][:, :2]).all()
