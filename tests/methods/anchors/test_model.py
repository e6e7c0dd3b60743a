"""The anchor model: what it decodes, what it leaves out, and that gradients reach every tensor."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.methods.anchors.model import AnchorModel, restored
from splatproof.methods.anchors.start import voxel_size
from splatproof.methods.contracts.density_strategy import Frozen, Observation
from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.scaffold.fit import prepare
from splatproof.methods.scaffold.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.reference.anchors import scaffold
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import Scene, camera_view

SMALL = Settings(iterations=50, k=3, features=8)


def model(settings: Settings = SMALL, scene: Scene | None = None) -> AnchorModel:
    """Anchors whose features and offsets are no longer zero."""
    made, _ = prepare(scene or tiny_scene(), settings, Run(threads=1))
    generator = torch.Generator().manual_seed(1)
    for name in ("offsets", "features"):
        made.parameters.rows[name] = torch.randn(
            made.parameters.rows[name].shape, generator=generator
        )
    return made


def test_in_view_it_is_the_references_decode():
    made, view = model(), camera_view(camera(2))
    splats = made.splats(view, TRAINED)
    assert splats.decoded is not None
    assert len(splats.decoded) == len(made.parameters)  # the camera sees the whole cube
    decoder = scaffold.create_decoder(8, 3, torch.Generator().manual_seed(0))
    want = scaffold.decode(made.anchors(), decoder, view.camera.centre)
    assert splats.slots is not None
    assert want.slots is not None
    assert torch.equal(splats.slots, want.slots)
    assert splats.rows is not None
    assert torch.equal(splats.rows, splats.slots // 3)
    for name in ("means", "quaternions", "scales", "opacities", "colours"):
        torch.testing.assert_close(getattr(splats, name), getattr(want, name), rtol=1e-5, atol=2e-6)


def test_anchors_out_of_view_are_not_decoded_and_the_others_keep_their_slots():
    made = model()
    made.parameters.labels["centres"][::2, 2] -= 100  # behind the camera
    splats = made.splats(camera_view(camera(2)), TRAINED)
    odd = torch.arange(1, len(made.parameters), 2)
    assert splats.decoded is not None
    assert splats.rows is not None
    assert splats.slots is not None
    assert torch.equal(splats.decoded, odd)
    assert set(splats.rows.tolist()) <= set(odd.tolist())
    assert torch.equal(splats.slots // 3, splats.rows)
    rows = made.parameters.rows
    reach = rows["log_scales"][splats.rows, :3].exp()
    offsets = rows["offsets"].flatten(0, 1)[splats.slots]
    centres = made.parameters.labels["centres"][splats.rows]
    torch.testing.assert_close(splats.means, centres + offsets * reach)


def test_an_anchor_counts_as_seen_by_what_its_offsets_reach():
    made = model()
    view = camera_view(camera(2))
    made.parameters.labels["centres"][0] = torch.tensor([0.0, 0, 0]) + torch.tensor([0, 6.0, 0])
    assert 0 not in made.in_view(view.camera)
    made.parameters.rows["log_scales"][0, :3] = 1.0
    assert 0 in made.in_view(view.camera)


def test_what_the_rasterizer_shows_of_an_anchor_is_never_out_of_view():
    """Anchors as Gaussians of the offsets' scales within 3 standard deviations, by the projection."""
    generator = torch.Generator().manual_seed(0)
    made = model()
    count = len(made.parameters)
    for _ in range(20):
        centres = 6 * torch.randn(count, 3, generator=generator)
        made.parameters.labels["centres"] = centres
        made.parameters.rows["log_scales"] = torch.randn(count, 6, generator=generator) - 1
        around = torch.randn(count, 50, 3, generator=generator)
        around *= (
            3 * torch.rand(count, 50, 1, generator=generator) / around.norm(dim=2, keepdim=True)
        )
        reach = made.parameters.rows["log_scales"][:, None, :3].exp()
        points = (centres[:, None] + around * reach).flatten(0, 1)
        pixels, depths = project_points(camera(2), points)
        size = torch.tensor([24.0, 18.0])
        shown = (depths > 0.01) & ((pixels > 0) & (pixels < size)).all(dim=1)
        ahead = project_points(camera(2), centres)[1] > 0.01
        wanted = shown.reshape(count, 50).any(dim=1) & ahead
        found = made.in_view(camera(2))
        assert set(torch.where(wanted)[0].tolist()) <= set(found.tolist())
        assert len(found) < count


def test_nothing_in_view_is_an_empty_image_and_a_step_that_moves_nothing():
    scene = tiny_scene()
    made, plan = prepare(scene, SMALL, Run(threads=1))
    made.parameters.labels["centres"][:, 2] -= 100
    before = {name: value.clone() for name, value in made.parameters.rows.items()}
    trainer = Trainer(made, replace(plan, density=Frozen()), Run(threads=1))
    assert trainer.advance()["volume"] == 0
    assert all(torch.equal(made.parameters.rows[name], before[name]) for name in before)


@pytest.mark.parametrize("settings", [SMALL, replace(SMALL, distance=True, feature_bank=True)])
def test_kernels_and_reference_agree_on_the_gradients_of_a_step(settings):
    """Measured: at most 2.3e-5 of a tensor's largest gradient."""
    scene, found = tiny_scene(), []
    for backend in ("cpu", "reference"):
        made, run = model(settings, scene), Run(threads=1, backend=backend)
        _, plan = prepare(scene, settings, run)
        trainer = Trainer(made, plan, run)
        trainer.backward(scene.train_views[1])
        found.append({name: value.grad for name, value in made.parameters.trained.items()})
    native, reference = found
    assert len(native) == 3 + (16 if settings.feature_bank else 12)
    for name, gradient in native.items():
        assert gradient is not None, name
        assert gradient.abs().max() > 0, name
        torch.testing.assert_close(
            gradient, reference[name], rtol=0, atol=1e-4 * float(gradient.abs().max())
        )


def test_statistics_are_told_by_slot():
    scene = tiny_scene()
    made, plan = prepare(scene, SMALL, Run(threads=1))

    class Told(Frozen):
        needs = frozenset({"signed"})
        seen: Observation | None = None

        def watches(self, step: int) -> bool:
            return True

        def observe(self, seen: Observation) -> None:
            self.seen = seen

    told = Told()
    made.parameters.labels["centres"][:20, 2] -= 100
    Trainer(made, replace(plan, density=told), Run(threads=1)).advance()
    assert told.seen is not None
    assert told.seen.slots is not None
    assert told.seen.decoded is not None
    assert told.seen.decoded.tolist() == list(range(20, len(made.parameters)))
    assert told.seen.slots.min() >= 20 * 3
    assert len(told.seen.slots.unique()) == len(told.seen.slots) == len(told.seen.radii)


def test_the_bank_with_all_weight_on_the_last_is_the_features_themselves():
    made = model(replace(SMALL, feature_bank=True))
    plain = restored(made.facts(), {
        name: value for name, value in made.parameters.state().items()
        if not name.startswith("shared.bank")
    })  # fmt: skip
    view = camera_view(camera(2))
    different = made.splats(view, TRAINED), plain.splats(view, TRAINED)
    assert len(different[0]) != len(different[1]) or not torch.equal(
        different[0].opacities, different[1].opacities
    )
    made.parameters.shared["bank.bias1"] = torch.tensor([-1e4, -1e4, 1e4])
    same = made.splats(view, TRAINED)
    torch.testing.assert_close(same.opacities, different[1].opacities)


def test_the_bank_by_hand():
    features = torch.arange(8.0)[None]
    zero = scaffold.create_decoder(8, 3, torch.Generator(), extra=4).opacity
    even = replace(
        zero,
        weights=(torch.zeros(4, 2), torch.zeros(2, 3)),
        biases=(torch.zeros(2), torch.tensor([0.5, 0.25, 0.25]).log()),
    )
    found = scaffold.blend_bank(features, even, torch.zeros(1, 3), torch.zeros(1, 1))
    coarse = torch.tensor([0.0, 4] * 4)
    middle = torch.tensor([0.0, 2, 4, 6] * 2)
    torch.testing.assert_close(found[0], 0.5 * coarse + 0.25 * middle + 0.25 * features[0])


def test_parameters_come_back_from_their_state():
    made = model()
    again = Parameters.of(made.parameters.state())
    assert again.state().keys() == made.parameters.state().keys()
    assert all(torch.equal(v, again.state()[n]) for n, v in made.parameters.state().items())
    with pytest.raises(KeyError):
        Parameters.of({"nothing.x": torch.zeros(1)})


@pytest.mark.parametrize("factor", [0.01, 1.0, 100.0])
def test_a_voxel_by_distance_scales_with_the_scene_and_the_releases_does_not(factor):
    scene = tiny_scene()
    points = replace(scene.points, positions=factor * scene.points.positions)
    grown = replace(scene, points=points)
    one, other = (voxel_size(s, "distance", 16) for s in (scene, grown))
    assert other == pytest.approx(factor * one)
    one, other = (voxel_size(s, "squared", 16) for s in (scene, grown))
    assert other == pytest.approx(factor**2 * one)
