"""A scene with hardly any point starts from drawn ones beside them, unless matching finds enough."""

from dataclasses import replace

import torch

from helpers.aerial_scene import aerial_scene, without_points
from helpers.tiny_scene import tiny_scene
from splatproof.methods.auto.base import started
from splatproof.methods.auto.fit import fit, planned
from splatproof.methods.auto.points import BESIDE, LEAST_POINTS, with_enough
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.auto.usual import RANDOM_POINTS
from splatproof.methods.contracts.run import Run
from splatproof.methods.training import initialise
from splatproof.methods.training.fewer_points import with_at_most
from splatproof.reference.supervision.dense_initialisation import observations

ASKED = AutoSettings(seconds=20.0, steps=30, probe_share=0.0)
RUN = Run(threads=1, seed=3)


def test_drawn_points_lie_beside_the_few_that_are_there():
    scene = with_at_most(aerial_scene().for_training(), LEAST_POINTS - 1)
    own = scene.points
    found = with_enough(scene, 3).points
    assert 0 < len(own) < LEAST_POINTS
    assert len(found) == len(own) + BESIDE
    assert torch.equal(found.positions[: len(own)], own.positions)
    drawn = initialise.with_random_points(without_points(scene), BESIDE, 3).points
    assert torch.equal(found.positions[len(own) :], drawn.positions)
    assert torch.equal(found.colours[len(own) :], drawn.colours)
    mine, theirs, both = (
        observations(one, len(scene.views)).toarray() for one in (own, drawn, found)
    )
    assert (both[:, : len(own)] == mine).all()
    assert (both[:, len(own) :] == theirs).all()
    bare = without_points(scene)
    assert torch.equal(
        with_enough(bare, 3).points.positions,
        initialise.with_random_points(bare, RANDOM_POINTS, 3).points.positions,
    )
    enough = tiny_scene(points=LEAST_POINTS)
    assert with_enough(enough, 3) is enough


def test_a_handful_of_points_is_not_all_that_training_starts_from():
    scene = tiny_scene(points=LEAST_POINTS - 1)
    found = planned(scene, ASKED, RUN)
    told = {one.component: one for one in found.plan.choices}
    assert (
        told["start"].value
        == "300 points drawn in sight of the cameras, beside the 11 that are there"
    )
    assert told["points"].value == "108 of 108"  # a photo has 432 pixels
    assert found.start is not None
    again = started(scene, found.plan.settings, RUN, "3dgs")  # as a continued run does
    assert torch.equal(found.start.points.positions, again.points.positions)
    facts: dict[str, str] = {}
    fit(scene, ASKED, replace(RUN, on_fact=facts.__setitem__))
    assert facts["plan: start"].endswith(
        "(the scene has only 11; --points triangulated may find more)"
    )


def test_points_that_matching_finds_are_enough(monkeypatch):
    whole = aerial_scene().for_training()
    few = with_at_most(whole, LEAST_POINTS - 1)
    monkeypatch.setattr(initialise, "with_dense_points", lambda *_: whole)
    asked = replace(ASKED, dense_cell=8.0, completed=False, most_points=10**6)
    found = planned(few, asked, RUN)
    assert "start" not in {one.component for one in found.plan.choices}
    assert found.start is not None
    assert torch.equal(found.start.points.positions, whole.points.positions)
    monkeypatch.setattr(initialise, "with_dense_points", lambda scene, *_: scene)
    vain = planned(few, asked, RUN)
    assert "start" in {one.component for one in vain.plan.choices}
    assert vain.start is not None
    assert len(vain.start.points) == len(few.points) + BESIDE
