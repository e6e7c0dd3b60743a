"""Method hdgs: it learns motion, is continued to the bit, and its model lives on in another process."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.other_process import shown_elsewhere
from helpers.stored_sizes import bytes_of_tensors, numbers_of_layers
from helpers.tiny_drive import tiny_drive
from splatproof.base.errors import DataError, UsageError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.hdgs.cost import cost
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.hdgs.fit import fit, prepare
from splatproof.methods.hdgs.model import HdgsModel
from splatproof.methods.hdgs.settings import DepthSettings, Settings
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.reference.types.scene import Sweep, View

SHORT = Settings(
    iterations=24, gaussians=6, features=8, instance=4, anchors=40, sky=SkySettings(resolution=8),
    depth=DepthSettings(crop=9),
    density=HdgsDensity(least_interval=5, gradient=1e-4, temporal_gradient=1e-5),
)  # fmt: skip
RUN = Run(threads=1, seed=3)


class Killed(Exception):
    """Stands for a kill between two steps."""


@pytest.fixture(scope="module")
def trained() -> DecodedModel:
    return fit(tiny_drive(), SHORT, RUN)


def error(model: DecodedModel, view: View) -> float:
    return float((model.render(view).colour - view.load()).square().mean())


def test_it_learns_a_moment_that_was_held_out():
    scene, view = tiny_drive(), tiny_drive().views[3]
    start, later = (
        error(fit(scene, replace(SHORT, iterations=steps), RUN), view) for steps in (1, 40)
    )
    assert later < 0.4 * start


def test_anchors_grew(trained):
    start = prepare(tiny_drive(), SHORT, RUN)[0]
    assert trained.primitives != start.primitives


@pytest.mark.parametrize("step", [10])
def test_killed_and_continued_is_the_same_to_the_bit(trained, tmp_path, step):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:  # reports come every 10 steps
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_drive(), SHORT, replace(cut, report=kill))
    again = fit(tiny_drive(), SHORT, cut)
    want, found = (m.model.parameters.state() for m in (trained, again))
    assert want.keys() == found.keys()
    assert all(torch.equal(want[name], found[name]) for name in want)


VARIANTS = [
    {"layers": 4, "k_rule": "leaf", "leaf": 2},
    {"layers": 5, "k_rule": "leaf", "leaf": 1},
    {"layers": 2, "ice": "off", "motion": "static", "sky": SkySettings(resolution=0), "lidar": LidarSettings(weight=0.0)},
]  # fmt: skip


@pytest.mark.parametrize("more", VARIANTS)
def test_saved_and_rendered_in_another_process(tmp_path, more):
    model = fit(tiny_drive(), replace(SHORT, iterations=4, **more), RUN)
    save_model(model, tmp_path / "model", Origin())
    found = shown_elsewhere(tmp_path / "model", tiny_drive, 3)
    assert np.array_equal(found["colour"], model.render(tiny_drive().views[3]).colour)


def test_baked_at_a_moment_it_looks_the_same_there_but_for_the_sky(tmp_path):
    model = fit(tiny_drive(), replace(SHORT, sky=SkySettings(resolution=0)), RUN)
    view = tiny_drive().views[3]
    write_ply(tmp_path / "m.ply", model.bake(view), model.shift)
    again, _ = read_ply(tmp_path / "m.ply")
    baked = ExplicitModel(model=again, shift=model.shift, units=model.units).render(view).colour
    torch.testing.assert_close(baked, model.render(view).colour, atol=2e-4, rtol=0)
    assert model.unbaked == ()
    with pytest.raises(UsageError, match="looks different from every view"):
        model.bake()


def test_a_sky_is_not_baked_and_said_to_be(trained):
    assert trained.unbaked == ("its sky",)


@pytest.mark.parametrize("ice", ["full", "off"])
def test_only_anchors_and_networks_are_stored(tmp_path, ice):
    """Of the consistency step nothing where it is off."""
    model = fit(tiny_drive(), replace(SHORT, iterations=1, ice=ice), RUN)
    save_model(model, tmp_path, Origin())
    anchor = 3 + 8 + 4 + 4 + 3 + 1 + 3 + 1 + 2 * 3 + 6 * 3
    leaves = 3  # Gaussians of each of an anchor's two children
    heads = sum(numbers_of_layers(8 + 4, 8, leaves * each) for each in (3, 1, 7))
    residuals = sum(numbers_of_layers(40, 8, width) for width in (leaves * 3, 2 * 3, 2 * 8, 2 * 3))
    support = 27 * 8 * 8 + numbers_of_layers(8, 8)
    support += numbers_of_layers(4, 16, 8) + numbers_of_layers(8, 16, 1)
    shared = heads + residuals + (support if ice == "full" else 0) + 6 * 8 * 8 * 3  # the sky's
    assert bytes_of_tensors(tmp_path) == 4 * (model.primitives * anchor + shared)


def test_a_damaged_model_is_refused_in_one_line(trained, tmp_path):
    save_model(trained, tmp_path, Origin())
    tensors, _ = read_tensors(tmp_path / "model.safetensors")
    del tensors["rows.offsets2"]
    write_tensors(tmp_path / "model.safetensors", tensors)
    load = get_method("hdgs").loaders["hdgs"]
    stored = replace(trained.store(tmp_path), tensors=tensors)
    with pytest.raises(DataError, match=r"model.json: damaged \(KeyError\('offsets2'\)\)"):
        load(tmp_path, stored, "cpu")


@pytest.mark.parametrize(
    ("lacking", "told"),
    [
        ({"load_sweep": None}, "no training view has a LiDAR sweep; set lidar.weight = 0"),
        ({"load_sky": None}, "no training view has a sky mask; set sky.weight = 0"),
        ({"time": None}, "has no time"),
    ],
)
def test_what_a_scene_lacks_is_told_in_one_line(lacking, told):
    scene = tiny_drive()
    scene = replace(scene, views=tuple(replace(view, **lacking) for view in scene.views))
    with pytest.raises(DataError, match=told):
        fit(scene, SHORT, RUN)


def test_without_points_and_sweeps_there_is_nothing_to_start_from():
    scene = tiny_drive()
    bare = replace(scene.points, positions=scene.points.positions[:0],
                   colours=scene.points.colours[:0],
                   track_starts=torch.zeros(1, dtype=torch.int64))  # fmt: skip
    views = tuple(replace(view, load_sweep=None) for view in scene.views)
    without = replace(SHORT, lidar=LidarSettings(weight=0.0), iterations=2)
    with pytest.raises(DataError, match="0 sparse points"):
        fit(replace(scene, points=bare, views=views), without, RUN)
    assert fit(replace(scene, points=bare), without, RUN).primitives > 0
    blind = replace(without, from_sweeps=False)
    with pytest.raises(DataError, match="0 sparse points"):
        fit(replace(scene, points=bare), blind, RUN)


def test_a_start_without_sweeps_reads_none():
    def unread() -> Sweep:
        raise AssertionError("a sweep was read")

    scene = tiny_drive()
    closed = tuple(replace(view, load_sweep=unread) for view in scene.views)
    blind = replace(SHORT, lidar=LidarSettings(weight=0.0), from_sweeps=False, iterations=2)
    start = prepare(replace(scene, views=closed), blind, RUN)[0].parameters.state()
    assert (start["rows.velocities"] == 0).all()
    without = replace(scene, views=tuple(replace(view, load_sweep=None) for view in scene.views))
    bare = prepare(without, blind, RUN)[0].parameters.state()
    assert start.keys() == bare.keys()
    assert all(torch.equal(start[name], bare[name]) for name in start)
    assert cost(blind, replace(scene, views=closed)).cpu_seconds < cost(SHORT, scene).cpu_seconds


def test_far_points_are_left_to_a_sky_where_there_is_one():
    scene = tiny_drive()
    places = scene.points.positions.clone()
    places[0] = torch.tensor([1e4, 0.0, 0.0])
    far = replace(scene, points=replace(scene.points, positions=places))
    blind = replace(SHORT, lidar=LidarSettings(weight=0.0), from_sweeps=False, iterations=2)
    without = replace(blind, sky=SkySettings(resolution=0))
    assert max_x(prepare(far, blind, RUN)[0]) < 1e3
    assert max_x(prepare(far, without, RUN)[0]) == pytest.approx(1e4, rel=0.01)
    view = scene.views[3]
    assert fit(far, without, RUN).render(view).colour.isfinite().all()


def max_x(model: HdgsModel) -> float:
    """Largest x of the anchors, in scene units."""
    return float(model.frame.outwards(model.parameters.labels["centres"].double())[:, 0].max())


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"layers": 1}, r"layers is 1, expected 2 to 5 \(one layer .* method pvg\)"),
        ({"layers": 6}, "layers is 6, expected 2 to 5"),
        ({"layers": 5}, r"gaussians is 12, expected a multiple of children\^\(layers - 2\) = 8"),
        ({"period": 0.0}, "period is 0.0, expected > 0"),
        ({"voxel": -1.0}, "voxel is -1.0, expected >= 0"),
    ],
)
def test_settings_that_no_run_can_follow_are_refused(given, told):
    with pytest.raises(UsageError, match=told):
        Settings(**given)


def test_k_grows_with_the_layers_by_the_second_rule():
    counts = [Settings(layers=n, k_rule="leaf").sizes.gaussians for n in (2, 3, 4, 5)]
    assert counts == [6, 12, 24, 48]
    assert [Settings(layers=n).sizes.gaussians for n in (2, 3, 4)] == [12, 12, 12]


def test_cost_grows_with_steps_and_anchors():
    scene = tiny_drive()
    one, more = (cost(replace(SHORT, iterations=n), scene).cpu_seconds for n in (100, 1000))
    assert more >= 10 * one
    assert cost(SHORT, scene).memory_mb < cost(replace(SHORT, anchors=10**5), scene).memory_mb
