import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatproof.datasets.scene_frame import near_plane, origin_shift, up_vector

DOWN = np.diag([1.0, -1.0, -1.0])  # looks along -z, image y along -y
LEVEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along +y, image y along -z


def grid(count: int, rng: np.random.Generator) -> np.ndarray:
    centres = rng.uniform(-1, 1, (count, 3)) * [10, 7, 0.2]
    return centres + [0, 0, 30]


@pytest.mark.parametrize("turn", [[0, 0, 0], [0.3, -1.0, 0.4], [2.0, 1.0, -3.0]])
def test_a_nadir_flight_knows_up_although_strips_turn_the_camera(turn):
    rng = np.random.default_rng(0)
    centres = grid(20, rng)
    strips = [Rotation.from_euler("z", 180 * (i % 2), degrees=True) for i in range(20)]
    shaken = [Rotation.from_rotvec(rng.normal(0, 0.05, 3)) for _ in range(20)]
    rotations = np.stack([(a * b).as_matrix() @ DOWN for a, b in zip(shaken, strips, strict=True)])
    world = Rotation.from_rotvec(turn).as_matrix()
    up, source = up_vector(rotations @ world.T, centres @ world.T)
    assert source == "camera plane"
    assert np.degrees(np.arccos(up @ world[:, 2])) < 2  # centres are 0.2 off a plane of 14


def test_a_walk_round_takes_the_cameras_ups():
    turns = [Rotation.from_euler("z", 30 * i, degrees=True).as_matrix() for i in range(12)]
    rotations = np.stack([LEVEL @ turn for turn in turns])
    centres = np.stack([3 * turn.T @ [0, -1, 0] for turn in turns])
    up, source = up_vector(rotations, centres)
    assert source == "camera axes"
    assert up == pytest.approx(np.array([0, 0, 1]), abs=1e-9)


def test_two_cameras_and_cancelling_ups_give_a_unit_vector():
    up, _ = up_vector(np.stack([LEVEL, LEVEL]), np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    assert up == pytest.approx(np.array([0, 0, 1]))
    flipped = np.stack([LEVEL, np.diag([-1.0, -1.0, 1.0]) @ LEVEL])
    up, _ = up_vector(flipped, np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    assert np.linalg.norm(up) == pytest.approx(1)


@pytest.mark.parametrize(
    ("offset", "size", "far"),
    [
        ([0, 0, 0], 1.0, False),
        ([500, 0, 0], 1.0, False),
        ([9000, 0, 0], 100.0, False),
        ([11_000, 0, 0], 100.0, True),
        ([448_262.25, 5_411_932.5, 120], 80.0, True),
        ([5, 0, 0], 0.001, True),
        ([0, 0, 0], 0.0, False),
    ],
)
def test_far_scenes_are_moved(offset, size, far):
    corners = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]]) * size + offset
    assert origin_shift(corners) == pytest.approx(np.array(offset, dtype=float) * far)


@pytest.mark.parametrize(
    ("size", "near"), [(0.0, 0.01), (1e-3, 1e-5), (0.5, 0.005), (1.0, 0.01), (80.0, 0.01)]
)
def test_a_small_scene_has_a_nearer_near_plane(size, near):
    corners = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]]) * size
    assert near_plane(corners + [4e6, 0, 0]) == pytest.approx(near, rel=1e-4)


@pytest.mark.parametrize("place", [[0, 0, 0], [1, 2, 3], [4e5, 4e6, 100]])
def test_rounding_makes_no_small_scene_of_cameras_that_turn_about_one_place(place):
    turns = Rotation.from_euler("zyx", np.random.default_rng(0).uniform(-3, 3, (12, 3))).as_matrix()
    moved = -np.einsum("nij,j->ni", turns, place)
    centres = -np.einsum("nji,nj->ni", turns, moved)
    assert near_plane(centres) == 0.01
