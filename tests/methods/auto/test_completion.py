"""Completed depths in the plan: when, what follows of the settings, and what they are counted as."""

from dataclasses import replace

import pytest

from helpers.aerial_scene import aerial_scene
from splatproof.base.errors import UsageError
from splatproof.methods.auto.completion import FEW, planned_completion
from splatproof.methods.auto.facts import facts_of
from splatproof.methods.auto.fit import planned
from splatproof.methods.auto.settings import AutoSettings
from splatproof.methods.contracts.run import Run

FACTS = facts_of(aerial_scene(), 2**20)
ASKED = AutoSettings(seconds=20.0, probe_share=0.0)


def test_nothing_is_completed_unasked_and_of_few_photos_it_is_told():
    found, (choice,) = planned_completion(ASKED, replace(FACTS, views=FEW))
    assert (found, choice.value) == (False, "none")
    assert planned_completion(ASKED, replace(FACTS, views=FEW + 1)) == (False, ())


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("views", [3, 100])
def test_what_is_fixed_is_kept(fixed, views):
    asked = replace(ASKED, completed=fixed)
    found, (choice,) = planned_completion(asked, replace(FACTS, views=views))
    assert (found, choice.because) == (fixed, "given")


def test_what_moves_is_not_completed():
    with pytest.raises(UsageError, match="completed is True, expected 0, or None, where motion"):
        AutoSettings(motion=True, completed=True)


def test_the_number_of_completed_points_is_planned_with():
    scene = aerial_scene().for_training()
    found = planned(scene, replace(ASKED, completed=True), Run(threads=1))
    assert found.start is not None
    assert len(found.start.points) > len(scene.points)
    told = {choice.component: choice for choice in found.plan.choices}
    assert told["points"].value.startswith(f"{len(found.start.points):,} of ")
    assert planned(scene, replace(ASKED, completed=False), Run(threads=1)).start is None
