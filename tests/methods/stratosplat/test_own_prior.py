"""Depths completed from what our own network says: that it is asked, with which weights, and what is refused."""

from dataclasses import replace

import pytest
import torch

from helpers.aerial_scene import aerial_scene, prior_of
from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import sha256
from splatproof.methods.contracts.run import Run
from splatproof.methods.priors import unet
from splatproof.methods.priors.network import COMPLETION
from splatproof.methods.stratosplat import completion, own_prior
from splatproof.methods.stratosplat import fit as module
from splatproof.methods.stratosplat.completion import completed
from splatproof.methods.stratosplat.fit import fit
from splatproof.methods.stratosplat.own_prior import COMPLETER, completion_facts
from splatproof.methods.stratosplat.settings import Completion, Planes, StratoSplat
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density

OWN = Completion(guidance_steps=3, prior="own")
SHORT = StratoSplat(
    iterations=2, planes=Planes(field="none"), completion=OWN, dense_cell=0.0,
    density=Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=10_000),
)  # fmt: skip


def cloud(scene, settings: Completion):
    return completed(
        scene,
        settings,
        guided=True,
        generator=torch.Generator().manual_seed(0),
        report=lambda line: None,
    )


def test_what_the_network_says_is_taken_as_a_prior_is(monkeypatch):
    asked = []

    def said(network, view, points):
        asked.append((view.name, len(points)))
        return prior_of(view.camera)

    monkeypatch.setattr(completion, "said_of", said)
    scene = aerial_scene(points=6)
    ours = cloud(scene, replace(OWN, prior="own"))
    given = cloud(aerial_scene(points=6, prior=True), replace(OWN, prior="scene"))
    assert torch.equal(ours.positions, given.positions)
    assert [name for name, _ in asked] == [scene.views[index].name for index in scene.train]
    assert all(count > 0 for _, count in asked)


def test_the_shipped_network_says_something_of_each_photo():
    """Of so few points that none of them can contradict it."""
    scene = aerial_scene(points=6)
    ours, plain = (cloud(scene, replace(OWN, prior=p)) for p in ("own", "scene"))
    assert ours.positions.isfinite().all()
    assert not torch.equal(ours.positions, plain.positions)


def test_the_record_says_which_weights_and_whether_they_know_such_scenes(tmp_path):
    facts: dict[str, str] = {}
    run = Run(threads=1, folder=tmp_path, on_fact=facts.__setitem__)
    fit(aerial_scene().for_training(), SHORT, run)
    weights = sha256(COMPLETION)
    assert facts["completion network"] == (
        f"out of domain: trained on aerial-sparse, used on photos; weights {weights}"
    )
    assert completion_facts(SHORT) == {COMPLETER: weights}
    plain = replace(SHORT, completion=replace(OWN, prior="scene"))
    assert completion_facts(plain) == {}
    assert completion_facts(Settings()) == {}


def test_other_weights_do_not_continue(tmp_path, monkeypatch):
    scene, run = aerial_scene().for_training(), Run(threads=1, folder=tmp_path)
    fit(scene, SHORT, run)
    fit(scene, SHORT, run)
    monkeypatch.setattr(module, "completion_weights", lambda settings: "others")
    with pytest.raises(UsageError, match="differs"):
        fit(scene, SHORT, run)


def test_a_prior_of_the_scene_besides_is_refused_in_one_line():
    scene = aerial_scene(prior=True).for_training()
    scene = replace(scene, facts={"depth_prior": "sweep"})
    with pytest.raises(
        UsageError, match="prior is 'own', but the scene's photos have depth prior 'sweep'"
    ):
        fit(scene, SHORT, Run(threads=1))


def test_missing_weights_say_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(unet, "PACKAGED", tmp_path)
    for module_with_it in (completion, own_prior):
        monkeypatch.setattr(module_with_it, "COMPLETION", tmp_path / "completion.safetensors")
    with pytest.raises(DataError, match=r"completion\.safetensors: .*install splatproof again"):
        cloud(aerial_scene(), OWN)
    with pytest.raises(DataError, match=r"completion\.safetensors"):
        fit(aerial_scene().for_training(), SHORT, Run(threads=1))
