"""Which priors there are, and what is said to who asks for another."""

from dataclasses import replace
from pathlib import Path

import pytest

from splatproof.base.errors import MissingError, UsageError
from splatproof.methods.priors import kinds
from splatproof.methods.priors.kinds import KINDS, WEIGHTS, Kind, resolved, weights_facts
from splatproof.reference.types.result import prior_name


@pytest.fixture(autouse=True)
def _weighty(monkeypatch):
    """A kind with weights, of any file."""
    monkeypatch.setitem(
        KINDS, "net", Kind(description="", prepare=KINDS["lidar"].prepare, weights=True)
    )


def test_kinds_resolve_to_what_a_case_holds():
    assert resolved("none", Path("/a"), "x") == "none"
    assert resolved("oracle+noise", Path("/a"), "x") == "oracle+noise"
    assert resolved("net:../b/c.safetensors", Path("/a"), "x") == "net:/b/c.safetensors"


@pytest.mark.parametrize(
    ("prior", "said"),
    [
        ("orakle", "--depth-prior: unknown 'orakle', did you mean 'oracle'"),
        ("", "--depth-prior: unknown ''"),
        ("net", "'net' needs the path of its weights; write net:PATH"),
        ("net:", "'net' needs the path"),
        ("lidar:file", "'lidar' takes no weights; write lidar"),
    ],
)
def test_what_there_is_not_is_refused(prior, said):
    with pytest.raises(UsageError, match=said) as error:
        resolved(prior, Path(), "--depth-prior")
    assert "\n" not in str(error.value)


def test_weights_are_known_by_their_content(tmp_path):
    (tmp_path / "a").mkdir()
    file = tmp_path / "a" / "x"
    file.write_text("1")
    (one,) = weights_facts(f"net:{file}").items()
    assert one[0] == WEIGHTS
    folder = weights_facts(f"net:{tmp_path / 'a'}")
    file.write_text("2")
    assert weights_facts(f"net:{file}") != dict([one])
    assert weights_facts(f"net:{tmp_path / 'a'}") != folder
    assert weights_facts("oracle") == weights_facts("none") == {}


def test_missing_weights_are_said_in_one_line(tmp_path):
    with pytest.raises(MissingError, match="no such weights.*'net'.*'sweep', which needs none"):
        weights_facts(f"net:{tmp_path / 'gone'}")


def test_who_lacks_weights_of_this_package_is_not_asked_for_a_path(tmp_path, monkeypatch):
    lost = replace(KINDS["own"], shipped=tmp_path / "depth.safetensors")
    monkeypatch.setitem(KINDS, "own", lost)
    with pytest.raises(
        MissingError, match=r"depth\.safetensors: no such.*'own'.*install splatproof again.*'sweep'"
    ) as error:
        weights_facts("own")
    assert "give the path" not in str(error.value)


def test_names_of_paths_are_fit_for_folders():
    assert prior_name("net:/a b/c d.e.safetensors") == "net-c-d.e"
    assert "/" not in prior_name("net:/a/..")
    assert prior_name("none") == "none"


def test_only_the_oracles_see_truth():
    assert {name for name, kind in kinds.KINDS.items() if kind.truth} == {"oracle", "oracle+noise"}
