"""Gaussians flattened along the ray to the nearest camera: what that camera sees, what others do, what stays."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.nearest_camera import NearestCamera
from splatproof.methods.training.scale_bound import ScaleBound
from splatproof.methods.training.shape_bounds import EVERY, Shapes, shape_bounds
from splatproof.methods.training.thickness_bound import ThicknessBound, axes, quaternions
from splatproof.reference.rasterizer.projection import jacobian
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.rasterizer.rotation import covariance, rotation_matrix
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import camera_view

RUN = Run(threads=1)
CAMERAS = tuple(camera(index) for index in range(3))
VIEWS = tuple(camera_view(one) for one in CAMERAS)
CENTRES = torch.stack([one.centre for one in CAMERAS])
some_rows = given(
    count=st.integers(1, 40), seed=st.integers(0, 999), share=st.floats(0.001, 0.3),
    spread=st.floats(0, 3),
)  # fmt: skip


def rows(count: int, seed: int, spread: float) -> Parameters:
    """Gaussians in sight of the cameras, in float64."""
    model = random_gaussians(count, seed=seed)
    generator = torch.Generator().manual_seed(seed + 1)
    wide = model.log_scales + spread * torch.randn(count, 3, generator=generator)
    values = {"means": model.means, "quaternions": model.quaternions, "log_scales": wide}
    return Parameters({name: value.double() for name, value in values.items()})


def covariances(parameters: Parameters) -> torch.Tensor:
    found = parameters.rows
    return covariance(found["quaternions"].detach(), found["log_scales"].detach().exp())


def seen_from(means: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Index of the nearest camera, distance and direction, one Gaussian after the other."""
    index = torch.tensor([int((CENTRES - one).norm(dim=1).argmin()) for one in means])
    ray = means - CENTRES[index]
    distance = ray.norm(dim=1)
    return index, distance, ray / distance[:, None]


def bounded(parameters: Parameters, share: float) -> None:
    ThicknessBound(share, NearestCamera(VIEWS)).apply(parameters)


@some_rows
def test_no_gaussian_is_thicker_and_the_nearest_cameras_image_of_it_stays(
    count, seed, share, spread
):
    parameters = rows(count, seed, spread)
    before = covariances(parameters)
    index, distance, ray = seen_from(parameters.rows["means"].detach())
    bounded(parameters, share)
    after = covariances(parameters)
    thickness = torch.einsum("ni,nij,nj->n", ray, after, ray).sqrt()
    assert (thickness <= share * distance * (1 + 1e-6)).all()
    for number, one in enumerate(index.tolist()):
        where = CAMERAS[one]
        turn = where.world_to_camera[:3, :3]
        here = turn @ parameters.rows["means"][number].detach() + where.world_to_camera[:3, 3]
        # on the image's inside, where the derivative is not clamped
        if abs(here[0] / here[2]) < 0.3 and abs(here[1] / here[2]) < 0.25:
            onto = jacobian(where, here[None])[0] @ turn
            then, now = (onto @ each[number] @ onto.T for each in (before, after))
            torch.testing.assert_close(now, then, rtol=1e-6, atol=1e-9 * float(then.max()))


@some_rows
def test_what_is_thin_enough_keeps_every_bit_and_twice_is_once(count, seed, share, spread):
    parameters = rows(count, seed, spread)
    before = {name: value.detach().clone() for name, value in parameters.rows.items()}
    _, distance, ray = seen_from(before["means"])
    thickness = torch.einsum("ni,nij,nj->n", ray, covariances(parameters), ray).sqrt()
    bounded(parameters, share)
    thin = thickness < share * distance * (1 - 1e-9)
    once = {name: value.detach().clone() for name, value in parameters.rows.items()}
    for name, value in once.items():
        assert torch.equal(value[thin], before[name][thin])
    assert torch.equal(once["means"], before["means"])
    norms = [each["quaternions"].norm(dim=1) for each in (once, before)]
    torch.testing.assert_close(norms[0], norms[1], rtol=1e-9, atol=0)
    bounded(parameters, share)
    for name, value in once.items():
        torch.testing.assert_close(parameters.rows[name].detach(), value, rtol=1e-6, atol=1e-9)


@some_rows
def test_nothing_grows_across_the_ray_or_along_it(count, seed, share, spread):
    """A Sigma A is at most Sigma in the two directions across, and never larger along the ray."""
    parameters = rows(count, seed, spread)
    before = covariances(parameters)
    _, _, ray = seen_from(parameters.rows["means"].detach())
    bounded(parameters, share)
    after = covariances(parameters)
    across = torch.linalg.qr(ray[:, :, None], mode="complete").Q[:, :, 1:]
    then, now = (across.mT @ each @ across for each in (before, after))
    torch.testing.assert_close(now, then, rtol=1e-6, atol=1e-9 * float(before.max()))
    along = [torch.einsum("ni,nij,nj->n", ray, each, ray) for each in (before, after)]
    assert (along[1] <= along[0] * (1 + 1e-9)).all()


@given(factor=st.floats(0.01, 100), share=st.floats(0.001, 0.3), seed=st.integers(0, 99))
def test_a_scene_in_other_units_is_flattened_in_other_units(factor, share, seed):
    def larger(one: Camera) -> Camera:
        pose = one.world_to_camera.clone()
        pose[:3, 3] *= factor
        return replace(one, world_to_camera=pose)

    here, there = rows(10, seed, 1.0), rows(10, seed, 1.0)
    with torch.no_grad():
        there.rows["means"] *= factor
        there.rows["log_scales"] += math.log(factor)
    bounded(here, share)
    views = tuple(camera_view(larger(one)) for one in CAMERAS)
    ThicknessBound(share, NearestCamera(views)).apply(there)
    torch.testing.assert_close(
        covariances(there), factor**2 * covariances(here), rtol=1e-5,
        atol=1e-9 * factor**2 * float(covariances(here).max()),
    )  # fmt: skip


@given(seed=st.integers(0, 999))
def test_axes_stay_those_that_they_are_nearest_to(seed):
    """A little flattening turns axes a little: their order and their signs are those of before."""
    generator = torch.Generator().manual_seed(seed)
    before = rotation_matrix(torch.randn(20, 4, generator=generator, dtype=torch.float64))
    scales = torch.tensor([3.0, 1.0, 2.0], dtype=torch.float64).expand(20, 3)
    shear = 1e-3 * torch.randn(20, 3, 3, generator=generator, dtype=torch.float64)
    half = (torch.eye(3) + shear) @ (before * scales[:, None, :])
    turned, found = axes(half, before)
    torch.testing.assert_close(found, scales.contiguous(), rtol=0.02, atol=0)
    torch.testing.assert_close(turned, before, rtol=0, atol=0.05)
    torch.testing.assert_close(
        turned * found[:, None, :] ** 2 @ turned.mT, half @ half.mT, rtol=1e-9, atol=1e-9
    )


@given(seed=st.integers(0, 999), spread=st.floats(0, 3))
def test_axes_of_anything_are_a_proper_rotation(seed, spread):
    generator = torch.Generator().manual_seed(seed)
    before = rotation_matrix(torch.randn(20, 4, generator=generator, dtype=torch.float64))
    half = torch.randn(20, 3, 3, generator=generator, dtype=torch.float64)
    half *= (spread * torch.randn(20, 1, 3, generator=generator)).exp()
    half[0] = 0  # a point
    half[1, :, 1:] = 0  # a line
    turned, scales = axes(half, before)
    torch.testing.assert_close(torch.linalg.det(turned), torch.ones(20).double())
    built = turned * scales[:, None, :] ** 2 @ turned.mT
    torch.testing.assert_close(built, half @ half.mT, rtol=1e-7, atol=1e-9 * float(built.max()))
    torch.testing.assert_close(rotation_matrix(quaternions(turned)), turned, rtol=0, atol=1e-12)


def test_a_gaussian_on_a_camera_stays_as_it_is():
    parameters = Parameters({
        "means": torch.zeros(1, 3), "quaternions": torch.tensor([[1.0, 0, 0, 0]]),
        "log_scales": torch.zeros(1, 3),
    })  # fmt: skip
    at = camera_view(replace(camera(0), world_to_camera=torch.eye(4).double()))
    ThicknessBound(0.01, NearestCamera((at,))).apply(parameters)
    assert torch.equal(parameters.rows["log_scales"].detach(), torch.zeros(1, 3))


def test_numbers_at_the_edges_of_float32_stay_finite():
    extremes = torch.tensor([[40.0, -80, 0], [-80, -80, 5], [60, 60, 60]])
    parameters = Parameters({
        "means": torch.zeros(3, 3),
        "quaternions": torch.tensor([[1e-30, 0, 0, 0], [0, 0, 0, 0], [1e18, 1e18, 0, 3]]),
        "log_scales": extremes,
    })  # fmt: skip
    bounded(parameters, 0.01)
    assert all(value.isfinite().all() for value in parameters.rows.values())


def test_from_above_nothing_changes_and_from_beside_the_fog_is_gone():
    """A Gaussian at the origin that reaches far up, photographed from above; then from beside, above it."""
    above = torch.eye(4, dtype=torch.float64)
    above[2, 3] = 10.0
    K = torch.tensor([[100.0, 0, 32], [0, 100, 32], [0, 0, 1]], dtype=torch.float64)
    photo = Camera(K=K, world_to_camera=above, width=64, height=64)
    # looks along x, 4 above the Gaussian (z points down), and sees nothing lower than 0.8 above it
    beside = torch.tensor(
        [[0.0, 1, 0, 0], [0, 0, 1, 4], [1, 0, 0, 10], [0, 0, 0, 1]], dtype=torch.float64
    )
    other = Camera(K=K, world_to_camera=beside, width=64, height=64)
    tall = Parameters({
        "means": torch.zeros(1, 3), "quaternions": torch.tensor([[1.0, 0, 0, 0]]),
        "log_scales": torch.tensor([[0.5, 0.5, 2.0]]).log(),
    })  # fmt: skip

    def alpha(where: Camera) -> torch.Tensor:
        found = {name: value.detach() for name, value in tall.rows.items()}
        return rasterize(
            where, found["means"], found["quaternions"], found["log_scales"].exp(),
            torch.tensor([0.8]), sh=torch.zeros(1, 1, 3),
        ).alpha  # fmt: skip

    from_above, from_beside = alpha(photo), alpha(other)
    assert float(from_beside.mean()) > 0.03
    ThicknessBound(0.01, NearestCamera((camera_view(photo),))).apply(tall)
    torch.testing.assert_close(alpha(photo), from_above, rtol=0, atol=1e-5)
    assert float(alpha(other).max()) == 0.0


def thickened(thickest: float = 0.0) -> Trainer:
    """A trainer one step before a look at the shapes."""
    model, plan = prepare(tiny_scene(), Settings(iterations=4 * EVERY, thickest=thickest), RUN)
    trainer = Trainer(model, plan, RUN)
    trainer.step = EVERY - 1
    return trainer


def test_training_keeps_to_the_bound_and_without_one_nothing_is_flattened():
    for share in (0.0, 0.01):
        trainer = thickened(share)
        trainer.advance()
        found = {name: value.detach() for name, value in trainer.model.parameters.rows.items()}
        centres = torch.stack([view.camera.centre for view in trainer.plan.views])
        apart = torch.cdist(found["means"].double(), centres)
        distance, nearest = apart.min(dim=1)
        ray = (found["means"].double() - centres[nearest]) / distance[:, None]
        sigma = covariance(found["quaternions"].double(), found["log_scales"].double().exp())
        thickness = torch.einsum("ni,nij,nj->n", ray, sigma, ray).sqrt() / distance
        assert bool((thickness <= 0.01 * (1 + 1e-4)).all()) == bool(share)


def test_both_bounds_come_one_after_the_other_and_ask_the_same_cameras():
    parameters = rows(3, 0, 1.0)
    wide, thick = shape_bounds(Shapes(widest=0.5, thickest=0.01), VIEWS, parameters)
    assert (wide.share, thick.share) == (0.5, 0.01)
    assert wide.cameras is thick.cameras
    (wide,) = shape_bounds(Shapes(widest_at_points=0.2), VIEWS, parameters)
    assert isinstance(wide, ScaleBound)
    assert (wide.share, wide.near) == (math.inf, 0.2)
    # its points are where the Gaussians are at first: no gap there
    torch.testing.assert_close(
        wide.largest(parameters.rows["means"]),
        ScaleBound(0.2, wide.cameras).largest(parameters.rows["means"]),
    )


def test_a_model_without_shapes_and_a_negative_share_are_refused():
    colours = Parameters({"means": torch.zeros(2, 3)})
    with pytest.raises(UsageError, match="setting thickest is 0.01, expected 0"):
        shape_bounds(Shapes(thickest=0.01), VIEWS, colours)
    with pytest.raises(UsageError, match="thickest"):
        Settings(thickest=-0.1)
