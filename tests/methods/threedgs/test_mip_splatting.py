"""Method mip-splatting: the filter by hand, what it conserves, and a run that is continued to the bit."""

import itertools
import math
from dataclasses import replace

import pytest
import torch

from helpers.baking import baked
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs.mip_splatting import (
    FILTER,
    MipControl,
    MipSettings,
    fit,
    prepare,
)  # fmt: skip
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.reference.rasterizer.smoothing import sampling_widths, smoothed
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import Scene

DENSITY = Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=10_000,
                  gradient=1e-5)  # fmt: skip
SHORT = MipSettings(iterations=60, sh_degree=1, density=DENSITY)
RUN = Run(threads=1, seed=3)


def at_distance(where: Camera, z: float) -> Camera:
    """The camera, from so far away from the origin."""
    pose = where.world_to_camera.clone()
    pose[2, 3] = z
    return replace(where, world_to_camera=pose)


def from_three_distances() -> Scene:
    """The tiny scene, the last training photo taken from nearer, the held-out one from nearer still."""
    scene = tiny_scene()
    views = [*scene.views]
    for index, z in ((0, 2.0), (5, 3.0)):
        views[index] = replace(views[index], camera=at_distance(views[index].camera, z))
    return replace(scene, views=tuple(views))


def test_the_width_of_a_pixel_by_hand():
    where = camera(2)  # 4 units before the origin, focal length 1.6 * 24
    means = torch.tensor([[0.0, 0, 0], [0, 0, 4], [0, 0, -4.1], [90, 0, 0]])
    widths = sampling_widths([where], means)
    near, far = 4 / 38.4, 8 / 38.4
    assert widths.tolist() == pytest.approx([near, far, far, far])  # unseen: the largest that is
    both = sampling_widths([where, replace(where, K=2 * where.K)], means[:1])
    assert both.item() == pytest.approx(near / 2)
    assert sampling_widths([where], means[2:]).tolist() == [0, 0]


def test_a_camera_counts_for_what_lies_up_to_a_border_beside_its_image():
    where = camera(2)
    size, beside = torch.tensor([24, 18]), torch.tensor([[-0.1, 0.5], [-0.2, 0.5], [1.1, 0.5],
                                                         [1.2, 0.5], [0.5, 1.1], [0.5, 1.2]])  # fmt: skip
    away = 4 * (beside - 0.5) * size / 38.4
    means = torch.cat([away, torch.zeros(6, 1)], dim=1) - where.world_to_camera[:3, 3].float()
    means[:, 2] = 0
    means = torch.cat([means, torch.tensor([[0.0, 0, 4]])])  # the farthest that is seen
    near, far = 4 / 38.4, 8 / 38.4
    want = [near, far, near, far, near, far, far]
    assert sampling_widths([where], means).tolist() == pytest.approx(want)


def test_the_nearest_camera_counts_but_none_that_all_but_touches():
    cameras = [at_distance(camera(2), z) for z in (4.0, 6.0, 5.0)]
    means = torch.tensor([[0.0, 0, 0], [0.2, -0.2, -3.9]])  # 0.1 before the nearest of them
    for order in itertools.permutations(cameras):
        widths = sampling_widths(order, means)
        assert widths.tolist() == pytest.approx([4 / 38.4, 1.1 / 38.4])


@pytest.mark.parametrize("unit", [4, 20, 22, 24, 32])
def test_a_scene_in_a_large_unit_has_the_same_filter_in_pixels(unit):
    """Of 22 and of 24 units one lies nearer than 0.2 units and the others farther away, or one alone does."""
    where, means = camera(2), torch.tensor([[0.0, 0, 0], [0, 0, 0.6], [0, 0, 1]])
    pose = where.world_to_camera.clone()
    pose[:3, 3] /= unit
    small = sampling_widths([replace(where, world_to_camera=pose)], means / unit)
    torch.testing.assert_close(small, sampling_widths([where], means) / unit)


def test_the_filter_widens_and_keeps_what_a_gaussian_holds():
    generator = torch.Generator().manual_seed(0)
    scales = 10 ** (6 * torch.rand(200, 3, generator=generator) - 5).double()
    opacities, widths = torch.rand(2, 200, generator=generator).double()
    wide, faint = smoothed(scales, opacities, widths)
    assert (wide > scales).all()
    torch.testing.assert_close(wide.square() - widths.square()[:, None], scales.square())
    torch.testing.assert_close(faint * wide.prod(dim=1), opacities * scales.prod(dim=1))
    same = smoothed(scales, opacities, torch.zeros(200).double())
    torch.testing.assert_close(same, (scales, opacities))
    tiny = torch.full((1, 3), 1e-18, requires_grad=True)  # squares of three would be 1e-108
    smoothed(tiny, torch.ones(1), torch.full((1,), 1e-17))[1].sum().backward()
    assert tiny.grad is not None
    assert tiny.grad.isfinite().all()


def test_without_its_filter_it_is_3dgs():
    """Before the first densification: from there on what rounding differs by grows, by machine."""
    run = replace(RUN, backend="reference")
    ten = replace(SHORT, iterations=10, smoothing=0.0)
    plain = Settings(iterations=10, sh_degree=1, density=DENSITY, antialiased=True)
    one = baked(fit(tiny_scene(), ten, run))
    other = baked(get_method("3dgs").fit(tiny_scene(), plain, run))
    torch.testing.assert_close(one.means, other.means, atol=1e-5, rtol=0)


def test_a_wide_filter_leaves_no_small_gaussian():
    smallest = [
        baked(fit(tiny_scene(), replace(SHORT, smoothing=width), RUN)).scales.min()
        for width in (0.0, 3.0)
    ]
    assert smallest[1] > 2 * smallest[0]


def test_the_filters_follow_the_gaussians_through_densification():
    scene = from_three_distances()
    cameras = [view.camera for view in scene.train_views]
    model, plan = prepare(scene, SHORT, RUN)
    control, parameters = plan.density, model.parameters
    assert isinstance(control, MipControl)
    want = sampling_widths(cameras, parameters.rows["means"]) * math.sqrt(0.2)
    assert torch.equal(parameters.labels[FILTER], want)
    parameters.rows["means"][:, 2] += 1.0
    before = parameters.labels[FILTER].clone()
    control.gradient_sum = torch.ones(len(parameters))
    control.absolute_sum = torch.zeros(len(parameters))
    control.seen = torch.ones(len(parameters))
    for edit in control.edits(10, parameters, torch.Generator().manual_seed(0)):
        parameters.edit(edit)
    assert len(parameters) > len(before)
    want = sampling_widths(cameras, parameters.rows["means"]) * math.sqrt(0.2)
    assert torch.equal(parameters.labels[FILTER], want)


def test_a_reset_lowers_what_is_drawn():
    model, plan = prepare(tiny_scene(), SHORT, RUN)
    assert isinstance(plan.density, MipControl)
    parameters: Parameters = model.parameters
    parameters.rows["opacity_logits"] = torch.linspace(-9, 9, len(parameters))
    before = model.gaussians().opacities
    parameters.edit(plan.density.reset(parameters))
    after = model.gaussians().opacities
    torch.testing.assert_close(after, before.clamp(max=0.01), rtol=1e-4, atol=1e-7)


def test_gradients_stay_finite_where_opacities_are_0_and_1():
    model, plan = prepare(tiny_scene(), replace(SHORT, smoothing=0.0), RUN)
    model.parameters.rows["opacity_logits"] = torch.linspace(-200, 200, len(model.parameters))
    Trainer(model, plan, RUN).backward(plan.views[0])
    for name, value in model.parameters.rows.items():
        assert value.grad is not None, name
        assert value.grad.isfinite().all(), name


@pytest.mark.parametrize("step", [pytest.param(9, marks=pytest.mark.slow), 31])
def test_killed_and_continued_is_the_same_to_the_bit(tmp_path, step):
    class Killed(Exception):
        pass

    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_scene(), SHORT, replace(cut, report=kill))
    again, whole = (fit(tiny_scene(), SHORT, run).model for run in (cut, RUN))
    assert all(torch.equal(getattr(again, name), getattr(whole, name)) for name in FIELDS)


def test_a_negative_filter_is_refused():
    with pytest.raises(UsageError, match="smoothing is -1.0, expected >= 0"):
        MipSettings(smoothing=-1.0)
