"""The model of moving anchors: what is decoded, where, and what neither view nor time may change."""

import itertools
import math
from dataclasses import replace
from typing import get_args

import pytest
import torch

from helpers.tiny_drive import tiny_drive
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import TRAINED, Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.hdgs.consistency import Ice, supported
from splatproof.methods.hdgs.decode import decode_some
from splatproof.methods.hdgs.fit import prepare
from splatproof.methods.hdgs.model import CYCLE, Frame, HdgsModel, pyramid_of
from splatproof.methods.hdgs.networks import hierarchy, support
from splatproof.methods.hdgs.settings import Settings, Smoothing
from splatproof.reference.anchors.motion_hierarchy import decode
from splatproof.reference.anchors.support_network import support as reference_support
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import View

SMALL = Settings(iterations=20, gaussians=4, features=6, instance=3, anchors=40)


def shaken(seed: int = 0, **more) -> HdgsModel:
    """A model whose every tensor is off its start, so that nothing is zero by chance."""
    model, _ = prepare(tiny_drive(), replace(SMALL, **more), Run(threads=1))
    generator = torch.Generator().manual_seed(seed)
    for value in model.parameters.trained.values():
        value += 0.15 * torch.randn(value.shape, generator=generator)
    return model


def drawn(model: HdgsModel, view: View) -> torch.Tensor:
    splats = model.splats(view, TRAINED)
    return get_backend("reference").draw(view.camera, splats).colour


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("wide", [False, True])
def test_nothing_that_a_view_shows_is_left_out(seed, wide, monkeypatch):
    model, views = shaken(seed), tiny_drive().views
    model.parameters.rows["velocities"] *= 20  # some swing in from beyond the border
    model.parameters.rows["log_scales"] -= 1 if wide else 3
    if wide:  # Gaussians at their anchors, and reaching into the view from beyond its border
        model.parameters.rows["offsets2"] *= 0
        model.parameters.shared["leaf_position.weight1"] *= 0
        model.parameters.shared["leaf_position.bias1"] *= 0
    near = replace(views[0].camera, width=9, height=7)  # most anchors lie outside
    view = replace(views[5], camera=near)
    some = model.splats(view, TRAINED)
    image = drawn(model, view)
    rows = model.parameters.rows
    alive = torch.exp(-0.5 * ((model.time(view) - rows["peaks"]) / rows["log_spans"].exp()) ** 2)
    everything = torch.where(alive > 0.05)[0]
    monkeypatch.setattr(model, "in_view", lambda camera, time, later: everything)
    all_splats = model.splats(view, TRAINED)
    assert 0 < len(some) < len(all_splats)
    torch.testing.assert_close(image, drawn(model, view), atol=1e-6, rtol=0)


def test_what_is_decoded_is_the_reference_of_supported_features():
    model, view = shaken(), tiny_drive().views[2]
    splats = model.splats(view, TRAINED)
    anchors, shared, frame = model.anchors(), model.parameters.shared, model.frame
    features = reference_support(
        support(shared), anchors.features, anchors.centres, anchors.quaternions,
        anchors.log_scales.exp(), model.voxel,
    )  # fmt: skip
    want = decode(
        replace(anchors, features=features), hierarchy(shared, 3), model.sizes, model.time(view),
        frame.inwards(view.camera.centre),
    )  # fmt: skip
    assert splats.slots is not None
    mine = splats.slots
    torch.testing.assert_close(splats.means, frame.outwards(want.means)[mine], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(
        splats.scales, (want.scales * frame.unit)[mine], atol=1e-6, rtol=1e-5
    )
    torch.testing.assert_close(splats.opacities, want.opacities[mine], atol=1e-5, rtol=1e-5)
    assert splats.colours is not None
    assert want.colours is not None
    torch.testing.assert_close(splats.colours, want.colours[mine], atol=1e-5, rtol=1e-5)
    assert splats.rows is not None
    assert torch.equal(splats.rows, mine // 4)
    assert splats.decoded is not None
    assert torch.equal(splats.decoded, splats.rows[::4])


def test_each_part_of_the_consistency_step_that_is_left_out_is_left_out():
    """The networks of support are drawn last: models with and without them have the others alike."""
    view, colours = tiny_drive().views[2], {}
    for ice in get_args(Ice):
        model = shaken(ice=ice)
        rows, shared, frame = model.parameters.rows, model.parameters.shared, model.frame
        seen = model.in_view(view.camera, model.time(view))
        features = rows["features"][seen]
        if ice != "off":
            features = supported(
                support(shared), rows["features"], model.parameters.labels["centres"],
                rows["quaternions"], rows["log_scales"].exp(), model.near(), seen, ice,
            )  # fmt: skip
        want = decode_some(
            model.anchors(), hierarchy(shared, 3), model.sizes, model.time(view),
            frame.inwards(view.camera.centre), seen, features=features,
            unit=frame.unit, middle=frame.middle,
        )  # fmt: skip
        found = model.splats(view, TRAINED)
        assert found.colours is not None
        assert want.colours is not None
        torch.testing.assert_close(found.colours, want.colours, atol=1e-6, rtol=1e-6)
        colours[ice] = drawn(model, view)
    for one, other in itertools.combinations(colours, 2):
        assert not torch.allclose(colours[one], colours[other], atol=1e-3), (one, other)


def test_the_anchors_own_motion_repeats_and_the_dead_are_not_decoded():
    model, view = shaken(), tiny_drive().views[2]
    model.parameters.rows["log_spans"].fill_(50.0)
    with torch.no_grad():  # without residual networks only the vibration knows the time
        for name, value in model.parameters.shared.items():
            if "position" in name or "scale" in name or "feature" in name:
                value.zero_()
    period = model.sizes.period * 0.2 / model.clock.second
    assert view.time is not None
    later = replace(view, time=view.time + period)
    between = replace(view, time=view.time + period / 3)
    one, same, other = (model.splats(v, TRAINED).means for v in (view, later, between))
    torch.testing.assert_close(one, same, atol=1e-4, rtol=1e-4)
    assert one.shape != other.shape or not torch.allclose(one, other, atol=1e-3)
    model.parameters.rows["log_spans"].fill_(-3.0)
    model.parameters.rows["peaks"].fill_(9.0)
    assert len(model.splats(view, TRAINED)) == 0


def test_static_anchors_do_not_move_and_live_forever():
    model, _ = prepare(tiny_drive(), replace(SMALL, motion="static"), Run(threads=1))
    assert not {"velocities", "peaks", "log_spans"} & model.schedules.keys()
    view = tiny_drive().views[0]
    one, other = (model.splats(replace(view, time=time), TRAINED) for time in (0.0, 0.7))
    assert torch.equal(one.means, other.means)
    assert torch.equal(one.opacities, other.opacities)


def test_pairs_are_found_again_only_when_the_anchors_change():
    model = shaken()
    first = model.near()
    assert model.near() is first
    labels = model.parameters.labels
    model.parameters.to(torch.device("cpu"))  # another tensor, the same memory
    assert model.near() is first
    labels["centres"] = labels["centres"][:3].clone()
    assert int(model.near().sites.max()) < 3


def test_a_view_without_a_time_is_refused():
    with pytest.raises(UsageError, match="has no time"):
        shaken().splats(replace(tiny_drive().views[0], time=None), TRAINED)


def test_a_smoothed_step_draws_another_moment_moved_on():
    model = shaken(smoothing=Smoothing(probability=1.0, reach=0.15))
    model.parameters.rows["log_spans"].fill_(0.3)  # all are alive at both moments, and drift
    view = tiny_drive().views[2]
    _, place = torch.rand(2, generator=torch.Generator().manual_seed(11)).tolist()
    later = (2 * place - 1) * 0.15
    generator = torch.Generator().manual_seed(11)
    splats = model.splats(view, Moment(step=1, total=9, generator=generator))
    assert view.time is not None
    then = replace(view, time=view.time - later * CYCLE / model.clock.second)
    still = model.splats(then, TRAINED)
    assert splats.slots is not None
    assert still.slots is not None
    assert splats.colours is not None
    assert still.colours is not None
    at = {int(row): place for place, row in enumerate(still.slots)}
    both = [(place, at[int(row)]) for place, row in enumerate(splats.slots) if int(row) in at]
    ours, theirs = (torch.tensor(places) for places in zip(*both, strict=True))
    slow = model.parameters.rows["velocities"][splats.rows] * math.exp(-math.exp(0.3) / 2)
    moved = model.frame.outwards(slow * later) - model.frame.outwards(torch.zeros(1, 3))
    assert len(both) > 0.9 * len(splats)
    assert float(moved.abs().max()) > 1e-3
    torch.testing.assert_close(splats.means[ours], (still.means[theirs] + moved[ours]))
    torch.testing.assert_close(splats.opacities[ours], still.opacities[theirs])
    torch.testing.assert_close(splats.colours[ours], still.colours[theirs])


def test_a_pyramid_is_the_cameras_in_the_models_frame():
    frame = Frame(middle=(3.0, -7.0, 11.0), unit=4.5)
    camera = replace(tiny_drive().views[2].camera, near=0.9)
    pyramid = pyramid_of(camera, frame)
    draw = torch.randn(400, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    local = 6 * draw + torch.tensor([0, 0, 4.0])  # before the camera, beside it and behind it
    pose = camera.world_to_camera.double()
    world = (local - pose[:3, 3]) @ pose[:3, :3]
    found = frame.inwards(world).float() @ pyramid.pose[:, :3].T + pyramid.pose[:, 3]
    torch.testing.assert_close(found, (local / 4.5).float(), atol=2e-6, rtol=1e-5)
    assert pyramid.near == pytest.approx(0.2)
    pixels, depth = project_points(camera, world)
    size = torch.tensor([camera.width, camera.height])
    shown = ((pixels >= 0) & (pixels <= size)).all(dim=1) & (depth > 0)
    assert torch.equal((found @ pyramid.sides.T > 0).all(dim=1), shown)
    assert 20 < int(shown.sum()) < 380


@pytest.mark.parametrize("seed", range(4))
def test_nothing_that_a_smoothed_step_shows_is_left_out(seed, monkeypatch):
    model = shaken(seed, smoothing=Smoothing(probability=1.0))
    model.parameters.rows["velocities"] *= 200  # some drift in from beyond the border
    model.parameters.rows["log_spans"].fill_(0.3)  # all are alive
    model.parameters.rows["log_scales"] -= 3
    view = tiny_drive().views[5]
    view = replace(view, camera=replace(view.camera, width=9, height=7))

    def image() -> tuple[torch.Tensor, int]:
        moment = Moment(step=1, total=9, generator=torch.Generator().manual_seed(seed))
        splats = model.splats(view, moment)
        return get_backend("reference").draw(view.camera, splats).colour, len(splats)

    some, drawn_of = image()
    rows = torch.arange(len(model.parameters))
    monkeypatch.setattr(model, "in_view", lambda camera, time, later: rows)
    everything, most = image()
    assert 0 < drawn_of < most
    torch.testing.assert_close(some, everything, atol=1e-6, rtol=0)
