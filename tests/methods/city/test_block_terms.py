"""What blocks minimise beside their photos: weights as they are told, priors in the scene's scale, runs that go on."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from helpers.city_scene import small_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.city.block_terms import (
    NO_TERMS,
    BlockTerms,
    block_terms,
    depth_share,
    sideways_share,
    with_appearance,
    with_scaled_priors,
)
from splatproof.methods.city.jobs import block_jobs
from splatproof.methods.city.partition import PartitionSettings, partition
from splatproof.methods.city.train_block import BlockJob, prepare, train_block
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import TRAINED, Model, Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.decoupled import DecoupledModel, appearance_loss
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.registry import METHODS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.terms import Frame, Photometric, mean_volume
from splatproof.reference.supervision.decoupled_appearance import decoupled_loss
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.scene import DepthPrior, Scene, View

RUN = Run(backend="cpu", threads=1, checkpoint_seconds=0.0)
STEPS = 40
SHORT = Settings(iterations=STEPS, sh_degree=1, density=Density(start=0, interval=10, least_interval=10,
                 stop=15_000, reset_interval=0, gradient=1e-6, largest_size=10.0))  # fmt: skip
STILL = replace(SHORT.density, gradient=1.0)
"""Nothing pulls so hard that it is split: for runs whose length is what counts."""
ALL = BlockTerms(depth=1.0, sideways=0.5, volume=0.01, appearance=True)


def leaning(view: View) -> DepthPrior:
    """A prior that says that all lies on a plane, some four units away, nearer on the right."""
    size = (view.camera.height, view.camera.width)
    ramp = torch.linspace(0.2, 0.3, size[1]).expand(size)
    return DepthPrior(disparity=ramp, valid=torch.ones(size, dtype=torch.bool))


def told(scene: Scene, make: Callable[[View], DepthPrior]) -> Scene:
    views = tuple(replace(view, load_prior=partial(make, view)) for view in scene.views)
    return replace(scene, views=views, facts=dict(scene.facts) | {"depth_prior_sha256": "of test"})


def with_priors() -> Scene:
    return told(small_scene(60), leaning)


def job_of(folder: Path, scene: Scene, terms: BlockTerms) -> BlockJob:
    found = partition(scene, 2, PartitionSettings(margin=0.1))
    return block_jobs(scene, found, SHORT, RUN, folder, terms=terms)[0]


def test_weights_run_from_the_first_step_to_the_last_as_told():
    steps = [Moment(step=step, total=8000) for step in (1, 1000, 1001, 4500, 8000)]
    assert [depth_share(one) for one in steps] == pytest.approx(
        [1, 10**-0.125, 10**-0.125, 10**-0.5625, 0.1], rel=1e-3
    )
    assert [sideways_share(one) for one in steps] == pytest.approx(
        [0, 0, 0.02, 0.02**0.5, 1], rel=1e-3
    )


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (BlockTerms(depth=0.5), "inverse depth"),
        (BlockTerms(sideways=0.5), "sideways view"),
        (BlockTerms(volume=0.5), "mean volume"),
    ],
)
def test_only_what_is_asked_for_is_minimised(settings, name):
    assert block_terms(NO_TERMS, RUN, 1.0) == ()
    assert [one.name for one in block_terms(settings, RUN, 1.0)] == [name]


@pytest.mark.parametrize("name", ["depth", "sideways", "volume"])
@pytest.mark.parametrize("value", [-1.0, float("inf"), float("nan")])
def test_weights_that_no_run_has_are_refused(name, value):
    with pytest.raises(UsageError, match=f"block_terms.{name}"):
        BlockTerms(**{name: value})


def test_the_term_of_mean_volume_is_its_gradient():
    rows = Parameters({"log_scales": torch.linspace(-2, 1, 9).reshape(3, 3)})
    rows.rows["log_scales"].grad = torch.zeros(3, 3)
    value = mean_volume(0.3, 2.0).add(rows)
    wanted = rows.rows["log_scales"].clone().requires_grad_()
    loss = 0.3 * wanted.exp().prod(dim=1).mean() / 8
    loss.backward()
    assert value == pytest.approx(float(loss.detach()))
    assert_close(rows.rows["log_scales"].grad, wanted.grad)


def painted(view: View, scene: Scene, scale: float, zero: float) -> DepthPrior:
    """The inverse depths of all points at their pixels, in a scale and from a zero of their own."""
    at, z = project_points(view.camera, scene.points.positions)
    column, row = at.floor().long().T
    size = (view.camera.height, view.camera.width)
    inside = (column >= 0) & (column < size[1]) & (row >= 0) & (row < size[0])
    valid = torch.zeros(size, dtype=torch.bool)
    disparity = torch.zeros(size)
    valid[row[inside], column[inside]] = True
    disparity[row[inside], column[inside]] = (1 / z[inside].float() - zero) / scale
    return DepthPrior(disparity=disparity, valid=valid)


def test_priors_take_the_scale_of_the_points_that_their_view_sees():
    scene = small_scene(60)
    asked = told(scene, lambda view: painted(view, scene, 3.0, -0.4))
    views = with_scaled_priors(asked).train_views
    determined = 0
    for view in views:
        assert view.load_prior is not None
        prior = view.load_prior()
        want = painted(view, scene, 1.0, 0.0)
        if bool(prior.valid.any()):
            determined += 1
            assert_close(
                prior.disparity[prior.valid], want.disparity[prior.valid], atol=1e-3, rtol=0
            )
    assert determined >= len(views) // 2


@pytest.mark.parametrize("scale", [-3.0, float("inf")], ids=["turned round", "the same everywhere"])
def test_priors_that_the_points_do_not_determine_say_nothing(scale):
    scene = small_scene(60)
    asked = told(scene, lambda view: painted(view, scene, scale, 0.0))
    for view in with_scaled_priors(asked).train_views:
        assert view.load_prior is not None
        assert not bool(view.load_prior().valid.any())


def test_without_a_prior_the_error_says_what_to_do():
    with pytest.raises(
        DataError, match=r"no training view has a depth prior.*block_terms.depth = 0"
    ):
        with_scaled_priors(small_scene(60))
    method = METHODS["blockgaussian"]
    short = method.settings(iterations=5, blocks=2, block_terms=BlockTerms(depth=1.0))
    with pytest.raises(DataError, match="no training view has a depth prior"):
        method.fit(small_scene(60), short, RUN)


def test_what_a_block_minimises_and_its_priors_are_part_of_its_key(tmp_path):
    scene = with_priors()
    keys = [
        job_of(tmp_path, scene, terms).key for terms in (NO_TERMS, ALL, replace(ALL, volume=0.0))
    ]
    others = replace(scene, facts=dict(scene.facts) | {"depth_prior_sha256": "of others"})
    keys.append(job_of(tmp_path, others, ALL).key)
    assert len(set(keys)) == 4
    assert job_of(tmp_path, others, NO_TERMS).key == keys[0]


def inverse_depths(job: BlockJob, terms: BlockTerms) -> Tensor:
    """Mean distance of rendered inverse depth from the prior, after training."""
    model, plan = prepare(replace(job, block_terms=terms), None, RUN)
    Trainer(model, plan, RUN).train()
    off = []
    for view in plan.views:
        output = get_backend("cpu").draw(view.camera, model.splats(view, TRAINED))
        assert view.load_prior is not None
        shown = output.alpha > 0.5
        off.append((1 / output.depth[shown] - view.load_prior().disparity[shown]).abs())
    return torch.cat(off).mean().detach()


def test_depth_is_drawn_to_its_prior(tmp_path):
    job = job_of(tmp_path, with_priors(), NO_TERMS)
    job = replace(job, settings=replace(SHORT, iterations=200, density=STILL))
    free = inverse_depths(job, NO_TERMS)
    assert inverse_depths(job, BlockTerms(depth=50.0)) < 0.95 * free


def test_the_sideways_term_shrinks_what_it_measures(tmp_path):
    job = job_of(tmp_path, with_priors(), NO_TERMS)
    ends = {}
    for weight in (1e-9, 5.0):
        values: list[float] = []
        given = replace(job, block_terms=BlockTerms(sideways=weight), folder=tmp_path / str(weight))
        train_block(given, lambda step, total, told, to=values: to.append(told["sideways view"]))
        assert values[0] >= 0
        ends[weight] = values[-1] / weight
    assert 0 < ends[5.0] < ends[1e-9]


STEPS_OF_LIGHT = [0.5 + 0.1 * i for i in range(9)]


def in_other_light(factors: Sequence[float] = STEPS_OF_LIGHT) -> Scene:
    """The small scene, each of whose photos is darker or brighter by another factor."""
    scene = small_scene(60)
    lit = tuple(
        replace(view, load=partial(times, view.load, factor))
        for factor, view in zip(factors, scene.views, strict=True)
    )
    return replace(scene, views=lit)


def times(load: Callable[[], Tensor], factor: float) -> Tensor:
    return (load() * factor).clamp(0, 1)


def test_appearance_takes_up_what_photos_did_to_the_colours(tmp_path):
    ends = {}
    for appearance in (False, True):
        scene = in_other_light([1.0, 0.3] * 4 + [1.0])
        job = job_of(tmp_path, scene, BlockTerms(appearance=appearance))
        job = replace(job, settings=replace(SHORT, iterations=200, density=STILL))
        values: list[float] = []
        train_block(job, lambda step, total, told, to=values: to.append(told["photometric"]))
        ends[appearance] = sum(values[-10:])
        assert set(vars(loaded(job).model)) == set(FIELDS)
    assert ends[True] < 0.9 * ends[False]  # 0.72 to 0.76 with three seeds


def test_appearance_begins_as_no_appearance(tmp_path):
    job = job_of(tmp_path, in_other_light(), NO_TERMS)
    first = []
    for appearance in (False, True):
        model, plan = prepare(job, None, RUN)
        shown: Model = model
        if appearance:
            shown, plan = with_appearance(model, plan, 0)
        first.append(Trainer(shown, plan, RUN).advance())
    assert first[0]["loss"] == pytest.approx(first[1]["loss"], rel=1e-5)


def test_the_term_of_appearance_is_the_references(tmp_path):
    job = job_of(tmp_path, in_other_light(), NO_TERMS)
    shown, plan = with_appearance(*prepare(job, None, RUN), 0)
    assert isinstance(shown, DecoupledModel)
    shown.parameters.shared["appearance.last.weight"].data.normal_(
        generator=torch.Generator().manual_seed(1)
    )
    view, moment = plan.views[1], Moment(step=1, total=1)
    splats = shown.splats(view, moment)
    output = get_backend("cpu").draw(view.camera, splats)
    mask = torch.rand(18, 24, generator=torch.Generator().manual_seed(2)) > 0.3
    frame = Frame(
        view=view, moment=moment, splats=splats, output=output, image=output.colour,
        truth=view.load(), mask=mask, model=shown,
    )  # fmt: skip
    factors = shown.factors(view, output.colour)
    assert float(factors.std()) > 0.01
    wanted = decoupled_loss(output.colour, factors, view.load(), dssim=0.3, mask=mask)
    assert_close(appearance_loss(Photometric(dssim=0.3)).loss(frame), wanted, atol=1e-6, rtol=1e-5)


def test_a_view_that_is_no_photo_keeps_its_colours(tmp_path):
    job = job_of(tmp_path, in_other_light(), NO_TERMS)
    model, plan = prepare(job, None, RUN)
    shown, _ = with_appearance(model, plan, 0)
    assert isinstance(shown, DecoupledModel)
    shown.parameters.shared["appearance.last.bias"].data.fill_(1.0)
    image = torch.full((18, 24, 3), 0.5)
    assert bool((shown.factors(plan.views[0], image) > 1).all())
    other = replace(plan.views[0], name="side view")
    assert torch.equal(shown.factors(other, image), torch.ones_like(image))


def test_a_block_of_one_photo_has_no_appearance_to_learn(tmp_path):
    job = job_of(tmp_path, in_other_light(), BlockTerms(appearance=True))
    alone = replace(job, scene=replace(job.scene, views=job.scene.views[:1], train=(0,)))
    assert train_block(alone, lambda *_: None).primitives > 0


def test_two_ways_to_learn_appearance_are_refused():
    with pytest.raises(UsageError, match="exposure"):
        METHODS["vastgaussian"].settings(exposure="gain", block_terms=BlockTerms(appearance=True))


def loaded(job: BlockJob) -> ExplicitModel:
    model = load_reconstruction(job.model, backend="cpu")
    assert isinstance(model, ExplicitModel)
    return model


class Killed(Exception):
    """Stands for a kill between two steps."""


def test_a_block_with_all_terms_goes_on_after_a_kill_to_the_bit(tmp_path):
    scene = with_priors()
    straight, killed = (job_of(tmp_path / name, scene, ALL) for name in ("straight", "killed"))
    train_block(straight, lambda *_: None)

    def kill(now: int, *_: object) -> None:
        if now == 20:
            raise Killed

    with pytest.raises(Killed):
        train_block(killed, kill)
    train_block(killed, lambda *_: None)
    one, other = loaded(straight), loaded(killed)
    assert torch.equal(one.model.means, other.model.means)
    assert torch.equal(one.model.sh, other.model.sh)


def test_a_city_takes_its_terms_from_the_settings(tmp_path):
    method = METHODS["blockgaussian"]
    found = []
    for terms in (NO_TERMS, ALL):
        short = method.settings(iterations=8, sh_degree=1, blocks=2, block_terms=terms)
        at = replace(RUN, folder=tmp_path / str(len(found)), engine="inline")
        model = method.fit(with_priors(), short, at)
        assert isinstance(model, ExplicitModel)
        found.append(model.model.means)
    assert found[0].shape != found[1].shape or not torch.equal(*found)
