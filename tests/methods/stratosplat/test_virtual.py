"""Virtual Gaussians of a view: planes, field and model against their references."""

import json

import pytest
import torch
from torch.testing import assert_close

from helpers.aerial_scene import aerial_scene, camera
from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.stratosplat.model import KEPT_VIEWS, HybridModel, restored
from splatproof.methods.stratosplat.settings import Planes
from splatproof.methods.stratosplat.virtual import (
    Stack,
    asked,
    drawn_field,
    stack_of,
    unit_field,
    view_sites,
)
from splatproof.methods.training.schedules import Rates
from splatproof.reference.layered_memory import coordinate_field, multi_plane
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import camera_view

UP = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)


def ground() -> torch.Tensor:
    return aerial_scene(points=200).points.positions


def hybrid(planes: Planes, seed: int = 0) -> HybridModel:
    start = random_gaussians(20, seed=seed)
    means = start.means * 0.5 + torch.tensor([0.0, 0.0, 3.5])
    start = Gaussians(**(vars(start) | {"means": means}))
    field = drawn_field(planes, torch.Generator().manual_seed(seed))
    field = {name: value + 0.3 * torch.randn(value.shape) for name, value in field.items()}
    return HybridModel(
        start, Rates(), extent=1.0, stack=stack_of(ground(), UP, planes.count), planes=planes,
        field=field,
    )  # fmt: skip


def test_planes_lie_across_the_direction_of_least_variance_and_cover_the_cloud():
    stack = stack_of(ground(), UP, 5)
    assert float(stack.planes.normal @ UP) > 0.9
    assert_close(stack.frame @ stack.frame.T, torch.eye(3, dtype=torch.float64))
    heights = -stack.planes.offsets
    assert heights.tolist() == pytest.approx(
        torch.linspace(float(heights[0]), float(heights[-1]), 5).tolist()
    )
    inside = ground() @ stack.frame.T
    assert bool((inside >= stack.low).all() & (inside <= stack.high).all())


def test_one_wild_depth_does_not_stretch_the_planes():
    calm = torch.cat([ground(), ground() + 0.01])
    wild = torch.cat([calm, torch.tensor([[0.0, 0.0, 300.0]], dtype=torch.float64)])
    want, got = (stack_of(cloud, UP, 5).planes.offsets for cloud in (calm, wild))
    assert float((want.amax() - want.amin()) / (got.amax() - got.amin())) > 0.3


def test_a_cloud_without_a_flattest_direction_takes_up():
    ends = torch.cat([torch.eye(3), -torch.eye(3)]).double()
    assert_close(stack_of(ends, UP, 2).planes.normal, UP)


def test_points_on_one_place_are_refused():
    with pytest.raises(DataError, match="on one line"):
        stack_of(torch.ones(5, 3, dtype=torch.float64), UP, 2)


def test_the_stack_survives_json():
    stack = stack_of(ground(), UP, 3)
    again = Stack.read(json.loads(json.dumps(stack.facts())))
    assert torch.equal(again.planes.offsets, stack.planes.offsets)
    assert torch.equal(again.planes.normal, stack.planes.normal)
    assert torch.equal(again.frame, stack.frame)


@pytest.mark.parametrize("stride", [1, 2, 5])
def test_the_model_draws_what_the_references_compose(stride):
    """The native image of one buffer against float64 rays, field and rasterizer."""
    planes = Planes(count=3, stride=stride, finest=16)
    model, where = hybrid(planes), camera(1)
    hits = multi_plane.ray_hits(
        model.stack.planes, where.centre, multi_plane.pixel_rays(where, stride), where.near
    )
    exact = {name: value.double() for name, value in model.parameters.shared.items()}
    places = (hits.positions[hits.valid] @ model.stack.frame.T - model.stack.low) / (
        model.stack.high - model.stack.low
    )
    outputs = coordinate_field.evaluate(unit_field(exact), places)
    virtual = multi_plane.virtual_gaussians(outputs, hits, where, stride)
    explicit = model.gaussians()
    want = multi_plane.render_joint(
        where,
        Gaussians(**{name: value.double() for name, value in vars(explicit).items()}),
        virtual,
    ).colour
    splats = model.splats(camera_view(where), TRAINED)
    got = get_backend("cpu").draw(where, splats).colour
    # a pixel on the step at alpha = 1/255 may differ by that much
    assert float((got.double() - want).abs().max()) < 2 / 255
    assert float((got.double() - want).abs().mean()) < 1e-4


def test_a_table_holds_numbers_of_its_own_for_each_cell_and_plane():
    planes = Planes(field="table", count=2, stride=3, finest=16)
    sites = view_sites(stack_of(ground(), UP, 2), camera(1), planes)
    table = torch.arange(2 * 32 * 32 * 9.0).reshape(2, 32, 32, 9)
    found = asked({"table": table}, sites)
    for i in range(0, len(found), 17):
        x, y = (int(min(max(v * 32, 0), 31)) for v in sites.places[i, :2].tolist())
        assert torch.equal(found[i], table[int(sites.planes[i]), y, x])


def test_virtual_gaussians_are_of_no_row_and_do_not_move():
    model = hybrid(Planes(count=3, stride=3, finest=16))
    for value in model.parameters.trained.values():
        value.requires_grad_()
    splats = model.splats(camera_view(camera(1)), TRAINED)
    assert splats.rows is not None
    count = len(model.parameters)
    assert splats.rows[:count].tolist() == list(range(count))
    assert set(splats.rows[count:].tolist()) == {-1}
    image = get_backend("cpu").draw(camera(1), splats).colour
    image.square().sum().backward()
    assert all(value.grad is not None for value in model.parameters.shared.values())
    seen = Observation(
        camera=camera(1), radii=torch.ones(len(splats)), opacities=None, signed=None, absolute=None,
        rows=splats.rows, slots=None, count=count,
    )  # fmt: skip
    assert torch.equal(seen.by_row(torch.ones(len(splats))), torch.ones(count))


def test_sites_of_few_views_are_kept():
    model = hybrid(Planes(count=1, stride=12, finest=16))
    first = model.sites(camera(0))
    assert model.sites(camera(0)) is first
    for index in range(1, KEPT_VIEWS + 1):
        model.sites(camera(index))
    assert len(model._sites) == KEPT_VIEWS
    assert model.sites(camera(0)) is not first


@pytest.mark.parametrize("field", ["neural", "table"])
def test_what_is_stored_is_restored(field):
    model = hybrid(Planes(field=field, count=3, stride=3, finest=16))
    facts = json.loads(json.dumps(model.facts()))
    again = restored(facts, model.parameters.state())
    want, got = (m.splats(camera_view(camera(2)), TRAINED) for m in (model, again))
    for name in ("means", "scales", "opacities", "colours"):
        assert torch.equal(getattr(want, name), getattr(got, name))


def test_a_wild_depth_does_not_stretch_planes_and_field():
    generator = torch.Generator().manual_seed(2)
    flat = torch.rand(2000, 3, generator=generator).double() * torch.tensor([10.0, 10.0, 1.0])
    wild = torch.cat([flat, torch.tensor([[5.0, 5.0, 60.0], [300.0, 5.0, 0.5]]).double()])
    up = torch.tensor([0.0, 0, 1]).double()
    calm, found = stack_of(flat, up, 4), stack_of(wild, up, 4)
    width = found.planes.offsets.max() - found.planes.offsets.min()
    assert width < 1.1 * (calm.planes.offsets.max() - calm.planes.offsets.min())
    assert (found.high - found.low).amax() < 1.1 * (calm.high - calm.low).amax()
