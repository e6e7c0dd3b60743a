"""What every baseline of few views keeps: a continued run's bits, a model on disk, its own settings."""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import pytest
import torch

from helpers.baking import baked
from helpers.tiny_scene import camera, tiny_scene
from splatproof.base.typed_toml import build
from splatproof.methods.contracts.reconstruction import Origin, Reconstruction, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.registry import get_method
from splatproof.methods.training.density import Density
from splatproof.reference.types.scene import camera_view

NAMES = ("fsgs", "dropgaussian", "cor-gs")
RUN = Run(threads=1, seed=3)


def short(name: str):
    density = {"start": 0, "interval": 10, "least_interval": 10, "gradient": 1e-5}
    more = {"prune_interval": 9000, "agreement_start": 0} if name == "cor-gs" else {}
    given = {"iterations": 35, "sh_degree": 1, "density": density} | more
    return build(get_method(name).settings, given, "suite.toml")


class Killed(Exception):
    pass


@cache
def whole(name: str) -> Reconstruction:
    """The model of an undisturbed run."""
    return get_method(name).fit(tiny_scene(), short(name), RUN)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("step", [10, pytest.param(21, marks=pytest.mark.slow)])
def test_killed_and_continued_is_the_same_to_the_bit(tmp_path, name, step):
    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= step:
            raise Killed

    method, cut = get_method(name), replace(RUN, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        method.fit(tiny_scene(), short(name), replace(cut, report=kill))
    again, want = baked(method.fit(tiny_scene(), short(name), cut)), baked(whole(name))
    assert len(want.means) != 40
    assert all(torch.equal(getattr(again, field), getattr(want, field)) for field in FIELDS)


@pytest.mark.parametrize("name", NAMES)
def test_another_seed_is_another_model_and_a_saved_one_renders_the_same(tmp_path: Path, name):
    one, other = whole(name), get_method(name).fit(tiny_scene(), short(name), replace(RUN, seed=1))
    view = camera_view(camera(0))
    assert not torch.equal(one.render(view).colour, other.render(view).colour)
    save_model(one, tmp_path / "model", Origin(method=name))
    again = load_reconstruction(tmp_path / "model")
    assert torch.equal(again.render(view).colour, one.render(view).colour)


@pytest.mark.parametrize("name", NAMES)
def test_more_steps_cost_more(name):
    method = get_method(name)
    few, many = (method.cost(replace(short(name), iterations=n), tiny_scene()) for n in (50, 500))
    assert many.cpu_seconds > few.cpu_seconds > 0
    assert few.memory_mb > 0


def test_dropgaussian_hides_in_training_alone_and_without_it_is_3dgs():
    settings = short("dropgaussian")
    off = replace(settings, dropout=0.0)
    plain = build(
        get_method("3dgs").settings,
        {"iterations": 35, "sh_degree": 1, "sh_interval": 3000, "dssim": 1 / 6},
        "suite.toml",
    )
    same = {part.name: getattr(off.density, part.name) for part in fields(Density)}
    plain = replace(plain, density=replace(plain.density, **same))
    ours, theirs, hiding = (
        baked(get_method(name).fit(tiny_scene(), each, RUN))
        for name, each in (("dropgaussian", off), ("3dgs", plain), ("dropgaussian", settings))
    )
    assert all(torch.equal(getattr(ours, field), getattr(theirs, field)) for field in FIELDS)
    assert not torch.equal(hiding.means[:20], ours.means[:20])
