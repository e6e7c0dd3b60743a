"""Plans whose model is another method's: runs by them are like any other run of auto."""

from dataclasses import dataclass, fields, replace
from functools import cache

import pytest
import torch

from helpers.aerial_scene import aerial_scene
from helpers.tiny_drive import tiny_drive
from splatproof.methods.auto import fit as fitting
from splatproof.methods.auto.base import STRIDE, STRIDE_PIXELS, completed, started
from splatproof.methods.auto.fit import fit
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.reconstruction import Origin, Reconstruction, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.types.scene import Scene

SHORT = AutoSettings(seconds=20.0, steps=30, probe_share=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Planned:
    """A scene, and what of its plan is fixed."""

    scene: Scene
    asked: AutoSettings
    kind: str
    fact: tuple[str, str]
    """Name of the choice, and what is told of it."""
    other: AutoSettings
    """As `asked`, with that choice the other way round."""


BASES = {
    "pvg": Planned(
        scene=tiny_drive(), asked=replace(SHORT, motion=True), kind="pvg",
        fact=("motion", "Gaussians that move (as method pvg's) (given)"),
        other=replace(SHORT, motion=False),
    ),
    "stratosplat": Planned(
        scene=aerial_scene().for_training(), asked=replace(SHORT, completed=True), kind="stratosplat",
        fact=(
            "completed depths", "of each photo, and virtual Gaussians (as method stratosplat's) (given)",
        ),
        other=replace(SHORT, completed=False),
    ),
}  # fmt: skip


@pytest.fixture(params=BASES)
def planned(request) -> Planned:
    return BASES[request.param]


def renders(model: Reconstruction, scene: Scene) -> list[torch.Tensor]:
    return [model.render(view.without_truth()).colour for view in scene.views]


def same(one: Reconstruction, other: Reconstruction, scene: Scene) -> bool:
    return all(map(torch.equal, renders(one, scene), renders(other, scene)))


@cache
def undisturbed(base: str) -> tuple[Reconstruction, dict[str, str]]:
    """The model of a run of one of `BASES`, and what was told."""
    told: dict[str, str] = {}
    at = Run(threads=1, on_fact=told.__setitem__)
    return fit(BASES[base].scene, BASES[base].asked, at), told


def test_the_same_plan_gives_the_same_model_which_is_saved_and_loaded(planned, tmp_path):
    one, told = undisturbed(planned.kind)
    assert one.kind == planned.kind
    name, value = planned.fact
    assert told[f"plan: {name}"] == value
    assert same(one, fit(planned.scene, planned.asked, Run(threads=1)), planned.scene)
    save_model(one, tmp_path / "model", Origin(method="auto"))
    assert same(one, load_reconstruction(tmp_path / "model"), planned.scene)
    assert fit(planned.scene, planned.other, Run(threads=1)).kind == "explicit"


class Killed(Exception):
    """Stands for a kill between two steps."""


def test_a_killed_run_goes_on_to_the_same_model_by_its_plan(planned, tmp_path, monkeypatch):
    def killing(step, total, values):
        if step == 20:
            raise Killed

    straight, _ = undisturbed(planned.kind)
    run = Run(threads=1, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(planned.scene, planned.asked, replace(run, report=killing))
    monkeypatch.setattr(fitting, "planned", lambda *_: pytest.fail("planned again"))
    assert same(straight, fit(planned.scene, planned.asked, run), planned.scene)


def test_what_is_completed_follows_the_plan():
    settings = Settings(
        iterations=123, sh_degree=1, dropout=0.4, widest=0.7, thickest=0.02, exposure="gain"
    )
    scene = aerial_scene()
    found = completed(settings, scene)
    for part in fields(Settings):
        assert getattr(found, part.name) == getattr(settings, part.name)
    assert found.init == "layered"
    assert found.planes.stride == STRIDE
    assert found.completion.prior == "own"
    given = replace(scene, facts={"depth_prior": "sweep"})
    assert completed(settings, given).completion.prior == "scene"
    camera = replace(scene.views[0].camera, width=900, height=674)
    larger = replace(scene, views=(replace(scene.views[0], camera=camera), *scene.views[1:]))
    rays = [900 * 674 / completed(settings, larger).planes.stride ** 2, STRIDE_PIXELS / STRIDE**2]
    assert rays[0] == pytest.approx(rays[1], rel=0.1)


def test_it_is_told_whose_weights_complete_depths():
    told: dict[str, str] = {}
    run = Run(threads=1, on_fact=told.__setitem__)
    started(aerial_scene(), Settings(iterations=2), run, "stratosplat")
    assert told["completion network"].startswith("out of domain: trained on aerial-sparse, used on")


def test_a_training_ends_where_photos_kept_back_are_good_enough():
    planned, told = BASES["pvg"], {}
    run = Run(threads=1, on_fact=told.__setitem__)
    fit(planned.scene, replace(planned.asked, steps=60, db=1.0), run)
    assert told["quality asked for"].startswith("reached: ")
