"""Models of cities: damage under right hashes is told, and their size tells nothing of the clock."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import random_gaussians
from splatproof.base.errors import DataError
from splatproof.base.files import sha256
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.model import CityModel
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.storage.deflated import deflated, inflated
from splatproof.suites.case_costs import bytes_on_disk

CITY = CityModel(
    model=random_gaussians(5), backend="reference", blocks=torch.zeros(5, dtype=torch.int64),
    distances=torch.zeros(5), block_facts=(BlockFacts(block=0, views=1, points=5, load=10),),
)  # fmt: skip


def saved(folder: Path, seconds: float) -> int:
    """Bytes of the city's folder, had it taken so long."""
    facts = replace(CITY.block_facts[0], seconds=seconds, peak_mb=seconds)
    taken = {"blocks": seconds, "stitch": seconds / 3}
    save_model(replace(CITY, block_facts=(facts,), stage_seconds=taken), folder, Origin())
    return bytes_on_disk(folder)


def test_the_size_of_a_city_does_not_tell_how_long_it_took(tmp_path):
    sizes = {saved(tmp_path, seconds) for seconds in (0.0, 0.1, 1 / 3, 12.5, 99_999.123456789)}
    assert len(sizes) == 1
    loaded = load_reconstruction(tmp_path)
    assert isinstance(loaded, CityModel)
    assert loaded.stage_seconds["blocks"] == 99_999.123456789
    assert loaded.block_facts[0].seconds == 99_999.123456789


def test_a_city_that_says_its_seconds_as_numbers_is_read(tmp_path):
    saved(tmp_path, 2.0)
    told = json.loads((tmp_path / "model.json").read_text())
    told["stage_seconds"] = {"blocks": 2.25}
    told["blocks"][0] |= {"seconds": 1.75}
    (tmp_path / "model.json").write_text(json.dumps(told))
    loaded = load_reconstruction(tmp_path)
    assert isinstance(loaded, CityModel)
    assert (loaded.stage_seconds["blocks"], loaded.block_facts[0].seconds) == (2.25, 1.75)


def change(folder: Path, tensors: Mapping[str, Tensor]) -> None:
    """Give a city other arrays, with their hash."""
    write_tensors(folder / "model.safetensors", tensors)
    told = json.loads((folder / "model.json").read_text())
    told["arrays_sha256"] = sha256(folder / "model.safetensors")
    (folder / "model.json").write_text(json.dumps(told))


def as_before(folder: Path) -> dict[str, Tensor]:
    """Arrays of a city of five Gaussians as they were once written: not deflated."""
    tensors, _ = read_tensors(folder / "model.safetensors")
    for name in ("blocks", "distances"):
        tensors[name] = inflated(tensors.pop(f"deflated_{name}"), 5)
    return tensors


def test_arrays_from_before_they_were_deflated_are_read(tmp_path):
    placed = replace(CITY, distances=torch.tensor([0.0, 0.5, 1.0, 1.1, 2.0]))
    save_model(placed, tmp_path, Origin())
    now = load_reconstruction(tmp_path)
    change(tmp_path, as_before(tmp_path))
    before = load_reconstruction(tmp_path)
    assert isinstance(now, CityModel)
    assert isinstance(before, CityModel)
    assert torch.equal(now.blocks, before.blocks)
    assert torch.equal(now.distances, before.distances)
    assert now.distances.tolist() == pytest.approx(placed.distances.tolist())


def test_many_blocks_are_numbered_in_four_bytes(tmp_path):
    facts = tuple(BlockFacts(block=i, views=1, points=5, load=10) for i in range(300))
    last = replace(CITY, blocks=torch.tensor([0, 255, 256, 299, 7]), block_facts=facts)
    save_model(last, tmp_path, Origin())
    loaded = load_reconstruction(tmp_path)
    assert isinstance(loaded, CityModel)
    assert loaded.blocks.tolist() == [0, 255, 256, 299, 7]


@pytest.mark.parametrize("name", ["deflated_blocks", "deflated_distances"])
@pytest.mark.parametrize("kind", ["cut", "longer", "empty", "another type", "another count"])
def test_deflated_arrays_that_no_city_has(tmp_path, name, kind):
    saved(tmp_path, 1.0)
    tensors, _ = read_tensors(tmp_path / "model.safetensors")
    packed = tensors[name]
    other = {
        "cut": packed[:-1], "longer": torch.cat([packed, packed]), "empty": packed[:0],
        "another type": packed.float(),
        "another count": deflated(torch.zeros(6, dtype=torch.uint8)),
    }[kind]  # fmt: skip
    change(tmp_path, tensors | {name: other})
    with pytest.raises(DataError, match=r"model\.json: damaged") as caught:
        load_reconstruction(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changed",
    [
        {"distances": torch.full((5,), torch.nan)},
        {"distances": torch.full((5,), torch.inf)},
        {"distances": torch.zeros(5, dtype=torch.int64)},
        {"distances": torch.zeros(4)},
        {"blocks": torch.full((5,), 0.5)},
        {"blocks": torch.zeros(5, dtype=torch.bool)},
        {"blocks": torch.tensor(0)},
        {"blocks": torch.full((5,), -1)},
    ],
    ids=str,
)
def test_arrays_that_no_city_has(tmp_path, changed):
    saved(tmp_path, 1.0)
    tensors = as_before(tmp_path)
    change(tmp_path, tensors | changed)
    with pytest.raises(DataError, match=r"model\.json: damaged") as caught:
        load_reconstruction(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changed", [{"shift": [None, 0, 0]}, {"blocks": 3}, {"blocks": [3]}, {"stage_seconds": []},
                {"container": 3}, {"container": {}}],
    ids=str,
)  # fmt: skip
def test_descriptions_that_no_city_has(tmp_path, changed):
    saved(tmp_path, 1.0)
    path = tmp_path / "model.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed))
    with pytest.raises(DataError, match=r"(model\.json|model\.spgs): ") as caught:
        load_reconstruction(tmp_path)
    assert "\n" not in str(caught.value)
