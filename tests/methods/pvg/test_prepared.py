"""What is prepared follows the settings: the sky, and how Gaussians are drawn."""

import json
from dataclasses import replace

import pytest
import torch

from helpers.covered_sky import require_taught_below
from helpers.tiny_drive import tiny_drive
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import TRAINED
from splatproof.methods.contracts.run import Run
from splatproof.methods.dynamic.settings import SkySettings
from splatproof.methods.models.decoded import DecodedModel
from splatproof.methods.pvg.fit import KIND, prepare
from splatproof.methods.pvg.model import restored
from splatproof.methods.pvg.settings import Settings

SMALL = Settings(iterations=1, sh_degree=0, sky=SkySettings(resolution=0, weight=0.0))
RUN = Run(threads=1, seed=3)


@pytest.mark.parametrize("covered", [0.3, 0.8])
def test_pixels_that_are_covered_by_so_much_teach_the_sky_nothing(covered):
    scene = tiny_drive(moments=4)
    model, _ = prepare(scene, replace(SMALL, sky=SkySettings(resolution=4, covered=covered)), RUN)
    require_taught_below(model, scene.views[0], covered)


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_it_is_drawn_as_it_is_trained_also_once_it_was_stored(mode):
    scene = tiny_drive(moments=4)
    model, _ = prepare(scene, replace(SMALL, antialiased=mode == "antialiased"), RUN)
    model.parameters.rows["log_scales"] -= 3  # small enough for what a pixel spreads to matter
    view = scene.views[0]
    splats = model.splats(view, TRAINED)
    want, other = (
        get_backend("cpu").draw(view.camera, splats, mode=one).colour
        for one in (mode, *({"classic", "antialiased"} - {mode}))
    )
    again = restored(json.loads(json.dumps(model.facts())), model.parameters.state())
    for one in (model, again):
        found = DecodedModel.of(KIND, one, scene, "cpu").render(view).colour
        assert torch.equal(found, want)
    assert not torch.allclose(want, other, atol=0.01)
