"""What is prepared follows the settings: the terms of the loss, the sky, density control."""

from dataclasses import replace

import pytest
import torch

from helpers.covered_sky import require_taught_below
from helpers.tiny_drive import tiny_drive
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.hdgs.control import HdgsControl
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.hdgs.fit import fit, prepare
from splatproof.methods.hdgs.settings import DepthSettings, Settings
from splatproof.methods.training.terms import Photometric, Term
from splatproof.reference.types.scene import DepthPrior, Scene

SMALL = Settings(
    iterations=1, gaussians=4, features=6, instance=3, anchors=40, sky=SkySettings(resolution=4),
    depth=DepthSettings(crop=9),
)  # fmt: skip
RUN = Run(threads=1, seed=3)
ALWAYS = {"loss", "photometric", "gaussians"}
LOCAL = {"depth steps", "depth outliers"}


def with_priors() -> Scene:
    def prior() -> DepthPrior:
        disparity = torch.arange(18 * 24).reshape(18, 24) / 100
        return DepthPrior(disparity=disparity, valid=torch.ones(18, 24, dtype=torch.bool))

    scene = tiny_drive(moments=4)
    return replace(scene, views=tuple(replace(view, load_prior=prior) for view in scene.views))


@pytest.mark.parametrize(
    ("chosen", "terms"),
    [
        ({}, {"lidar", "sky", *LOCAL}),
        ({"depth": DepthSettings(crop=9, global_weight=0.01)},
         {"lidar", "sky", "depth order", *LOCAL}),
        ({"lidar": LidarSettings(weight=0.0)}, {"sky", *LOCAL}),
        ({"sky": SkySettings(resolution=0)}, {"lidar", *LOCAL}),
        ({"depth": DepthSettings(smooth=0.0, outlier=0.0)}, {"lidar", "sky"}),
    ],
)  # fmt: skip
def test_the_terms_are_told_by_name(chosen, terms):
    told: list[dict[str, float]] = []
    fit(
        with_priors(),
        replace(SMALL, **chosen),
        replace(RUN, report=lambda step, total, values: told.append(values)),
    )
    assert told[-1].keys() == ALWAYS | terms


def test_the_terms_weigh_what_the_settings_say():
    settings = replace(
        SMALL, dssim=0.7, lidar=LidarSettings(weight=0.3), sky=SkySettings(resolution=4, weight=0.4),
        depth=DepthSettings(smooth=0.5, outlier=0.6, global_weight=0.8),
    )  # fmt: skip
    _, plan = prepare(with_priors(), settings, RUN)
    image, *others = plan.terms
    assert isinstance(image, Photometric)
    assert (image.weight, image.dssim) == (1.0, 0.7)
    assert {term.name: term.weight for term in others if isinstance(term, Term)} == {
        "lidar": 0.3, "sky": 0.4, "depth steps": 0.5, "depth outliers": 0.6, "depth order": 0.8,
    }  # fmt: skip


@pytest.mark.parametrize("covered", [0.3, 0.8])
def test_pixels_that_are_covered_by_so_much_teach_the_sky_nothing(covered):
    scene = with_priors()
    model, _ = prepare(scene, replace(SMALL, sky=SkySettings(resolution=4, covered=covered)), RUN)
    require_taught_below(model, scene.views[0], covered)


def test_density_control_follows_the_settings_and_the_drive():
    chosen = HdgsDensity(
        start=100, stop=9_000, interval=700, least_interval=3, growing="uniform", gradient=1e-3,
        density=7.0, drawn_share=0.1, temporal_gradient=2e-3, temporal_share=0.5, opacity=0.01,
        unvisited=77,
    )  # fmt: skip
    scene = with_priors()
    settings = replace(SMALL, iterations=3_000, voxel=0.25, density=chosen)
    model, plan = prepare(scene, settings, RUN)
    control = plan.density
    assert isinstance(control, HdgsControl)
    assert control.settings == chosen.shrunk(3_000)
    growth = control.growth
    for name in ("gradient", "temporal_gradient", "temporal_share", "opacity", "unvisited"):
        assert getattr(growth, name) == getattr(chosen, name)
    assert growth.density == torch.inf  # uniform growing
    assert control.sizes == settings.sizes
    assert control.views == len(scene.train_views)
    times = [model.time(view) for view in scene.train_views]
    assert control.moments == (min(times), max(times))
    # Started a point to each voxel of 0.25; the voxels of control and consistency are half as wide.
    assert control.voxel == model.voxel == pytest.approx(0.125 / model.frame.unit)
