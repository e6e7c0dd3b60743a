"""Exposures of photos under methods of driving scenes: learnt beside time and sky, and stored."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from helpers.tiny_drive import tiny_drive
from splatproof.methods.contracts.reconstruction import Adapts, Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.registry import get_method
from splatproof.reference.types.scene import Scene

SHORT = {"pvg": {"sh_degree": 1}, "hdgs": {"gaussians": 6, "features": 8, "anchors": 40}}


def dimmed() -> tuple[Scene, tuple[str, str]]:
    """The tiny drive whose second training photo is darker, and the names of its first two."""
    scene = tiny_drive()
    first, second = (scene.views[i] for i in scene.train[:2])
    dark = replace(second, load=partial(torch.mul, second.load(), 0.5))
    views = tuple(dark if view is second else view for view in scene.views)
    return replace(scene, views=views).for_training(), (first.name, second.name)


@pytest.mark.parametrize("name", ["pvg", "hdgs"])
def test_photos_have_exposures_of_their_own(name, tmp_path):
    scene, (bright, dark) = dimmed()
    method = get_method(name)
    settings = method.settings(iterations=60, exposure="gain", **SHORT[name])
    model = method.fit(scene, settings, Run(threads=1, seed=3))
    save_model(model, tmp_path, Origin())
    again = load_reconstruction(tmp_path)
    assert isinstance(again, Adapts)
    view = scene.views[scene.train[0]]
    first, second = (again.render(replace(view, appearance=each)).colour for each in (bright, dark))
    assert torch.equal(first, model.render(view).colour)
    assert float(second.sum()) < 0.97 * float(first.sum())
