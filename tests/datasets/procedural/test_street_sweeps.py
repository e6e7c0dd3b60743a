"""The street's LiDAR through the views: at the right place, from the right place, at the right moment."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

from splatproof.base.errors import DataError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural import lidar, street
from splatproof.datasets.procedural.plan import Stage
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, Sweep, View

PROTOCOL = Protocol(name="test", source="ours", hold=street.HELD, hold_unit="time")
NOISE = 6 * lidar.NOISE
"""Metres: of 3500 ranges with a normal error none is further off."""


@pytest.fixture
def scene(made) -> Scene:
    return open_scene(made("street")[0], PROTOCOL)


@pytest.fixture
def stages(made) -> dict[str, Stage]:
    """The true world at the moment of each view."""
    plan = made("street")[1]
    return {shot.name: plan.stage(shot) for shot in plan.shots if not shot.group}


def read(view: View) -> Sweep:
    assert view.load_sweep is not None
    return view.load_sweep()


def of_movers(made, view: View) -> Tensor:
    """Which points of a view's sweep hit what moves."""
    folder, plan = made("street")
    moves = np.array([kind in plan.movable for kind in plan.kinds_of("")])
    with np.load(folder / "lidar" / f"{view.name[:10]}.npz") as arrays:
        return torch.from_numpy(moves[arrays["objects"]])


def seen_at_true_depth(view: View, positions: Float[Tensor, "n 3"]) -> Tensor:
    """Of the points inside the view's picture, which have a depth that a pixel beside them has.

    A point lies between pixels' centres: the true depth there is between those of the 3 x 3 pixels
    around, but for outlines.
    """
    assert view.load_depth is not None
    pixel, z = project_points(view.camera, positions.double())
    limit = pixel.new_tensor([view.camera.width, view.camera.height])
    inside = (z > 0.1) & ((pixel >= 0) & (pixel < limit)).all(1)
    x, y = pixel[inside].floor().long().T
    around = pad(view.load_depth()[None, None], (1, 1, 1, 1), mode="replicate")
    far, near = max_pool2d(around, 3, 1)[0, 0], -max_pool2d(-around, 3, 1)[0, 0]
    return (z[inside] > near[y, x] - NOISE) & (z[inside] < far[y, x] + NOISE)


def hit_first(stage: Stage, origin: Tensor, positions: Tensor) -> Tensor:
    """Which points are the first thing of the true world on their ray from a sensor's place."""
    eye = origin.numpy()
    ways = positions.double().numpy() - eye
    length = np.linalg.norm(ways, axis=1)
    hits = stage.caster.first(np.broadcast_to(eye, ways.shape), ways / length[:, None])
    return torch.from_numpy(np.abs(hits.distance - length) < NOISE)


def share(flags: list[Tensor]) -> float:
    return float(torch.cat(flags).float().mean())


def test_a_view_has_the_sweep_of_its_own_moment(scene):
    for view in scene.views:
        assert view.sweep_time == read(view).time == view.time
        assert read(view).positions.dtype == torch.float32
        assert read(view).origin.dtype == torch.float64


def test_points_are_where_the_true_depth_is(scene):
    """0.98 of them measured: the sensor looks over what hides a point from the camera half a metre away."""
    found = share([seen_at_true_depth(view, read(view).positions) for view in scene.views])
    assert found > 0.97
    for way in torch.eye(3):  # control: another frame, a metre away
        moved = [seen_at_true_depth(view, read(view).positions + way) for view in scene.views]
        assert share(moved) < 0.9


def test_points_on_what_moves_are_where_it_is_at_that_moment(made, scene):
    front = [view for view in scene.views if view.sensor == "front"]
    own, other = [], []
    for view in front:
        for taken in front:
            points = read(taken).positions[of_movers(made, taken)]
            found = seen_at_true_depth(view, points)
            (own if taken is view else other).append(found)
    assert share(own) > 0.9
    assert share(other) < 0.6  # control: the sweeps of other moments


def test_rays_from_the_origin_hit_the_points_first(made, scene, stages):
    """In the true world without pixels between: exact but for the noise of ranges."""
    wrong, front = [], [view for view in scene.views if view.sensor == "front"]
    for view in scene.views:
        sweep, stage = read(view), stages[view.name]
        assert float(hit_first(stage, sweep.origin, sweep.positions).float().mean()) > 0.999
        for taken in front:
            if view.sensor == "front" and taken.time != view.time:
                points = read(taken).positions[of_movers(made, taken)]
                wrong.append(hit_first(stage, read(taken).origin, points))
    assert share(wrong) < 0.1  # control: other moments


def test_from_the_origin_points_lie_where_the_beams_went(made, scene):
    """Float32 coordinates of 75 metres, seen from 4 metres away and more: 1e-6 of a radian."""
    for view in scene.views:
        sweep = read(view)
        with np.load(made("street")[0] / "lidar" / f"{view.name[:10]}.npz") as arrays:
            fired = torch.from_numpy(arrays["azimuths"]).double()

        def miss(origin: Tensor, sweep=sweep, fired=fired) -> float:
            x, y, _ = (sweep.positions - origin).T
            off = torch.remainder(torch.atan2(y, x) - fired + torch.pi, 2 * torch.pi) - torch.pi
            return float(off.abs().max())

        assert miss(sweep.origin) < 1e-5
        # control: the place of another sensor, the camera, 40 centimetres ahead
        assert miss(sweep.origin + torch.tensor([0.4, 0.0, 0.0], dtype=torch.float64)) > 1e-2


def test_views_are_sent_to_other_processes(scene):
    for view in scene.views:
        assert view.load_depth is not None
        assert view.load_moving is not None
        sent = pickle.loads(pickle.dumps(view))
        assert torch.equal(read(sent).positions, read(view).positions)
        assert torch.equal(sent.load_depth(), view.load_depth())
        assert sent.load_moving().keys() == view.load_moving().keys()


def test_sparse_points_stay_those_of_structure_from_motion(made, scene):
    assert len(scene.points) < 1000  # a sweep has 3500
    assert int(scene.points.track_starts[-1]) > 0
    sweeps = {path for path in scene.sources if path.parent.name == "lidar"}
    assert sweeps == set((made("street")[0] / "lidar").glob("*.npz"))


def test_views_of_other_lanes_have_no_sweep(made):
    scene = open_scene(made("street")[0], replace(PROTOCOL, test_folder=street.SHIFTED))
    assert {view.load_sweep is None for view in scene.test_views} == {True}
    assert {view.load_sweep is None for view in scene.train_views} == {False}


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"time": np.array([0.1, 0.2])}, r"time is float64 of shape \(2,\), expected one finite"),
        ({"time": np.array(np.nan)}, "time is float64 of shape"),
        ({"points": np.zeros((4, 2))}, r"points is float64 of shape \(4, 2\), expected finite"),
        ({"points": np.zeros((4, 3), int)}, "points is int64"),
        ({"points": np.full((4, 3), np.inf)}, "points is float64"),
        ({"points": np.float32(1)}, r"points is float32 of shape \(\)"),
        ({"origin": np.zeros(2)}, r"origin is float64 of shape \(2,\)"),
    ],
)
def test_a_sweep_of_another_kind_is_named(made, tmp_path, arrays, said):
    scene = _copy(made("street")[0], tmp_path / "street")
    whole = {"points": np.zeros((4, 3)), "origin": np.zeros(3), "time": np.array(0.1)}
    np.savez(scene / "lidar" / "frame_0001.npz", **(whole | arrays))
    with pytest.raises(DataError, match=said) as caught:
        _read_all(scene)
    assert "frame_0001.npz: " in str(caught.value)
    assert "\n" not in str(caught.value)


def _read_all(folder):
    for view in open_scene(folder, PROTOCOL).views:
        read(view)


def _copy(folder, target):
    """The folder with files of its own in lidar/ alone."""
    target.mkdir()
    for path in folder.iterdir():
        if path.name != "lidar":
            (target / path.name).symlink_to(path)
    (target / "lidar").mkdir()
    for path in (folder / "lidar").iterdir():
        (target / "lidar" / path.name).write_bytes(path.read_bytes())
    return target
