"""The trainer on models of other kinds: named terms, decoded splats, statistics by row, frozen parts."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.base.errors import SplatproofError
from splatproof.methods.contracts.density_strategy import Frozen, Observation
from splatproof.methods.contracts.model import TRAINED, Model, Moment
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.threedgs.fit import prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.loop import Trainer
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import Rates, settling
from splatproof.methods.training.terms import ImageTerm, Photometric, Term, mean_opacity
from splatproof.reference.types.scene import View, camera_view
from splatproof.reference.types.splats import Splats, activated

RUN = Run(threads=1)


class Pairs(Model):
    """Each row shows two splats, the second a step to the right; `shift` is shared by all rows."""

    def __init__(self) -> None:
        start = random_gaussians(30, degree=0)
        self.start = start
        rows = {"means": start.means, "colours": start.sh[:, 0] + 0.5}
        super().__init__(
            Parameters(
                rows, shared={"shift": torch.tensor([0.1])}, labels={"mark": torch.arange(30)}
            ),
            {"means": settling(1e-3), "shift": settling(1e-2)},
        )

    def splats(self, view: View, moment: Moment) -> Splats:
        rows, one = self.parameters.rows, activated(self.start)
        right = torch.tensor([1.0, 0, 0]) * self.parameters.shared["shift"]
        return Splats(
            means=torch.cat([rows["means"], rows["means"] + right]),
            quaternions=one.quaternions.repeat(2, 1), scales=one.scales.repeat(2, 1),
            opacities=one.opacities.repeat(2), colours=rows["colours"].repeat(2, 1),
            rows=torch.arange(30).repeat(2),
        )  # fmt: skip


class Watching(Frozen):
    """Keeps what it was told."""

    needs = frozenset({"signed", "absolute"})

    def __init__(self) -> None:
        self.told: list[Observation] = []

    def watches(self, step: int) -> bool:
        return True

    def observe(self, seen: Observation) -> None:
        self.told.append(seen)


def trainer(model: Model, *terms: ImageTerm, steps: int = 5, **more) -> Trainer:
    plan = Plan(
        steps=steps, views=tiny_scene().train_views, terms=terms or (Photometric(),),
        density=more.pop("density", Frozen()), key="test", **more,
    )  # fmt: skip
    return Trainer(model, plan, RUN)


def test_what_has_no_schedule_stays_and_shared_tensors_are_trained():
    model = Pairs()
    before = {name: value.clone() for name, value in model.parameters.state().items()}
    trainer(model, steps=20).train()
    after = model.parameters.state()
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert moved == {"rows.means", "shared.shift"}


def test_statistics_of_splats_are_summed_to_their_rows():
    density = Watching()
    of = trainer(Pairs(), density=density)
    of.advance()
    (seen,) = density.told
    assert (seen.count, len(seen.radii)) == (30, 60)
    assert seen.signed is not None
    assert seen.absolute is not None
    norm = seen.gradient_norm("signed")
    torch.testing.assert_close(seen.by_row(norm), norm[:30] + norm[30:])
    assert (seen.absolute >= seen.signed.abs() * (1 - 1e-5) - 1e-9).all()
    virtual = replace(seen, rows=torch.full((60,), -1))
    assert not virtual.by_row(norm).any()


@pytest.mark.parametrize("needs", [frozenset({"signed"}), frozenset()])
def test_absolute_gradients_are_told_only_where_asked_for_and_change_no_other(needs):
    every, few = Watching(), Watching()
    few.needs = needs
    after = []
    for density in (every, few):
        model = Pairs()
        trainer(model, density=density).advance()
        after.append(model.parameters.state())
    assert few.told[0].absolute is None
    one, other = few.told[0].signed, every.told[0].signed
    assert one is not None
    assert other is not None
    assert torch.equal(one, other)
    assert all(torch.equal(value, after[1][name]) for name, value in after[0].items())


def test_the_loss_is_the_weighted_sum_and_every_term_has_its_name():
    spread = Term(name="spread", loss=lambda frame: frame.splats.means.square().mean(), weight=0.5)
    told = trainer(Pairs(), Photometric(), spread).advance()
    assert told.keys() == {"loss", "photometric", "spread"}
    assert told["loss"] == pytest.approx(told["photometric"] + told["spread"], rel=1e-6)
    single = trainer(Pairs(), Photometric()).advance()
    assert told["photometric"] == pytest.approx(single["photometric"], rel=1e-6)


def test_two_terms_of_one_name_are_refused():
    with pytest.raises(ValueError, match="one name: photometric, photometric"):
        trainer(Pairs(), Photometric(), Photometric(dssim=0.5))


def test_a_term_of_the_parameters_is_told_beside_the_loss_on_both_paths():
    for native in (True, False):
        model, plan = prepare(tiny_scene(), Settings(iterations=5, opacity_weight=0.5), RUN)
        told = Trainer(model, replace(plan, native=native), RUN).advance()
        assert told["mean opacity"] == pytest.approx(0.5 * 0.1, rel=1e-5)
        assert told["loss"] == told["photometric"]


def test_the_term_of_mean_opacity_is_its_gradient():
    logits = torch.linspace(-2, 2, 7)
    parameters = Parameters({"opacity_logits": logits})
    parameters.rows["opacity_logits"].grad = torch.zeros(7)
    value = mean_opacity(0.3).add(parameters)
    wanted = logits.clone().requires_grad_()
    loss = 0.3 * wanted.sigmoid().mean()
    loss.backward()
    assert value == pytest.approx(float(loss.detach()))
    torch.testing.assert_close(parameters.rows["opacity_logits"].grad, wanted.grad)


def explicit(**more) -> GaussianModel:
    return GaussianModel(random_gaussians(20), Rates(), extent=1.0, **more)


def test_the_kernels_step_is_chosen_by_what_model_and_terms_are():
    class Moved(GaussianModel):
        def splats(self, view: View, moment: Moment) -> Splats:
            splats = super().splats(view, moment)
            return replace(splats, means=splats.means + 0.1)

    class Brighter(GaussianModel):
        def finish_image(self, view, output):
            return 2 * output.colour

    def made(kind: type[GaussianModel]) -> GaussianModel:
        return kind(random_gaussians(20), Rates(), extent=1.0)

    assert trainer(made(GaussianModel)).path == "kernels"
    assert trainer(made(Moved)).path == "autograd"
    assert trainer(made(Brighter)).path == "autograd"
    assert trainer(explicit(), native=False).path == "autograd"
    other = Term(name="other", loss=lambda frame: frame.image.mean())
    assert trainer(explicit(), Photometric(), other).path == "autograd"
    assert trainer(explicit(), Photometric(weight=0.5)).path == "autograd"
    assert trainer(Pairs()).path == "autograd"


def test_both_paths_tell_density_control_the_same():
    told = []
    for native in (True, False):
        density = Watching()
        of = trainer(explicit(), density=density, native=native)
        of.step = 1
        of.backward(of.plan.views[0])
        told.append(density.told or [of.backward(of.plan.views[0])[1]])
    (one,), (other,) = told
    for name in ("radii", "signed", "absolute"):
        mine, theirs = getattr(one, name), getattr(other, name)
        # float32 sums over pixels in another order: 2e-6 of the largest was seen
        torch.testing.assert_close(mine, theirs, rtol=1e-4, atol=1e-5 * float(theirs.abs().max()))


def test_a_model_sees_no_image_of_the_view_that_it_decodes():
    class Peeking(Pairs):
        def splats(self, view: View, moment: Moment) -> Splats:
            view.load()
            return super().splats(view, moment)

    with pytest.raises(SplatproofError, match="not for training"):
        trainer(Peeking()).advance()


def test_a_view_that_shows_nothing_teaches_nothing():
    away = random_gaussians(5)
    model = GaussianModel(replace(away, means=away.means - 100), Rates(), extent=1.0)
    before = {name: value.clone() for name, value in model.parameters.state().items()}
    trainer(model, steps=2, native=False).train()
    after = model.parameters.state()
    assert all(torch.equal(before[name], after[name]) for name in before)


def test_a_schedule_of_what_is_not_there_is_refused():
    with pytest.raises(ValueError, match="not trained: wings"):
        Model.__init__(Pairs(), Parameters({"means": torch.zeros(1, 3)}), {"wings": settling(1.0)})


def test_hidden_gaussians_and_growing_harmonics_are_for_training_alone():
    model = explicit(dropout=0.9, sh_every=100.0)
    view = camera_view(camera(0))
    whole = model.splats(view, TRAINED)
    generator = torch.Generator().manual_seed(0)
    part = model.splats(view, Moment(step=50, total=50, generator=generator))
    assert whole.sh is not None
    assert part.sh is not None
    assert (whole.sh.shape[1], part.sh.shape[1]) == (4, 1)
    assert int((part.opacities < 1e-6).sum()) > 10
    assert not bool((whole.opacities < 1e-6).any())


def test_a_key_of_another_plan_is_refused(tmp_path):
    def at(key: str) -> Trainer:
        plan = replace(trainer(Pairs()).plan, key=key)
        return Trainer(Pairs(), plan, replace(RUN, folder=tmp_path))

    first = at("one")
    first.train()
    again = at("one")
    again.resume()
    assert again.step == 5
    values: list[Tensor] = [t.model.parameters.rows["means"] for t in (first, again)]
    assert torch.equal(values[0].detach(), values[1].detach())
    with pytest.raises(SplatproofError, match="belongs to a run that differs: "):
        at("other").resume()
