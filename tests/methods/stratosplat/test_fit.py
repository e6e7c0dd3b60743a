"""Method stratosplat: off it is 3dgs, on it is continued and stored to the bit; its settings; bad input."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from helpers.aerial_scene import aerial_scene, without_points
from helpers.other_process import shown_elsewhere
from splatproof.base.errors import DataError, UsageError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.datasets.pose_noise import disturbed
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.registry import get_method
from splatproof.methods.stratosplat import fit as module
from splatproof.methods.stratosplat.cost import cost
from splatproof.methods.stratosplat.fit import fit
from splatproof.methods.stratosplat.settings import Completion, Planes, StratoSplat
from splatproof.methods.threedgs.fit import fit as fit_3dgs
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.reference.supervision.dense_initialisation import DenseSettings
from splatproof.reference.types.scene import Scene

DENSITY = Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=10_000)
SMALL = Planes(count=3, stride=3, finest=16)
SHORT = StratoSplat(
    iterations=40, sh_degree=1, density=DENSITY, planes=SMALL,
    completion=Completion(guidance_steps=3),
)  # fmt: skip
RUN = Run(threads=1, seed=3)


class Killed(Exception):
    """Stands for a kill between two steps."""


@dataclass
class Told:
    """What a run is told."""

    facts: dict[str, str] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)

    def run(self, folder: Path) -> Run:
        return replace(RUN, folder=folder, on_fact=self.facts.__setitem__, say=self.lines.append)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return aerial_scene().for_training()


@pytest.fixture(scope="module")
def trained(scene) -> DecodedModel:
    found = fit(scene, SHORT, RUN)
    assert isinstance(found, DecodedModel)
    return found


def state(model: DecodedModel | ExplicitModel) -> dict[str, Tensor]:
    if isinstance(model, ExplicitModel):
        return {name: getattr(model.model, name) for name in FIELDS}
    return model.model.parameters.state()


def same(first: DecodedModel | ExplicitModel, second: DecodedModel | ExplicitModel) -> bool:
    want, found = state(first), state(second)
    return want.keys() == found.keys() and all(torch.equal(want[n], found[n]) for n in want)


def test_with_everything_off_it_is_3dgs_to_the_bit(scene):
    off = replace(SHORT, init="sfm", planes=Planes(field="none"), dense_cell=0.0)
    plain = Settings(iterations=40, sh_degree=1, density=DENSITY)
    ours, theirs = fit(scene, off, RUN), fit_3dgs(scene, plain, RUN)
    assert isinstance(ours, ExplicitModel)
    assert same(ours, theirs)


def test_training_lowers_the_loss(scene):
    told: list[float] = []
    report = lambda step, total, values: told.append(values["loss"])
    fit(scene, replace(SHORT, iterations=150), replace(RUN, report=report))
    assert told[-1] < 0.5 * told[0]


@pytest.mark.parametrize("step", [17, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 39))])
def test_killed_and_continued_is_the_same_to_the_bit(scene, trained, tmp_path, step, monkeypatch):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    cut = replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(scene, SHORT, replace(cut, report=kill))
    # depths that are completed are not completed again
    monkeypatch.setattr(module, "completed", lambda *_, **__: pytest.fail("completed again"))
    assert same(trained, fit(scene, SHORT, cut))


def test_a_damaged_completion_is_made_again(scene, trained, tmp_path):
    kept = tmp_path / "checkpoint" / "completion.safetensors"
    kept.parent.mkdir()
    kept.write_bytes(b"cut short")
    assert same(trained, fit(scene, SHORT, replace(RUN, folder=tmp_path)))


def test_what_a_completion_said_is_said_again_where_it_is_kept(tmp_path, monkeypatch):
    scene = without_points(aerial_scene().for_training(), view=2)
    short = replace(SHORT, init="independent", dense=DenseSettings(matcher="own", partners=1))
    first, second = Told(), Told()
    start = module.started(scene, short, first.run(tmp_path))
    monkeypatch.setattr(module, "completed", lambda *_, **__: pytest.fail("completed again"))
    again = module.started(scene, short, second.run(tmp_path))
    assert torch.equal(start.positions, again.positions)
    assert first.facts.keys() == {"matcher", "points after completion"}
    assert any("left out of the completion" in line for line in first.lines)
    assert second == first


def test_a_completion_that_kept_nothing_of_what_it_said_is_made_again(scene, tmp_path):
    first, second = Told(), Told()
    start = module.started(scene, SHORT, first.run(tmp_path))
    kept = tmp_path / "checkpoint" / "completion.safetensors"
    tensors, held = read_tensors(kept)
    write_tensors(kept, tensors, {"key": held["key"]})
    again = module.started(scene, SHORT, second.run(tmp_path))
    assert torch.equal(start.positions, again.positions)
    assert second == first
    assert read_tensors(kept)[1] == held


def test_other_settings_do_not_continue(scene, tmp_path):
    run = replace(RUN, folder=tmp_path)
    fit(scene, replace(SHORT, iterations=2), run)
    with pytest.raises(UsageError, match="differs: settings.planes.bias true before, false now"):
        fit(scene, replace(SHORT, iterations=2, planes=replace(SMALL, bias=False)), run)


@pytest.mark.parametrize("field", ["neural", "table"])
def test_saved_and_rendered_in_another_process(scene, tmp_path, field):
    model = fit(scene, replace(SHORT, iterations=5, planes=replace(SMALL, field=field)), RUN)
    save_model(model, tmp_path / "model", Origin(method="stratosplat"))
    found = shown_elsewhere(tmp_path / "model", aerial_scene, 0)
    assert np.array_equal(found["colour"], model.render(aerial_scene().views[0]).colour)


def test_baked_at_a_view_it_looks_the_same_from_there(trained):
    view = aerial_scene().views[0]
    explicit = ExplicitModel(
        model=trained.bake(view), shift=trained.shift, units=trained.units, mode=trained.mode
    )
    # opacities pass through logits and colours through harmonics: rounding
    difference = explicit.render(view).colour - trained.render(view).colour
    assert float(difference.abs().max()) < 1e-3
    with pytest.raises(UsageError, match="name the one to bake it at"):
        trained.bake()


@pytest.mark.parametrize(
    "more",
    [
        {"init": "sfm"}, {"init": "dense"}, {"init": "independent"},
        {"planes": replace(SMALL, field="table")}, {"planes": replace(SMALL, bias=False)},
        {"planes": replace(SMALL, count=1)}, {"completion": Completion(guidance_steps=3, memory="accumulate")},
        {"exposure": "gain"}, {"antialiased": True},
    ],
    ids=str,
)  # fmt: skip
def test_every_setting_changes_the_model(scene, trained, more):
    short = replace(SHORT, iterations=3)
    assert not same(fit(scene, short, RUN), fit(scene, replace(short, **more), RUN))


@pytest.mark.parametrize("init", ["sfm", "dense", "layered"])
def test_no_more_points_to_start_from_than_asked_for(scene, init):
    free = replace(SHORT, init=init)
    assert len(module.started(scene, free, RUN).positions) > 20
    assert len(module.started(scene, replace(free, most_points=20), RUN).positions) <= 20


def test_points_that_are_matched_by_other_priors_do_not_continue(tmp_path):
    scene = aerial_scene(prior=True).for_training()
    facts = {"depth_prior": "oracle", "depth_prior_sha256": "a"}
    short = replace(
        SHORT, iterations=2, init="dense", planes=Planes(field="none"),
        dense=DenseSettings(matcher="prior"),
    )  # fmt: skip
    run = replace(RUN, folder=tmp_path)
    fit(replace(scene, facts=facts), short, run)
    with pytest.raises(UsageError, match="differs"):
        fit(replace(scene, facts=facts | {"depth_prior_sha256": "b"}), short, run)


def test_points_that_a_network_of_other_weights_matched_do_not_continue(tmp_path, monkeypatch):
    scene = aerial_scene().for_training()
    short = replace(
        SHORT, iterations=2, init="dense", planes=Planes(field="none"),
        dense=DenseSettings(matcher="own", partners=1),
    )  # fmt: skip
    run = replace(RUN, folder=tmp_path)
    fit(scene, short, run)
    fit(scene, short, run)
    monkeypatch.setattr(module, "weights_sha256", lambda dense: "others")
    with pytest.raises(UsageError, match="differs"):
        fit(scene, short, run)


def test_noise_of_all_stages_is_that_of_the_poses(scene):
    short = replace(SHORT, iterations=3)
    ours = fit(scene, replace(short, noise="L2"), RUN)
    given = fit(disturbed(scene, "L2", RUN.seed), short, RUN)
    assert same(ours, given)
    stages = [
        fit(scene, replace(short, noise="L2", noise_stage=s), RUN) for s in ("train", "completion")
    ]
    clean = fit(scene, short, RUN)
    assert not any(same(stage, other) for stage in stages for other in (ours, clean))


def test_noise_is_not_taken_twice(scene):
    with pytest.raises(UsageError, match="noise is 'L1', but the scene's poses have noise 'L2'"):
        fit(disturbed(scene, "L2", 0), replace(SHORT, noise="L1"), RUN)


def test_a_scene_without_points_is_refused(scene):
    with pytest.raises(
        DataError, match="shows a sparse point.*--points triangulated.*init = 'sfm'"
    ):
        fit(without_points(scene), SHORT, RUN)


def test_one_view_with_points_is_completed_alone(scene):
    one = replace(scene, train=(1,))
    assert len(state(fit(one, replace(SHORT, iterations=2), RUN))["rows.means"]) > 100


def test_two_identical_views_add_no_second_layer(scene):
    """What the second one shows is where the first one's depths are already, within a twentieth."""
    twice = replace(
        scene, views=(*scene.views, replace(scene.views[1], name="again.png")), train=(1, 4)
    )
    counts: list[int] = []
    run = replace(RUN, on_fact=lambda n, v: counts.append(int(v)) if "points" in n else None)
    short = replace(SHORT, iterations=1, completion=Completion(merge=0.05))
    for one in (replace(scene, train=(1,)), twice):
        fit(one, short, run)
    assert counts[1] < 1.3 * counts[0]


@pytest.mark.parametrize(
    ("name", "value"), [("count", 0), ("stride", 0), ("finest", 8), ("rate", -1.0)]
)
def test_settings_that_no_run_can_follow_are_refused(name, value):
    with pytest.raises(UsageError, match=f"planes.{name} is"):
        Planes(**{name: value})


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"noise": "L1", "init": "sfm"}, "noise_stage is 'completion', expected .* init is 'sfm'"),
        ({"completion": Completion(prior="own"), "init": "sfm"}, "completion.prior is 'own'"),
        ({"completion": Completion(prior="own"), "init": "dense"}, "completion.prior is 'own'"),
    ],
)
def test_settings_that_would_do_nothing_are_refused(more, said):
    with pytest.raises(UsageError, match=said):
        StratoSplat(noise_stage="completion", **more)


def test_points_that_are_matched_see_the_noise_of_completion(scene):
    """So with init = "dense" it does something, and with "sfm" it would not."""
    dense = replace(SHORT, init="dense")
    noisy = replace(dense, noise="L2", noise_stage="completion")
    plain, found = (module.started(scene, one, RUN).positions for one in (dense, noisy))
    assert plain.shape != found.shape or not torch.equal(plain, found)


def test_it_is_registered_and_says_what_it_costs(scene):
    method = get_method("stratosplat")
    few, many = (cost(replace(SHORT, iterations=n), scene) for n in (10, 1000))
    assert method.settings is StratoSplat
    assert many.cpu_seconds > few.cpu_seconds > 0
    assert cost(replace(SHORT, planes=Planes(field="none")), scene).memory_mb < few.memory_mb + 1
