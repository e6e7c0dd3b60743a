"""LiDAR and sky terms: what is projected where, gradients through the rasterizers, what is never read."""

from dataclasses import replace
from typing import NoReturn

import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import Moment
from splatproof.methods.dynamic.settings import LidarSettings, SkySettings
from splatproof.methods.dynamic.terms import lidar_image, lidar_term, scene_terms, sky_term
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.training.schedules import Rates
from splatproof.methods.training.terms import Frame
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, Sweep, View
from splatproof.reference.types.splats import activated

LIDAR = LidarSettings(weight=1.0, inverse=False, decay=0.0)


def sweep(positions: torch.Tensor) -> Sweep:
    return Sweep(positions=positions.float(), origin=torch.zeros(3, dtype=torch.float64), time=0.0)


def forbidden() -> NoReturn:
    raise AssertionError("truth was read")


def seeing(view: View, positions: torch.Tensor | None = None, sky: torch.Tensor | None = None):
    return replace(
        view, load_depth=forbidden, load_moving=forbidden,
        load_sweep=None if positions is None else lambda: sweep(positions),
        load_sky=None if sky is None else lambda: sky,
    )  # fmt: skip


def frame(view: View, gaussians=None, *, backend: str = "cpu", step: int = 1, mask=None) -> Frame:
    gaussians = gaussians or random_gaussians(40)
    splats = activated(gaussians)
    output = get_backend(backend).draw(view.camera, splats)
    model = GaussianModel(gaussians, Rates(), extent=1.0)
    return Frame(
        view=view, moment=Moment(step=step, total=1000), splats=splats, output=output,
        image=output.colour, truth=output.colour, mask=mask, model=model,
    )  # fmt: skip


def returns(count: int = 300) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(4)) * 6 - 3


def test_every_pixel_has_its_nearest_return():
    where, points = camera(1), returns()
    points = torch.cat([points, points * 1.0, where.centre.float()[None] - 1])
    pixels, depth = project_points(where, points.double())
    wanted = torch.zeros(18, 24)
    for (x, y), z in zip(pixels.tolist(), depth.tolist(), strict=True):
        if z > where.near and 0 <= x < 24 and 0 <= y < 18:
            before = float(wanted[int(y), int(x)])
            wanted[int(y), int(x)] = min(before, z) if before else z
    assert int((wanted > 0).sum()) > 50
    torch.testing.assert_close(lidar_image(where, points), wanted)


def test_two_returns_in_a_pixel_and_one_behind_the_camera():
    where = replace(camera(0), world_to_camera=torch.eye(4, dtype=torch.float64))
    ray = torch.tensor([0.01, 0.01, 1.0])
    image = lidar_image(where, torch.stack([5 * ray, 3 * ray, 4 * ray, -2 * ray]))
    assert float(image[9, 12]) == pytest.approx(3.0)
    assert int((image > 0).sum()) == 1
    assert not lidar_image(where, torch.zeros(0, 3)).any()


@pytest.mark.parametrize("inverse", [False, True])
def test_the_lidar_term_is_zero_where_the_depth_is_right(inverse):
    term = lidar_term(replace(LIDAR, inverse=inverse), steps=1000, extent=2.0)
    one = random_gaussians(1)
    near = replace(one, means=torch.tensor([[1.0, 0.0, 0.0]]), log_scales=torch.full((1, 3), 5.0),
                   opacity_logits=torch.tensor([9.0]))  # fmt: skip
    view = tiny_scene().views[0]  # stands at z = -4 and looks along z
    at = camera(0).centre.float() + torch.tensor([[0.0, 0.0, 4.0]])
    drawn = frame(seeing(view, at), near)
    right = float(term.loss(drawn))
    alpha = float(drawn.output.alpha.amax())  # 0.99 of the surface is there at most
    assert right == pytest.approx((1 - alpha) * 2 / 4 if inverse else 0.0, abs=1e-5)
    # 1 unit too far: 1 / 2 extents, or 2 extents / 4 - 2 extents / 5
    further = frame(seeing(view, at + torch.tensor([[0.0, 0.0, 1.0]])), near)
    wanted = alpha * 2 / 4 - 2 / 5 if inverse else 0.5
    assert float(term.loss(further)) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
@pytest.mark.parametrize("inverse", [False, True])
def test_its_gradient_moves_surfaces_to_where_the_light_came_from(backend, inverse):
    term = lidar_term(replace(LIDAR, inverse=inverse), steps=1000, extent=1.0)
    start = random_gaussians(40)
    gaussians = replace(start, means=start.means.clone().requires_grad_())
    view = seeing(tiny_scene().views[1], random_gaussians(40).means + torch.tensor([0, 0, 9.0]))
    term.loss(frame(view, gaussians, backend=backend)).backward()
    gradient = gaussians.means.grad
    assert gradient is not None
    assert float(gradient[:, 2].sum()) < 0  # what is behind has been measured: go there


def test_the_weight_of_lidar_decays_with_the_steps_of_the_run():
    settings = replace(LIDAR, decay=8000.0)
    term = lidar_term(settings, steps=3000, extent=1.0)  # a tenth of a full run
    view = seeing(tiny_scene().views[1], returns())
    first, later = (float(term.loss(frame(view, step=step))) for step in (100, 900))
    assert later / first == pytest.approx(2.718281828**-1, rel=1e-5)
    steady = lidar_term(LIDAR, steps=3000, extent=1.0)
    assert float(steady.loss(frame(view, step=900))) == float(steady.loss(frame(view, step=1)))


def test_the_sky_term_wants_nothing_in_the_sky_and_something_elsewhere():
    term = sky_term(SkySettings())
    view = tiny_scene().views[1]
    alpha = frame(view).output.alpha
    half = torch.zeros(18, 24, dtype=torch.bool)
    half[:9] = True
    for sky in (half, ~half):
        drawn = frame(seeing(view, sky=sky))
        alpha = drawn.output.alpha.clamp(1e-6, 1 - 1e-6)
        wanted = -torch.where(sky, 1 - alpha, alpha).log().mean()
        torch.testing.assert_close(term.loss(drawn), wanted)
    assert term.weight == 0.05


def test_masked_pixels_say_nothing():
    mask = torch.zeros(18, 24, dtype=torch.bool)
    view = seeing(tiny_scene().views[1], returns(), torch.ones(18, 24, dtype=torch.bool))
    lidar = lidar_term(LIDAR, steps=1000, extent=1.0)
    assert float(lidar.loss(frame(view))) > 0
    assert float(lidar.loss(frame(view, mask=mask))) == 0
    assert float(sky_term(SkySettings()).loss(frame(view, mask=mask))) == 0
    mask[3:6] = True
    drawn = frame(view, mask=mask)
    alpha = drawn.output.alpha[3:6].clamp(1e-6, 1 - 1e-6)
    torch.testing.assert_close(sky_term(SkySettings()).loss(drawn), -(1 - alpha).log().mean())


def test_a_view_without_sweep_or_mask_says_nothing():
    view = tiny_scene().views[1]
    assert float(lidar_term(LIDAR, steps=10, extent=1.0).loss(frame(view))) == 0
    assert float(sky_term(SkySettings()).loss(frame(view))) == 0


def test_sweeps_are_read_once():
    calls = []
    view = replace(tiny_scene().views[1], load_sweep=lambda: calls.append(0) or sweep(returns()))
    term = lidar_term(LIDAR, steps=10, extent=1.0)
    assert float(term.loss(frame(view))) == float(term.loss(frame(view)))
    assert len(calls) == 1


def with_one(scene: Scene, **more) -> Scene:
    views = list(scene.views)
    views[2] = replace(views[2], **more)
    return replace(scene, views=tuple(views))


def test_what_a_scene_lacks_is_said_with_the_setting_that_does_without():
    scene, sky, lidar = tiny_scene(), SkySettings(), LidarSettings()

    def names(scene: Scene, lidar: LidarSettings, sky: SkySettings) -> list[str]:
        return [term.name for term in scene_terms(scene, lidar, sky, steps=10, extent=1.0)]

    with pytest.raises(
        DataError, match=r"no training view has a LiDAR sweep; set lidar.weight = 0"
    ):
        names(scene, lidar, sky)
    with pytest.raises(DataError, match=r"no training view has a sky mask; set sky.weight = 0"):
        names(scene, replace(lidar, weight=0.0), sky)
    assert names(scene, replace(lidar, weight=0.0), replace(sky, weight=0.0)) == []
    assert names(scene, replace(lidar, weight=0.0), replace(sky, resolution=0)) == []
    some = with_one(scene, load_sweep=forbidden, load_sky=forbidden)
    assert names(some, lidar, sky) == ["lidar", "sky"]
    held_out = replace(some, train=(1, 3), test=(0, 2))
    with pytest.raises(DataError, match="LiDAR sweep"):
        names(held_out, lidar, sky)


@pytest.mark.parametrize(
    ("kind", "given", "told"),
    [
        (SkySettings, {"resolution": -1}, "sky.resolution is -1, expected >= 0"),
        (SkySettings, {"initial": 2.0}, "sky.initial is 2.0, expected 0 to 1"),
        (SkySettings, {"weight": -0.1}, "sky.weight is -0.1, expected >= 0"),
        (LidarSettings, {"weight": float("inf")}, "lidar.weight is inf, expected >= 0"),
        (LidarSettings, {"decay": -1.0}, "lidar.decay is -1.0, expected >= 0"),
    ],
)
def test_settings_that_no_run_can_follow_are_refused(kind, given, told):
    with pytest.raises(UsageError, match=told):
        kind(**given)
