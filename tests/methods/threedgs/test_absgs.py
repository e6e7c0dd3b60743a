"""Method absgs: 3dgs with a split by absolute gradients, on both paths (the slower among the slow tests)."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from helpers.baking import baked
from helpers.tiny_scene import tiny_scene
from splatproof.base.typed_toml import build
from splatproof.methods.contracts.run import Run
from splatproof.methods.models.explicit import FIELDS
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs.absgs import AbsDensity, AbsGS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density

FAST: dict[str, Any] = {
    "start": 0, "interval": 10, "least_interval": 10, "stop": 25_000, "reset_interval": 0,
}  # fmt: skip


def test_its_own_thresholds_hold_where_a_suite_sets_others():
    settings = build(AbsGS, {"density": {"interval": 50}}, "suite.toml")
    assert settings.density == AbsDensity(interval=50)
    assert AbsGS().density == AbsDensity()
    assert (settings.density.split_gradient, settings.density.split_size) == (4e-4, 1e-3)


@pytest.mark.parametrize("backend", ["cpu", pytest.param("reference", marks=pytest.mark.slow)])
def test_with_the_split_off_it_is_3dgs_and_with_it_another_model(backend):
    scene, run = tiny_scene(), Run(threads=1, seed=3, backend=backend)
    plain = Settings(iterations=40, sh_degree=0, density=Density(**FAST))
    off = AbsDensity(**FAST, split_gradient=0.0, split_size=0.01)
    ours = AbsGS(iterations=40, sh_degree=0, density=off)
    method = get_method("absgs")
    want = baked(get_method("3dgs").fit(scene, plain, run))
    assert torch.equal(baked(method.fit(scene, ours, run)).means, want.means)
    on = replace(ours, density=AbsDensity(**FAST, split_gradient=1e-3, split_size=0.01))
    assert len(baked(method.fit(scene, on, run)).means) != len(want.means)


def test_killed_and_continued_is_the_same_to_the_bit(tmp_path):
    class Killed(Exception):
        pass

    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now >= 20:  # between two densifications, with sums of absolute gradients behind it
            raise Killed

    sums = replace(AbsDensity(**FAST, split_gradient=5e-4), interval=8, least_interval=8)
    settings = AbsGS(iterations=40, sh_degree=1, density=sums)
    method, run = get_method("absgs"), Run(threads=1, seed=3)
    cut = replace(run, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        method.fit(tiny_scene(), settings, replace(cut, report=kill))
    again, whole = (baked(method.fit(tiny_scene(), settings, one)) for one in (cut, run))
    assert len(whole.means) > len(tiny_scene().points)
    assert all(torch.equal(getattr(again, name), getattr(whole, name)) for name in FIELDS)
