"""Scales bounded by the nearest camera: what the bound holds, what it leaves alone, and the veil that it is there for."""

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
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import camera_view

RUN = Run(threads=1)
VIEWS = tuple(camera_view(camera(index)) for index in range(3))
CENTRES = torch.stack([camera(index).centre for index in range(3)])
TALLER = 20.0
"""How far a plane lies below the camera of the veil, in scene units."""


def rows(count: int, seed: int, spread: float) -> Parameters:
    model = random_gaussians(count, seed=seed)
    generator = torch.Generator().manual_seed(seed + 1)
    wide = model.log_scales + spread * torch.randn(count, 3, generator=generator)
    return Parameters({"means": 4 * model.means, "log_scales": wide})


@given(
    count=st.integers(1, 40), seed=st.integers(0, 999), share=st.floats(0.05, 3),
    spread=st.floats(0, 4),
)  # fmt: skip
def test_no_scale_is_above_its_share_and_no_other_changes(count, seed, share, spread):
    parameters = rows(count, seed, spread)
    before = {name: value.clone() for name, value in parameters.rows.items()}
    ScaleBound(share, NearestCamera(VIEWS)).apply(parameters)
    after = parameters.rows["log_scales"]
    nearest = torch.cdist(before["means"].double(), CENTRES).amin(dim=1)
    top = (share * nearest)[:, None]
    assert (after.double().exp() <= top * (1 + 1e-5)).all()
    below = before["log_scales"].double().exp() <= top * (1 - 1e-5)
    assert torch.equal(after[below], before["log_scales"][below])
    assert (after <= before["log_scales"]).all()
    assert torch.equal(parameters.rows["means"], before["means"])
    ScaleBound(share, NearestCamera(VIEWS)).apply(parameters)
    assert torch.equal(parameters.rows["log_scales"], after)


@given(
    seed=st.integers(0, 999),
    spread=st.floats(0, 4),
    near=st.floats(0.01, 0.5),
    share=st.floats(0.5, 3),
)
def test_near_points_the_bound_is_narrower_and_in_a_gap_as_wide_as_the_gap(
    seed, spread, near, share
):
    parameters = rows(30, seed, spread)
    points = 4 * random_gaussians(12, seed=seed + 7).means
    means = parameters.rows["means"].detach().double()
    before = parameters.rows["log_scales"].detach().double().exp()
    ScaleBound(share, NearestCamera(VIEWS), near, points).apply(parameters)
    after = parameters.rows["log_scales"].detach().double().exp()
    for was, now, mean in zip(before, after, means, strict=True):
        far = (CENTRES - mean).norm(dim=1).min()
        gap = (points.double() - mean).norm(dim=1).min()
        top = min(share * far, max(near * far, gap))
        torch.testing.assert_close(now, was.clamp(max=float(top)), rtol=1e-4, atol=0)


def test_a_bound_at_points_alone_leaves_a_gap_unbounded():
    """Cameras 4 units from the cube; Gaussians on the only point, far away from it, and on a camera."""
    means = torch.stack([torch.zeros(3), torch.tensor([0.0, 0, 50]), CENTRES[0].float()])
    parameters = Parameters({"means": means, "log_scales": torch.full((3, 3), 3.0)})
    bound = ScaleBound(math.inf, NearestCamera(VIEWS), 0.1, torch.zeros(1, 3))
    bound.apply(parameters)
    on, away, camera_one = parameters.rows["log_scales"].detach().exp()
    nearest = float(CENTRES.norm(dim=1).min())
    torch.testing.assert_close(camera_one, CENTRES[0].norm().float().expand(3), rtol=1e-4, atol=0)
    torch.testing.assert_close(on, torch.full((3,), 0.1 * nearest), rtol=1e-4, atol=0)
    assert torch.equal(away, torch.full((3,), 3.0).exp())  # 20 wide, 50 from the point


@given(share=st.floats(0.05, 3), factor=st.floats(0.01, 100), seed=st.integers(0, 99))
def test_a_scene_in_other_units_has_the_bound_in_other_units(share, factor, seed):
    means = 4 * random_gaussians(10, seed=seed).means

    def larger(one: Camera) -> Camera:
        pose = one.world_to_camera.clone()
        pose[:3, 3] *= factor
        return replace(one, world_to_camera=pose)

    scaled = tuple(camera_view(larger(view.camera)) for view in VIEWS)
    torch.testing.assert_close(
        ScaleBound(share, NearestCamera(scaled)).largest(factor * means),
        factor * ScaleBound(share, NearestCamera(VIEWS)).largest(means),
        rtol=1e-4, atol=0,
    )  # fmt: skip


def test_a_gaussian_on_a_camera_keeps_finite_parameters():
    """One camera stands exactly where the Gaussian is."""
    parameters = Parameters({"means": torch.zeros(1, 3), "log_scales": torch.zeros(1, 3)})
    at = camera_view(replace(camera(0), world_to_camera=torch.eye(4).double()))
    ScaleBound(0.5, NearestCamera((at,))).apply(parameters)
    assert parameters.rows["log_scales"].isfinite().all()
    assert (parameters.rows["log_scales"].exp() < 1e-30).all()


def looking_up(degrees: float) -> Camera:
    """At the origin, over a plane y = TALLER that lies below it; y points down, the view goes up."""
    turn = math.radians(degrees)
    pose = torch.eye(4, dtype=torch.float64)
    pose[1:3, 1:3] = torch.tensor(
        [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
    )
    K = torch.tensor([[200.0, 0, 120], [0, 200, 88], [0, 0, 1]], dtype=torch.float64)
    return Camera(K=K, world_to_camera=pose, width=240, height=176)


@pytest.mark.parametrize("degrees", [50.0, 60.0, 70.0])
def test_a_wide_piece_of_ground_veils_a_view_of_the_sky_unless_bounded(degrees):
    """No ray of the view meets the ground: half of the field of view is below 24 degrees."""
    where = looking_up(degrees)
    mean = torch.tensor([[0.0, TALLER, 70.0]])

    def veil(wide: float) -> float:
        scales = torch.tensor([[wide, 0.1, wide]])
        drawn = rasterize(
            where, mean, torch.tensor([[1.0, 0, 0, 0]]), scales, torch.tensor([0.9]),
            sh=torch.zeros(1, 1, 3),
        )  # fmt: skip
        return float(drawn.alpha.mean())

    free = veil(236.0)
    assert free > 0.5
    largest = ScaleBound(0.5, NearestCamera((camera_view(where),))).largest(mean)
    assert veil(float(largest)) < free / 20


def widened(widest: float = 0.0) -> Trainer:
    """A trainer one step before a look at the scales, its first Gaussian 1,000 times as wide as before."""
    model, plan = prepare(tiny_scene(), Settings(iterations=4 * EVERY, widest=widest), RUN)
    trainer = Trainer(model, plan, RUN)
    trainer.step = EVERY - 1
    model.parameters.rows["log_scales"].detach()[0] += math.log(1000)
    return trainer


def test_training_keeps_to_the_bound_and_without_one_nothing_is_bounded():
    free, bounded = widened(), widened(widest=0.5)
    for one in (free, bounded):
        one.advance()
    centres = torch.stack([view.camera.centre for view in bounded.plan.views])
    for one, held in ((free, False), (bounded, True)):
        found = one.model.parameters.rows
        nearest = torch.cdist(found["means"].detach().double(), centres).amin(dim=1)
        share = found["log_scales"].detach().exp().amax(dim=1).double() / nearest
        assert bool((share <= 0.5 * (1 + 1e-5)).all()) == held
    assert torch.equal(
        free.model.parameters.rows["log_scales"][1:],
        bounded.model.parameters.rows["log_scales"][1:],
    )


def test_scales_are_looked_at_every_so_many_steps():
    trainer = widened(widest=0.5)
    trainer.step = EVERY
    trainer.advance()
    assert float(trainer.model.parameters.rows["log_scales"].detach()[0].exp().amax()) > 10


def test_what_is_held_keeps_its_scale():
    trainer = widened(widest=0.5)
    held = {"log_scales": torch.tensor([0])}
    trainer.plan = replace(trainer.plan, held=lambda parameters: held)
    before = trainer.model.parameters.rows["log_scales"].detach()[0].clone()
    trainer.advance()
    assert torch.equal(trainer.model.parameters.rows["log_scales"].detach()[0], before)


def test_a_continued_training_has_the_points_that_it_began_with(tmp_path):
    run, ends = Run(threads=1, folder=tmp_path), []
    for _ in range(2):
        settings = Settings(iterations=4 * EVERY, widest_at_points=0.2)
        trainer = Trainer(*prepare(tiny_scene(), settings, run), run)
        trainer.resume()
        (bound,) = trainer.bounds
        assert isinstance(bound, ScaleBound)
        assert bound.points is not None
        ends.append((torch.tensor(bound.points.data), trainer.model.parameters.rows["means"]))
        trainer.advance()
        trainer.save()
    (points, _), (again, moved) = ends
    assert torch.equal(points, again)
    assert not torch.equal(again.float(), moved.detach())


def test_a_model_without_scales_refuses_the_bound():
    colours = Parameters({"means": torch.zeros(2, 3)})
    assert shape_bounds(Shapes(), VIEWS, colours) == ()
    with pytest.raises(UsageError, match="setting widest is 0.5, expected 0"):
        shape_bounds(Shapes(widest=0.5), VIEWS, colours)


def test_a_negative_share_is_refused():
    with pytest.raises(UsageError, match="widest"):
        Settings(widest=-0.1)
    with pytest.raises(UsageError, match="widest_at_points"):
        Settings(widest_at_points=-0.1)
