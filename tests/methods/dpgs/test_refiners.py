"""Refiners of side views: whose weights they have, and that a wrong folder is told before anything else."""

from dataclasses import replace

import pytest
import torch

from helpers.city_scene import small_scene
from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.files import sha256
from splatproof.methods.city import pipeline
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs import refiners
from splatproof.methods.dpgs.fit import fit
from splatproof.methods.dpgs.refiners import REFINER, refiner_facts, refiner_of, weights_sha256
from splatproof.methods.dpgs.settings import NO_SIDES, Dpgs, SideSettings
from splatproof.methods.priors.view_refiner import SHIPPED
from splatproof.methods.registry import get_method
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.settings import Settings
from splatproof.reference.supervision.spiral_path import SpiralSettings

OWN = SideSettings(every=3, refiner="own", spiral=SpiralSettings(layers=1, views=3))


def test_weights_are_named_by_their_bytes(tmp_path):
    other = SideSettings(refiner="sd-turbo", weights=str(tmp_path / "net"))
    with pytest.raises(DataError, match="net: no such file"):
        weights_sha256(other)
    (tmp_path / "net").mkdir()
    (tmp_path / "net" / "unet").write_text("one")
    first = weights_sha256(other)
    (tmp_path / "net" / "unet").write_text("two")
    assert len({first, weights_sha256(other), weights_sha256(OWN)}) == 3
    assert weights_sha256(OWN) == refiner_of(OWN).weights == sha256(SHIPPED)
    assert {weights_sha256(SideSettings(refiner=name)) for name in ("none", "warp")} == {""}
    assert weights_sha256(replace(other, every=0)) == ""
    assert refiner_of(replace(other, every=0)).refine is None


def test_the_record_of_a_case_names_them():
    assert refiner_facts(Dpgs(side=OWN)) == {REFINER: sha256(SHIPPED)}
    assert refiner_facts(Dpgs()) == refiner_facts(Dpgs(side=NO_SIDES)) == {}
    assert refiner_facts(Settings()) == {}


def test_other_weights_in_the_same_place_do_not_go_on(tmp_path, monkeypatch):
    scene = replace(tiny_scene(), up=torch.tensor([0.0, 0, -1], dtype=torch.float64))
    settings = Dpgs(iterations=4, sh_degree=1, dense_cell=0.0, side=OWN)
    run = Run(threads=1, folder=tmp_path)
    fit(scene, settings, run)
    fit(scene, settings, run)
    monkeypatch.setattr(refiners, "weights_sha256", lambda side: "others")
    with pytest.raises(UsageError, match=r"differs: the rest.*others"):
        fit(scene, settings, run)


@pytest.mark.parametrize("method", ["dpgs", "dpgs-partition"])
def test_what_a_refiner_lacks_is_told_before_photos_are_matched(tmp_path, monkeypatch, method):
    for module in (threedgs, pipeline):
        monkeypatch.setattr(module, "started", lambda *_: pytest.fail("photos were matched"))
    side = SideSettings(refiner="sd-turbo", weights=str(tmp_path / "nothing"))
    found = get_method(method)
    with pytest.raises((DataError, MissingError)):
        found.fit(small_scene(60), found.settings(iterations=4, side=side), Run(threads=1))
