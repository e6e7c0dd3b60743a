"""Method scaffold-gs: it learns, is continued to the bit, and its model lives on in another process."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from helpers.other_process import shown_elsewhere
from helpers.stored_sizes import bytes_of_tensors, numbers_of_layers
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.anchors.control import AnchorDensity
from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.scaffold.cost import cost
from splatproof.methods.scaffold.fit import fit, terms
from splatproof.methods.scaffold.settings import Settings
from splatproof.methods.storage.ply import read_ply, write_ply
from splatproof.methods.threedgs.settings import Settings as ThreeDGS
from splatproof.methods.training.terms import Photometric

DENSITY = AnchorDensity(
    start=0, adjust_start=0, interval=10, least_interval=10, stop=30_000, gradient=1e-4
)
SHORT = Settings(iterations=60, k=4, features=8, density=DENSITY)
RUN = Run(threads=1, seed=3)


class Killed(Exception):
    """Stands for a kill between two steps."""


@pytest.fixture(scope="module")
def trained() -> DecodedModel:
    return fit(tiny_scene(), SHORT, RUN)


def error(model, views) -> float:
    with torch.no_grad():
        return sum(float((model.render(v).colour - v.load()).square().mean()) for v in views)


def test_it_learns_better_than_one_colour_and_about_as_well_as_3dgs():
    scene, steps = tiny_scene(), 150
    ours = fit(scene, replace(SHORT, iterations=steps), RUN)
    threedgs = get_method("3dgs")
    other = threedgs.fit(scene, ThreeDGS(iterations=steps, sh_degree=1), RUN)
    views = scene.train_views
    flat = torch.stack([view.load() for view in views]).mean(dim=(0, 1, 2))
    one_colour = sum(float((view.load() - flat).square().mean()) for view in views)
    assert error(ours, views) < 0.25 * one_colour  # 6 dB
    assert error(ours, views) < 1.6 * error(other, views)  # 2 dB


@torch.no_grad()
def mean_volume(model: DecodedModel) -> float:
    """Of the Gaussians that the first view is decoded into."""
    return float(model.model.splats(tiny_scene().views[0], TRAINED).scales.prod(dim=1).mean())


def test_volume_weighs_what_the_settings_say():
    told: dict[float, list[dict[str, float]]] = {0.0: [], 100.0: []}
    volumes = {
        weight: mean_volume(
            fit(
                tiny_scene(),
                replace(SHORT, iterations=20, volume=weight),
                replace(RUN, report=lambda step, total, values, seen=seen: seen.append(values)),
            )
        )
        for weight, seen in told.items()
    }
    assert volumes[100.0] < 0.9 * volumes[0.0]
    assert told[0.0][-1].keys() == {"loss", "photometric", "gaussians"}
    assert told[100.0][-1].keys() == {"loss", "photometric", "volume", "gaussians"}
    image, volume = terms(replace(SHORT, volume=0.3, dssim=0.7))
    assert isinstance(image, Photometric)
    assert (image.dssim, volume.name, volume.weight) == (0.7, "volume", 0.3)


def test_anchors_grew_and_went(trained):
    levels = trained.model.parameters.labels["levels"]
    assert (levels >= 0).any()
    centres = trained.model.parameters.labels["centres"]
    assert len(torch.unique(centres, dim=0)) == len(centres)


@pytest.mark.parametrize(
    "step", [17, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 30, 59))]
)
def test_killed_and_continued_is_the_same_to_the_bit(trained, tmp_path, step):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_scene(), SHORT, replace(cut, report=kill))
    again = fit(tiny_scene(), SHORT, cut)
    want, found = (m.model.parameters.state() for m in (trained, again))
    assert want.keys() == found.keys()
    assert all(torch.equal(want[name], found[name]) for name in want)


def test_other_settings_do_not_continue(tmp_path):
    run = replace(RUN, folder=tmp_path)
    fit(tiny_scene(), replace(SHORT, iterations=2), run)
    with pytest.raises(UsageError, match="differs: settings.volume 0.01 before, 0.1 now"):
        fit(tiny_scene(), replace(SHORT, iterations=2, volume=0.1), run)


@pytest.mark.parametrize(
    "more",
    [pytest.param({}, marks=pytest.mark.slow), {"feature_bank": True, "distance": True}],
)
def test_saved_and_rendered_in_another_process(tmp_path, more):
    model = fit(tiny_scene(), replace(SHORT, iterations=15, **more), RUN)
    save_model(model, tmp_path / "model", Origin())
    found = shown_elsewhere(tmp_path / "model", tiny_scene, 0)
    assert np.array_equal(found["colour"], model.render(tiny_scene().views[0]).colour)


def test_only_anchors_and_networks_are_stored(trained, tmp_path):
    save_model(trained, tmp_path, Origin())
    anchor = 3 + 4 * 3 + 8 + 6  # centre, offsets, features, scales
    networks = sum(numbers_of_layers(8 + 3, 8, 4 * each) for each in (1, 7, 3))
    levels = 8 * trained.primitives  # whole numbers of 8 bytes
    assert bytes_of_tensors(tmp_path) == 4 * (trained.primitives * anchor + networks) + levels


def test_baked_at_a_view_it_looks_the_same_there(trained, tmp_path):
    view = tiny_scene().views[0]
    gaussians = trained.bake(view)
    write_ply(tmp_path / "m.ply", gaussians, trained.shift)
    again, _ = read_ply(tmp_path / "m.ply")
    explicit = ExplicitModel(model=again, shift=trained.shift, units=trained.units)
    baked = explicit.render(view).colour
    torch.testing.assert_close(baked, trained.render(view).colour, atol=2e-4, rtol=0)
    with pytest.raises(UsageError, match="looks different from every view"):
        trained.bake()


def test_a_damaged_model_is_refused_in_one_line(trained, tmp_path):
    folder = tmp_path / "model"
    save_model(trained, folder, Origin())
    tensors, _ = read_tensors(folder / "model.safetensors")
    del tensors["shared.colour.weight0"], tensors["shared.colour.weight1"]
    load = get_method("scaffold-gs").loaders["scaffold-gs"]
    write_tensors(folder / "model.safetensors", tensors)
    stored = trained.store(folder)
    with pytest.raises(DataError, match=r"model.json: damaged \(KeyError\('colour.weight0'\)\)"):
        load(folder, replace(stored, tensors=tensors), "cpu")


def test_a_scene_without_points_is_refused():
    scene = tiny_scene()
    empty = replace(scene.points, positions=torch.zeros(0, 3, dtype=torch.float64),
                    colours=torch.zeros(0, 3, dtype=torch.uint8),
                    track_starts=torch.zeros(1, dtype=torch.int64))  # fmt: skip
    with pytest.raises(DataError, match="0 sparse points"):
        fit(replace(scene, points=empty), SHORT, RUN)
    found = fit(replace(scene, points=empty), replace(SHORT, iterations=2, random_points=30), RUN)
    assert found.primitives > 0


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"k": 0}, "k is 0, expected >= 1"),
        ({"voxel": -1.0}, "voxel is -1.0, expected >= 0"),
        ({"features": 6, "feature_bank": True}, "features is 6, expected a multiple of 4"),
    ],
)
def test_settings_that_no_run_can_follow_are_refused(given, told):
    with pytest.raises(UsageError, match=told):
        Settings(**given)


def test_cost_grows_with_steps_and_anchors():
    scene = tiny_scene()
    one, more = (cost(replace(SHORT, iterations=n), scene).cpu_seconds for n in (100, 1000))
    assert more > 10 * one
    assert cost(SHORT, scene).memory_mb < cost(replace(SHORT, k=1000), scene).memory_mb
