"""The model of dlg-gs: whose light a view is shown in, and what its colours are made of."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.anchors.model import AnchorModel
from splatproof.methods.anchors.start import centres_of
from splatproof.methods.contracts.model import TRAINED, Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs.fit import prepare
from splatproof.methods.dlg_gs.light import factors, statistics
from splatproof.methods.dlg_gs.model import DlgModel, adapted_colours
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.reference.anchors import attention, hvi, lighting_appearance, scaffold
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.scene import Scene, View, camera_view

SMALL = Settings(iterations=50, k=3, features=8, vdjc="off", head=6, factor_width=4)


def model(settings: Settings = SMALL, scene: Scene | None = None) -> DlgModel:
    """Anchors whose features and offsets are no longer zero."""
    made, _ = prepare(scene or tiny_scene(), settings, Run(threads=1))
    generator = torch.Generator().manual_seed(1)
    for name in ("offsets", "features"):
        shape = made.parameters.rows[name].shape
        made.parameters.rows[name] = torch.randn(shape, generator=generator)
    assert isinstance(made, DlgModel)
    return made


def training(generator: int = 0) -> Moment:
    return Moment(step=1, total=2, generator=torch.Generator().manual_seed(generator))


def inside(made: DlgModel, view: View) -> torch.Tensor:
    """f_out by the reference, of every anchor: the camera sees the whole cube."""
    shared, lighting, centres = made.parameters.shared, made.lighting, centres_of(made.parameters)
    low, high = torch.tensor(lighting.low), torch.tensor(lighting.high)
    code = attention.fourier_code(attention.in_box(centres, low, high))
    direction, distance = scaffold.view_code(centres, view.camera.centre)
    inputs = torch.cat([code, direction, distance / lighting.extent], dim=1)
    names = ("anchor_kernel", "feature_kernel", "query", "key", "value")
    weights = attention.AttentionWeights(**{n: shared[f"attention.{n}"] for n in names})
    gated = attention.pooled_gates(inputs, weights)
    return attention.local_attention(gated, centres, lighting.radius, weights)


@pytest.mark.parametrize("vdjc", ["off", "mc"])
@pytest.mark.parametrize("radius", [0.0, 2.0, 9.0])
def test_its_two_colours_are_the_references(vdjc, radius):
    made = model(replace(SMALL, radius=radius, vdjc=vdjc))
    view = tiny_scene().views[2]
    splats = made.splats(view, training())
    original = AnchorModel.splats(made, view, TRAINED)
    assert original.colours is not None
    assert splats.colours is not None
    assert splats.rows is not None
    assert torch.equal(splats.colours[:, 3:], original.colours)
    shared = made.parameters.shared
    head = Mlp(
        weights=tuple(shared[f"head.weight{i}"] for i in range(3)),
        biases=tuple(shared[f"head.bias{i}"] for i in range(3)),
    )
    every = torch.stack([hvi.descriptor(each.load()) for each in tiny_scene().train_views])
    off = (every - every.mean(dim=0)) / every.std(dim=0, correction=0)
    factor = torch.tanh(off[1] @ shared["light.layer"])  # view 2 is the second that trains
    want = lighting_appearance.adapt_colours(
        head, original.colours, factor, inside(made, view)[splats.rows]
    )
    torch.testing.assert_close(splats.colours[:, :3], want, atol=1e-5, rtol=0)
    trained = made.splats(view, TRAINED).colours
    assert trained is not None
    assert torch.equal(trained, splats.colours[:, :3])


def test_colours_that_torch_adapts_are_the_references():
    """As where the kernels do not apply: in float64."""
    g = torch.Generator().manual_seed(3)
    draw = lambda *shape: torch.rand(*shape, generator=g, dtype=torch.float64)
    head = mlp.create((3 + 4 + 5, 6, 6, 4), g, torch.float64)
    colours, factor, attended = draw(9, 3), draw(4), draw(4, 5)
    owner = torch.tensor([0, 0, 0, 1, 2, 2, 3, 3, 3])
    torch.testing.assert_close(
        adapted_colours(head, colours, factor, attended, owner),
        lighting_appearance.adapt_colours(head, colours, factor, attended[owner]),
    )


def test_lists_follow_anchors_that_move():
    made = model(replace(SMALL, vdjc="mc", radius=1.0))
    view = tiny_scene().views[2]
    every = torch.arange(len(made.parameters))
    for step in (0.0, 0.01, 0.3, 0.3):
        shift = torch.randn(len(every), 3, generator=torch.Generator().manual_seed(7))
        made.parameters.rows["centres"].add_(step * shift)
        torch.testing.assert_close(made.attended(view.camera, every), inside(made, view))


def test_gates_are_attention_to_oneself():
    full, gates = model(replace(SMALL, radius=0.0)), model(replace(SMALL, dlaam="gates"))
    for name in gates.parameters.shared:
        gates.parameters.shared[name] = full.parameters.shared[name]
    view = camera_view(camera(2))
    ours, other = (m.splats(view, TRAINED).colours for m in (gates, full))
    torch.testing.assert_close(ours, other)
    assert "attention.query" not in gates.parameters.shared


def test_a_view_that_shows_nothing_is_empty():
    made = model()
    behind = camera(2)
    pose = behind.world_to_camera.clone()
    pose[:3, 3] = torch.tensor([0.0, 0, -50])
    splats = made.splats(camera_view(replace(behind, world_to_camera=pose)), training())
    assert splats.colours is not None
    assert splats.colours.shape == (0, 6)


def test_whose_light():
    scene, made = tiny_scene(), model()
    every = factors(made.parameters.shared)
    held_out, own = scene.views[0].without_truth(), scene.views[3].without_truth()
    assert torch.equal(made.factor(own), every[2])  # view 0 is held out
    assert torch.equal(made.factor(held_out), every.mean(dim=0))
    assert torch.equal(made.factor(held_out), made.neutral_code(held_out))
    assert torch.equal(made.factor(replace(held_out, appearance="5.png")), every[4])
    assert torch.equal(made.factor(replace(own, appearance="5.png")), every[4])
    code = torch.linspace(-1, 1, 4)
    assert torch.equal(made.factor(replace(own, appearance=code)), code)


@pytest.mark.parametrize(
    ("appearance", "told"),
    [("0.png", "appearance '0.png' is not the name"), (torch.zeros(3), r"shape \(3,\), expected")],
)
def test_light_that_is_none_is_refused(appearance, told):
    with pytest.raises(UsageError, match=told):
        model().factor(replace(tiny_scene().views[0], appearance=appearance))


def test_no_other_photos_than_those_of_training_views_are_read():
    scene = tiny_scene()
    blind = replace(scene, views=(scene.views[0].without_truth(), *scene.views[1:]))
    made = model(scene=blind)
    assert made.lighting.views == ("1.png", "2.png", "3.png", "4.png", "5.png")
    made.splats(blind.views[0], TRAINED)


def test_masked_pixels_say_nothing_of_the_light():
    mask = torch.zeros(18, 24, dtype=torch.bool)
    mask[:9] = True
    view = tiny_scene(mask=mask).views[1]
    painted = view.load()
    painted[9:] = 1.0
    other = replace(view, load=painted.clone)
    assert torch.equal(statistics(view, "hvi"), statistics(other, "hvi"))
    assert not torch.equal(statistics(view, "hvi"), statistics(view, "rgb"))
    nothing = replace(view, load_mask=torch.zeros_like(mask).clone)
    assert not statistics(nothing, "hvi").any()


@pytest.mark.parametrize("factor", ["hvi", "rgb", "learnt"])
def test_light_is_learnt_through_the_layer_or_the_embedding(factor):
    made = model(replace(SMALL, factor=factor))
    names = {name for name in made.parameters.shared if name.startswith("light.")}
    trained = names & made.schedules.keys()
    assert trained == ({"light.embedding"} if factor == "learnt" else {"light.layer"})
    for name in made.schedules:
        made.parameters.trained[name].requires_grad_()
    view = tiny_scene().views[2]
    colours = made.splats(view, training()).colours
    assert colours is not None
    colours[:, :3].square().sum().backward()
    for name in made.schedules:
        if name.startswith(("light.", "head.", "attention.")):
            gradient = made.parameters.trained[name].grad
            assert gradient is not None, name
            assert gradient.any(), name
