"""`bench protocols`, and another width than the protocol's."""

import json

import pytest

from splatproof.base.errors import UsageError
from splatproof.cli import main
from splatproof.cli.protocols import held_out, size
from splatproof.metrics.protocol_files import load_protocol, protocol_names, resized
from splatproof.reference.types.protocol import Protocol


def test_every_protocol_is_listed_with_what_it_holds_out(capsys):
    assert main(["protocols"]) == 0
    heading, *lines = capsys.readouterr().out.splitlines()
    assert heading.split()[0] == "name"
    assert {line.split()[0] for line in lines if line and line[0] != " "} == set(protocol_names())
    assert all("None" not in line for line in lines)


def test_one_protocol_shows_its_own_rules_first(capsys):
    assert main(["protocols", "brighton_250"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
    assert rows[0][0] == "source"
    own = {row[0] for row in rows[: 2 + sum(row[0] in ("test_names", "width") for row in rows)]}
    assert "width" in own


def test_json_has_all_rules(capsys):
    assert main(["protocols", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["name"] for line in lines] == protocol_names()
    assert lines[0]["hold"] == load_protocol(protocol_names()[0]).hold


def test_a_wrong_name_says_where_the_names_are(capsys):
    assert main(["protocols", "defualt"]) == 2
    said = capsys.readouterr().err
    assert "`bench protocols`" in said
    assert "default" in said


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        ({"hold": 8}, "every 8th view"),
        ({"hold": 4, "hold_unit": "time", "hold_first": 2}, "every 4th moment from number 2"),
        ({"hold": 0}, "nothing"),
        ({"hold": 0, "train_views": 3}, "all but 3 training views"),
        ({"test_names": ("a.png", "b_*")}, "a.png, b_*"),
        ({"test_folder": "unseen"}, "all views of unseen/"),
        ({"scored": "training"}, "nothing: training views are scored"),
    ],
)
def test_splits_in_words(rules, words):
    assert held_out(Protocol(name="x", source="test", **rules)) == words


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        ({}, "as the photos"),
        ({"factor": 4.0}, "1/4 of the photos"),
        ({"width": 250}, "250 px wide"),
        ({"max_width": 1600}, "at most 1600 px wide"),
    ],
)
def test_sizes_in_words(rules, words):
    assert size(Protocol(name="x", source="test", **rules)) == words


def test_another_width_has_another_name_and_drops_other_rules_of_size():
    plain = Protocol(name="x", source="test", factor=4.0)
    assert resized(plain, None) is plain
    small = resized(plain, 320)
    assert (small.name, small.width, small.factor) == ("x-320px", 320, 1.0)
    with pytest.raises(UsageError, match="--width 0"):
        resized(plain, 0)
