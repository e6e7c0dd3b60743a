"""Every world in miniature: made, opened by the ordinary adapter, with what it promises beside."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers import tiny_worlds
from splatproof.cli import main
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.procedural import aerial, city, exporting, street, tracing, tunnel, worlds
from splatproof.datasets.procedural import ray_images as frames
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.nearest_view import nearest_view
from splatproof.reference.types.protocol import Protocol

PROTOCOL = Protocol(name="test", source="ours", hold=8)

SLOW = pytest.mark.slow


@pytest.mark.parametrize("world", ["city", "tunnel", "street"])
def test_the_adapter_opens_it_with_depth_everywhere(made, world):
    folder, plan = made(world)
    scene = open_scene(folder, PROTOCOL)
    assert [v.name for v in scene.views] == sorted(s.name for s in plan.shots if not s.group)
    assert scene.facts["world"] == world
    assert len(scene.points) > 10
    for view in scene.views[::3]:
        assert view.load_depth is not None
        depth = view.load_depth()
        assert float(torch.isfinite(depth).float().mean()) > 0.3
        assert float(view.load().std()) > 0.02


def test_the_city_has_facades_that_no_training_view_sees(made):
    folder, plan = made("city")
    unseen = open_scene(folder / city.UNSEEN, PROTOCOL)
    names = [view.name for view in unseen.views]
    assert len(names) == 3
    assert len(unseen.points) > 10
    assert not set(names) & {v.name for v in open_scene(folder, PROTOCOL).views}
    stage = plan.stage(plan.shots[0])
    from splatproof.datasets.procedural import oracle as truth

    cloud = truth.surface_cloud(stage.caster.world, 2.0, 0)
    train = [s.camera for s in plan.shots if not s.group]
    tests = [s.camera for s in plan.shots if s.group]
    blind = truth.blind_facades(stage.caster, cloud, train, tests)
    assert len(blind) > 50
    # depth maps agree. A wall's uppermost centimetres have the depth of the eave that hides them, so
    # of walls at least a storey of 2.5 metres high, a map "shows" as much as it is asked to tolerate
    known = truth.visible_surface(stage.caster, cloud, train, least=2)
    fine, coarse = (
        0.02,
        0.5,
    )  # metres; a pixel of these maps is 0.4 metres wide, and more if slanted
    shown = {"blind": np.zeros(len(blind), dtype=bool), "known": np.zeros(len(known), dtype=bool)}
    for camera in map(replace_size, train):
        depth = frames.truth(stage.caster, camera)[0]
        shown["blind"] |= on_surface(blind, camera, depth, fine)
        shown["known"] |= on_surface(known, camera, depth, coarse)
    assert shown["blind"].mean() < fine / 2.5
    assert shown["known"].mean() > 0.95


def on_surface(cloud, camera, depth, tolerance):
    """Which points a depth map shows, at angles at which a view tells something of them."""
    from splatproof.datasets.procedural.oracle import STEEP

    local = cloud.points @ camera.rotation.numpy().T + camera.translation.numpy()
    pixel = local @ camera.K.numpy().T
    pixel = np.floor(pixel[:, :2] / pixel[:, 2:]).astype(int)
    inside = ((pixel >= 0) & (pixel < [camera.width, camera.height])).all(axis=1)
    ways = camera.centre.numpy() - cloud.points
    cosine = np.abs((ways * cloud.normals).sum(axis=1)) / np.linalg.norm(ways, axis=1)
    x, y = np.where(inside[:, None], pixel, 0).T
    near = np.abs(local[:, 2] - depth[y, x]) < tolerance
    return inside & (local[:, 2] > 0) & (cosine > STEEP) & near


def test_the_city_is_tested_where_it_was_not_flown(made):
    folder, plan = made("city")
    scene = open_scene(folder, replace(PROTOCOL, test_folder=city.UNSEEN))
    assert {v.name for v in scene.train_views} == {s.name for s in plan.shots if not s.group}
    assert {v.name for v in scene.test_views} == {s.name for s in plan.shots if s.group}
    for view in scene.test_views:
        shot = next(s for s in plan.shots if s.name == view.name)
        gap = view.camera.world_to_camera - shot.camera.world_to_camera
        # the file keeps a unit quaternion: rounding of a rotation, times a hundred metres
        assert float((gap[:3, :3]).abs().max()) < 1e-12
        shift = shot.camera.rotation @ scene.shift
        assert float((gap[:3, 3] - shift).abs().max()) < 1e-9


def test_views_of_the_tunnel_know_their_stop_and_camera_and_have_no_masks(made):
    folder, _ = made("tunnel")
    for rules in (PROTOCOL, replace(PROTOCOL, test_folder=tunnel.RELIT)):
        for view in open_scene(folder, rules).views:
            stop, camera = int(view.name[5:9]), int(view.name[17])
            assert (view.time, view.sensor) == (tunnel.SECONDS * stop, f"camera_{camera}")
            assert view.load_sky is view.load_moving is None


def test_a_stop_of_the_tunnel_is_held_out_with_all_its_cameras(made):
    rules = replace(load_protocol("tunnel"), hold_first=1, hold=2)
    scene = open_scene(made("tunnel")[0], rules)
    assert {view.name[5:9] for view in scene.test_views} == {"0001", "0003"}
    assert {view.name[5:9] for view in scene.train_views} == {"0000", "0002"}
    for view in scene.test_views:
        nearest = nearest_view(view, scene.train_views)
        assert nearest.sensor == view.sensor
        assert abs((nearest.time or 0) - (view.time or 0)) == tunnel.SECONDS


def test_a_relit_view_is_nearest_to_the_same_camera_under_the_rigs_own_light(made):
    scene = open_scene(made("tunnel")[0], load_protocol("tunnel_relit"))
    (view,) = scene.test_views
    assert nearest_view(view, scene.train_views).name == view.name.replace("_relit", "")


def test_the_relit_tunnel_has_the_same_depth_and_other_light(made):
    folder, _ = made("tunnel")
    relit = exporting.read_frame(folder / tunnel.RELIT, "stop_0000_camera_0_relit.png")
    plain = exporting.read_frame(folder, "stop_0000_camera_0.png")
    assert np.array_equal(relit.depth, plain.depth)
    assert np.abs(relit.colour.astype(int) - plain.colour).mean() > 3
    scene = open_scene(folder, replace(PROTOCOL, test_folder=tunnel.RELIT))
    names = [view.name for view in scene.test_views]
    assert names == ["stop_0000_camera_0_relit.png"]
    assert f"lamps_{names[0]}" in scene.facts


def test_light_falls_off_with_the_square_of_the_distance():
    from splatproof.datasets.procedural.lamps import Lamps
    from splatproof.datasets.procedural.shapes import polygon
    from splatproof.datasets.procedural.things import METAL
    from splatproof.datasets.procedural.tracing import Caster
    from splatproof.datasets.procedural.world import Builder

    world = Builder()
    wall = polygon([[-9, -9, -5], [9, -9, -5], [9, 9, -5], [-9, 9, -5]])
    shade = polygon([[0.5, -0.2, -1], [9, -0.2, -1], [9, 0.2, -1], [0.5, 0.2, -1]])
    world.add("wall", [(wall, METAL)])
    world.add("shade", [(shade, METAL)])
    down = np.array([[0.0, 0.0, -1.0]])
    lamps = Lamps(caster=Caster(world.build()), positions=np.zeros((1, 3)), axes=down, power=2.0)
    points = np.array([[0.0, 0, -5], [0, 0, -2.5], [0, 5, -5], [5, 0, -5]])
    up = np.tile([0.0, 0, 1], (4, 1))
    found = lamps.light(points, up, torch.from_numpy(up).float())[:, 0]
    # straight below; half as far; at 45 degrees: cos^2 lobe, cos incidence, twice the square
    want = torch.tensor([2 / 25, 2 / 6.25, 2 / 50 * 0.5**1.5, 0.0])
    assert torch.allclose(found, want, rtol=1e-4)


def test_the_street_has_lidar_motion_and_other_lanes(made):
    folder, plan = made("street")
    with (
        np.load(folder / "lidar" / "frame_0002.npz") as sweep,
        np.load(folder / "motion.npz") as motion,
    ):
        assert len(sweep["points"]) > 500
        ids, poses = motion["objects"], motion["poses"]
        assert poses.shape == (4, len(ids), 4, 4)
        assert motion["rigid"].sum() == 4
        moved = np.linalg.norm(poses[3, :, :2, 3] - poses[0, :, :2, 3], axis=1)
        assert (moved > 0.2).all()
    kinds = plan.kinds_of("")
    assert {kinds[i] for i in ids} == {"moving car", "walker"}
    shifted = open_scene(folder / street.SHIFTED, PROTOCOL)
    assert len(shifted.views) == len(street.SHIFTS) * len(street.CAMERAS)
    assert set(plan.facts["test"].split(",")) <= {s.name for s in plan.shots}


def test_street_views_know_their_moment_their_camera_and_the_sky(made):
    folder, plan = made("street")
    shots = {shot.name: shot for shot in plan.shots}
    scene = open_scene(folder, replace(PROTOCOL, hold=street.HELD, hold_unit="time"))
    assert {view.name for view in scene.test_views} == set(plan.facts["test"].split(","))
    other = open_scene(folder, replace(PROTOCOL, test_folder=street.SHIFTED))
    assert {v.name for v in other.test_views} == {s.name for s in plan.shots if s.group}
    shares = []
    for view in (*scene.views, *other.test_views):
        shot = shots[view.name]
        assert view.time == pytest.approx(shot.time)
        assert view.sensor == shot.sensor
        assert shot.sensor in view.name
        assert view.load_sky is not None
        assert view.load_depth is not None
        sky = view.load_sky()
        assert torch.equal(sky, torch.isinf(view.load_depth()))
        shares.append(float(sky.float().mean()))
    assert 0.05 < max(shares) < 0.6


def test_masks_of_movers_cover_what_was_not_there_before(made):
    """A pixel is in a mask where the world without movers lies at another depth, and nowhere else."""
    folder, plan = made("street")
    still = tracing.Caster(street.Drive(1, tiny_worlds.TINY["street"]).still.build())
    scene = open_scene(folder, PROTOCOL)
    shares = {"vehicles": 0.0, "people": 0.0}
    for view in scene.views:
        assert view.load_moving is not None
        assert view.load_depth is not None
        masks = view.load_moving()
        assert masks.keys() == shares.keys()
        shot = next(s for s in plan.shots if s.name == view.name)
        empty = torch.from_numpy(frames.truth(still, shot.camera)[0])
        moved = masks["vehicles"] | masks["people"]
        assert torch.equal(moved, view.load_depth() < empty)
        assert not (masks["vehicles"] & masks["people"]).any()
        for kind, mask in masks.items():
            shares[kind] += float(mask.float().mean())
    assert min(shares.values()) > 0.001
    assert open_scene(made("city")[0], PROTOCOL).views[0].load_moving is None


def test_moving_things_are_where_their_pose_says(made):
    """A hit on a moving car, taken back by its pose, lies inside the car's own box."""
    _, plan = made("street")
    shot = next(s for s in plan.shots if s.name == "frame_0003_front.png")
    stage = plan.stage(shot)
    depth, _, objects = frames.truth(stage.caster, replace_size(shot.camera))
    kinds = plan.kinds_of("")
    rows = np.isin(objects, [i for i, kind in enumerate(kinds) if kind == "moving car"])
    assert rows.sum() > 20
    drive = street.Drive(1, tiny_worlds.TINY["street"])
    height, width = objects.shape
    v, u = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    origins, ways = frames.pixel_rays(
        replace_size(shot.camera), np.stack([u[rows], v[rows]], axis=1)
    )
    points = origins + ways * depth[rows][:, None]
    for identity in np.unique(objects[rows]):
        pose = drive.movers[identity - drive.first].pose(shot.time)
        own = (points[objects[rows] == identity] - pose[:3, 3]) @ pose[:3, :3]
        assert (np.abs(own) < [2.5, 1.1, 1.6]).all()


@pytest.mark.parametrize(
    ("world", "rules"),
    [pytest.param("city", "hold = 8", marks=SLOW), pytest.param("tunnel", "hold = 8", marks=SLOW),
     ("street", f'hold = {street.HELD}\nhold_unit = "time"')],
)  # fmt: skip
def test_3dgs_learns_it_from_the_command_line(made, tmp_path, capsys, world, rules):
    folder, _ = made(world)
    rules_file = tmp_path / "rules.toml"
    rules_file.write_text(f'source = "test"\n{rules}\n')
    found = {}
    for steps in (1, 150):
        options = ["--out", str(tmp_path / str(steps)), "--protocol", str(rules_file), "--json"]
        options += ["--iterations", str(steps), "--sh-degree", "0", "--threads", "1", "--quiet"]
        assert main(["fit", "3dgs", str(folder), *options]) == 0
        found[steps] = json.loads(capsys.readouterr().out.splitlines()[-1])["psnr"]
    assert found[150] > found[1] + 0.7


def replace_size(camera):
    """The same view with four times the pixels on each axis."""
    K = camera.K * torch.tensor([[4.0], [4.0], [1.0]])
    return replace(camera, K=K, width=4 * camera.width, height=4 * camera.height)


def test_sparse_points_leave_moving_things_out(made):
    folder, plan = made("street")
    import pycolmap

    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    kinds = np.array(plan.kinds_of(""))
    hits = 0
    for point in model.points3D.values():
        element = point.track.elements[0]
        image = model.images[element.image_id]
        x, y = image.points2D[element.point2D_idx].xy.astype(int)
        identity = exporting.read_frame(folder, image.name).object[y, x]
        hits += kinds[identity] in plan.movable
    assert hits <= 0.1 * len(model.points3D)  # noise of a pixel at an outline


def test_an_aerial_scene_has_nine_views_to_train_on():
    names = [shot.name for shot in aerial.shots("church", 2, aerial.PRESETS["small"])]
    assert sorted(names)[3:] == [f"train_{i:02d}.png" for i in range(9)]
    assert sum(name.startswith("test_") for name in names) == 3
    assert len(aerial.SCENES) == 8


@pytest.mark.parametrize(
    "kind",
    [
        "factory",  # built in half of the others' seconds
        *(pytest.param(kind, marks=SLOW) for kind in ("church", "mountain", "stadium", "park")),
    ],
)
def test_aerial_worlds_differ_by_seed_and_are_alike_for_one(kind):
    a, b, other = (aerial.SCENES[kind](seed) for seed in (1, 1, 2))
    assert np.array_equal(a.vertices, b.vertices)
    assert a.vertices.shape != other.vertices.shape or not np.array_equal(
        a.vertices, other.vertices
    )


@pytest.mark.parametrize("world", worlds.WORLDS)
def test_presets(world):
    sizes = [worlds.settings_of(world, preset).width for preset in ("small", "medium", "large")]
    assert sizes == sorted(sizes)
    assert len({worlds.content(world, preset, 0) for preset in ("small", "medium")}) == 2
    assert worlds.content(world, "small", 0) != worlds.content(world, "small", 1)
