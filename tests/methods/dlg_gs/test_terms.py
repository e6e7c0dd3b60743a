"""The terms of dlg-gs against the paper's equations, and where their gradients reach."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import camera, tiny_scene
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import Moment
from splatproof.methods.contracts.run import Run
from splatproof.methods.dlg_gs.fit import prepare
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.methods.dlg_gs.terms import adapted_image, terms
from splatproof.methods.priors.oracle import prior_of
from splatproof.methods.training.terms import Frame, Term
from splatproof.reference.anchors import lighting_appearance
from splatproof.reference.supervision import depth_constraint, losses
from splatproof.reference.supervision.depth_constraint import Depth
from splatproof.reference.types.scene import DepthPrior, Scene
from splatproof.reference.types.splats import Splats

SMALL = Settings(iterations=50, k=3, features=8, head=6, factor_width=4)
BACKGROUND = (0.2, 0.4, 0.6)
RUN = Run(threads=1, background=BACKGROUND)


def with_priors(scene: Scene) -> Scene:
    """The scene with a disparity, of its own scale, and an unknown corner for each training view."""

    def told() -> DepthPrior:
        steps = torch.arange(18 * 24).reshape(18, 24) / 100
        valid = torch.ones(18, 24, dtype=torch.bool)
        valid[:4, :5] = False
        return DepthPrior(disparity=3 + steps.where(valid, torch.nan), valid=valid)

    views = tuple(
        replace(view, load_prior=told) if i in scene.train else view
        for i, view in enumerate(scene.views)
    )
    return replace(scene, views=views)


class Made:
    """A frame of view 2 with gradients, and the terms of settings."""

    def __init__(self, settings: Settings, mask: Tensor | None = None) -> None:
        scene = with_priors(tiny_scene())
        self.model, _ = prepare(scene, settings, RUN)
        generator = torch.Generator().manual_seed(1)
        for name, value in self.model.parameters.rows.items():
            if name in ("offsets", "features"):
                self.model.parameters.rows[name] = torch.randn(value.shape, generator=generator)
        for name, value in self.model.parameters.trained.items():
            value.requires_grad_(name in self.model.schedules)
        view = scene.views[2]
        moment = Moment(step=1, total=2, generator=torch.Generator().manual_seed(5))
        splats = self.model.splats(view, moment)
        background = torch.tensor(BACKGROUND)
        output = get_backend("cpu").draw(view.camera, splats, background=background)
        self.frame = Frame(
            view=view, moment=moment, splats=splats, output=output, truth=view.load(), mask=mask,
            image=self.model.finish_image(view, output), model=self.model,
        )  # fmt: skip
        self.terms = {term.name: term for term in terms(settings, RUN)}

    def loss(self, name: str) -> Tensor:
        return self.terms[name].loss(self.frame)

    def reached(self, name: str) -> set[str]:
        """Names of the tensors that a term's gradient reaches."""
        self.loss(name).backward()
        trained = self.model.parameters.trained
        return {n for n, v in trained.items() if v.grad is not None and bool(v.grad.any())}


def test_all_terms_by_name_and_weight():
    found = {name: term.weight for name, term in Made(SMALL).terms.items()}
    assert found == {
        "adapted l1": 0.8, "original dssim": 0.2, "gaussian depth": 0.01, "anchor depth": 0.01,
        "volume": 0.001, "dropout": 0.1,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("chosen", "gone"),
    [
        ({"vdjc": "off"}, {"gaussian depth", "anchor depth"}),
        ({"vdjc": "ec"}, {"anchor depth"}),
        ({"vdjc": "mc"}, {"gaussian depth"}),
        ({"dropout": 0.0}, {"dropout"}),
        ({"volume": 0.0}, {"volume"}),
        ({"ec": 0.0, "mc": 0.0}, {"gaussian depth", "anchor depth"}),
    ],
)
def test_what_is_off_is_no_term(chosen, gone):
    every, left = (Made(each).terms.keys() for each in (SMALL, replace(SMALL, **chosen)))
    assert every - left == gone


@pytest.mark.parametrize("masked", [False, True])
def test_colours_by_the_paper(masked):
    mask = torch.arange(18 * 24).reshape(18, 24) % 7 > 0 if masked else None
    made = Made(SMALL, mask)
    adapted, original = made.frame.output.colour.split(3, dim=-1)
    found = 0.8 * made.loss("adapted l1") + 0.2 * made.loss("original dssim")
    truth = made.frame.truth
    l1 = losses.photometric(adapted, truth, dssim=0.0, mask=mask)
    want = 0.8 * l1 + 0.2 * losses.photometric(original, truth, dssim=1.0, mask=mask)
    torch.testing.assert_close(found, want, atol=1e-6, rtol=1e-5)
    if not masked:
        paper = lighting_appearance.colour_loss(adapted, original, truth)
        torch.testing.assert_close(found, paper, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("kind", ["distance", "z"])
@pytest.mark.parametrize("weighted", [True, False])
def test_depths_by_the_paper(weighted, kind):
    made = Made(replace(SMALL, weight_map=weighted, depth=kind))
    frame, splats = made.frame, made.frame.splats
    assert frame.view.load_prior is not None
    assert splats.rows is not None
    prior = frame.view.load_prior()
    adapted, original = frame.output.colour.split(3, dim=-1)
    weight = depth_constraint.appearance_weight(adapted, original)
    assert 0.02 < float((1 - weight).max())
    shape = (frame.view.camera, splats.means, splats.quaternions, splats.scales)
    anchors = made.model.parameters.rows["centres"][splats.rows]
    want = depth_constraint.depth_loss(
        depth_constraint.gaussian_disparity(*shape, splats.opacities, depth=kind),
        depth_constraint.anchor_disparity(frame.view.camera, anchors, *shape[1:], depth=kind),
        prior.disparity, prior.valid, weight if weighted else torch.ones_like(weight),
        depth_constraint.DepthWeights(),
    )  # fmt: skip
    found = 0.01 * made.loss("gaussian depth") + 0.01 * made.loss("anchor depth")
    torch.testing.assert_close(found, want, atol=1e-7, rtol=1e-4)


@pytest.mark.parametrize("name", ["gaussian depth", "anchor depth"])
def test_depth_terms_fade_log_linearly_to_their_share_at_the_end(name):
    constant, fading = (Made(replace(SMALL, depth_final=share)) for share in (1.0, 0.04))
    for step, share in [(0, 1.0), (25, 0.2), (50, 0.04)]:
        for made in (constant, fading):
            made.frame = replace(made.frame, moment=replace(made.frame.moment, step=step, total=50))
        whole, left = constant.loss(name), fading.loss(name)
        torch.testing.assert_close(left, share * whole, rtol=1e-5, atol=0)
        assert whole == Made(SMALL).loss(name)


def test_true_geometry_has_no_error_against_the_oracle_by_z_alone():
    """Dots on the true depth of a wide view, and true depth as the prior of the pixels that have one."""
    where = replace(camera(2), K=torch.tensor([[9.0, 0, 12], [0, 9, 9], [0, 0, 1]]).double())
    row, column = torch.meshgrid(torch.arange(18) + 0.5, torch.arange(24) + 0.5, indexing="ij")
    ray = torch.stack([(column - 12) / 9, (row - 9) / 9, torch.ones(18, 24)], dim=-1)
    depth = 2 + 0.4 * ray[..., 0]
    seen = torch.zeros(18, 24, dtype=torch.bool)
    seen[2::4, 2::4] = True  # a dot's footprint ends before the next
    inside = (ray * depth[..., None])[seen].double() - where.translation
    means = (inside @ where.rotation).float()
    splats = Splats(
        means=means, quaternions=torch.ones(len(means), 4), scales=torch.full_like(means, 1e-5),
        opacities=torch.full((len(means),), 0.9), colours=torch.ones(len(means), 3),
    )  # fmt: skip
    prior = prior_of(depth.where(seen, torch.nan))

    def error(kind: Depth) -> float:
        frame = Made(SMALL).frame
        view = replace(frame.view, camera=where, load_prior=lambda: prior)
        frame = replace(
            frame, view=view, splats=splats, output=get_backend("cpu").draw(where, splats)
        )
        term = terms(replace(SMALL, depth=kind, weight_map=False), RUN)[2]
        assert isinstance(term, Term)
        return float(term.loss(frame)) / float(seen.float().mean())

    assert error("z") < 1e-5
    assert error("distance") > 0.02


def test_masked_pixels_have_no_depth():
    half = torch.zeros(18, 24, dtype=torch.bool)
    half[:, :12] = True
    made = Made(replace(SMALL, weight_map=False), half)
    assert made.frame.view.load_prior is not None
    prior = made.frame.view.load_prior()
    left = replace(prior, valid=prior.valid & half)
    whole = Made(replace(SMALL, weight_map=False))
    whole.frame = replace(whole.frame, view=replace(whole.frame.view, load_prior=lambda: left))
    assert torch.equal(made.loss("anchor depth"), whole.loss("anchor depth"))


def test_where_gradients_reach():
    """No light through the weights of depth; the anchors' depth moves nothing but anchors."""
    assert Made(SMALL).reached("anchor depth") == {"centres"}
    decoding = {"offsets", "features", "log_scales", "centres"}
    reached = Made(SMALL).reached("gaussian depth")
    assert reached >= decoding
    assert not {name for name in reached if name.startswith(("light", "head", "attention", "col"))}
    assert not {n for n in Made(SMALL).reached("original dssim") if n.startswith(("head", "light"))}
    assert "head.weight2" in Made(SMALL).reached("adapted l1")
    assert {n for n in Made(SMALL).reached("volume") if n.startswith("shape")}


def test_terms_together_leave_the_gradient_of_each_by_itself():
    """Two terms share a split, and dropout takes its colours before they are joined."""
    names = ["adapted l1", "original dssim", "dropout"]
    joint = Made(SMALL)
    torch.stack([joint.loss(name) for name in names]).sum().backward()
    apart = [Made(SMALL) for _ in names]
    for made, name in zip(apart, names, strict=True):
        made.loss(name).backward()
    for name, value in joint.model.parameters.trained.items():
        found = [made.model.parameters.trained[name].grad for made in apart]
        each = [gradient for gradient in found if gradient is not None]
        if value.grad is not None:
            torch.testing.assert_close(value.grad, torch.stack(each).sum(0), atol=1e-6, rtol=1e-4)


def test_the_adapted_image_is_the_frames():
    made = Made(SMALL)
    assert torch.equal(adapted_image(made.frame), made.frame.image)
    assert made.loss("dropout") > 0
    off = Made(replace(SMALL, dlaam="off"))
    assert torch.equal(adapted_image(off.frame), off.frame.image)
    assert off.loss("dropout") > 0


def test_volume_is_the_sum_or_the_mean():
    made = Made(SMALL)
    volumes = made.frame.splats.scales.prod(dim=1)
    torch.testing.assert_close(made.loss("volume"), volumes.mean())
    torch.testing.assert_close(
        Made(replace(SMALL, volume_rule="sum")).loss("volume"), volumes.sum()
    )


def test_dropout_by_the_paper_and_no_gradient_through_the_full_render():
    made = Made(replace(SMALL, dropout_share=0.4))
    splats = made.frame.splats
    generator = torch.Generator().manual_seed(5)
    shown = lighting_appearance.dropout_mask(len(splats), 0.4, generator)
    assert splats.colours is not None
    left = Splats(
        means=splats.means[shown], quaternions=splats.quaternions[shown],
        scales=splats.scales[shown], opacities=splats.opacities[shown],
        colours=splats.colours[shown, :3],
    )  # fmt: skip
    output = get_backend("cpu").draw(
        made.frame.view.camera, left, background=torch.tensor(BACKGROUND)
    )
    want = lighting_appearance.dropout_loss(output.colour, made.frame.image)
    torch.testing.assert_close(made.loss("dropout"), want, atol=1e-6, rtol=1e-5)
    names = ["features", "offsets"]
    rows = [made.model.parameters.rows[name] for name in names]
    assert made.frame.moment.generator is not None
    made.frame.moment.generator.manual_seed(5)
    for found, other in zip(
        torch.autograd.grad(made.loss("dropout"), rows, retain_graph=True),
        torch.autograd.grad(want, rows),
        strict=True,
    ):
        torch.testing.assert_close(found, other, atol=1e-5, rtol=1e-3)
