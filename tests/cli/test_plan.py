import json
import shlex
from dataclasses import replace

import pytest

from helpers.tiny_scene import tiny_scene
from splatproof.base import memory
from splatproof.cli import main
from splatproof.datasets.catalogue import opening
from splatproof.methods.auto import photos
from splatproof.methods.auto.fit import planned
from splatproof.methods.contracts.run import Run
from splatproof.methods.training.image_room import image_allowance
from splatproof.suites import city_plan

CITY = city_plan.City()


def test_a_plan_for_people_and_for_machines(capsys):
    assert main(["plan", "--machines", "1", "8", "--blocks", "16", "--simulate"]) == 0
    shown = capsys.readouterr()
    assert len(shown.out.splitlines()) == 3
    assert "simulated" in shown.out.splitlines()[0]
    assert "refining holds the whole model" in shown.err
    assert main(["plan", "--json", "--machines", "8", "--blocks", "16", "--simulate"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["blocks"], record["machines"]) == (16, 8)
    assert record["simulated_fastest"] <= record["simulated_mean"] <= record["simulated_slowest"]
    assert record["seconds"] == record["blocks_seconds"] + record["serial_seconds"]


def test_what_only_a_simulation_obeys_is_refused_without_one(capsys):
    for option in (["--spread", "0.5"], ["--seed", "0"]):
        assert main(["plan", *option]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert "are for --simulate" in said.err
    drawn = []
    for option in (["--spread", "0.9"], ["--seed", "1"], []):
        arguments = ["plan", "--json", "--machines", "8", "--blocks", "64", "--simulate", *option]
        assert main(arguments) == 0
        drawn.append(json.loads(capsys.readouterr().out)["simulated_slowest"])
    assert len(set(drawn)) == 3


def test_one_plan_is_recommended_and_the_others_come_on_request(capsys):
    assert main(["plan", "--json"]) == 0
    shown = capsys.readouterr()
    (best,) = map(json.loads, shown.out.splitlines())
    assert "--all prints every one" in shown.err
    assert main(["plan", "--json", "--all"]) == 0
    plans = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(plans) == 4 * 7
    assert best in plans
    faster = [other for other in plans if other["seconds"] < best["seconds"]]
    assert faster
    for other in faster:  # with machines that do not help
        assert other["machines"] > city_plan.most_useful_machines(CITY, other["blocks"])
    assert main(["plan", "--json", "--machines", "2", "4"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 4 * 2


def test_what_fits_nowhere_is_told(capsys):
    assert main(["plan", "--blocks", "1", "--machines", "1"]) == 0
    assert "–" in capsys.readouterr().out
    assert main(["plan", "--memory-gb", "0.1"]) == 2
    assert "use larger machines" in capsys.readouterr().err


@pytest.fixture
def tiny(monkeypatch):
    """Every scene is the same tiny one, and what it was opened by is told."""
    rules = []

    def opened(scene, protocol):
        rules.append(protocol)
        return replace(tiny_scene(views=9), left_out=(("x.jpg", "its photo is missing: a/x.jpg"),))

    monkeypatch.setattr(opening, "open_scene", opened)
    return rules


PLAN = ["plan", "my scene", "--seconds", "2"]


def test_the_plan_of_a_scene_says_what_was_measured_and_what_follows(tiny, capsys):
    assert main(PLAN) == 0
    shown = capsys.readouterr()
    for word in (
        "photos",
        "baselines",
        "matched points",
        "density",
        "views a step",
        "harmonics",
        "dropout",
        "steps",
    ):
        assert word in shown.out
    assert "nan" not in shown.out.replace("Gaussians", "")
    assert main([*PLAN, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["facts"]["views"] == 8
    assert {"steps", "points", "harmonics"} <= {one["component"] for one in told["choices"]}
    assert all(one["because"] and one["expects"] for one in told["choices"])


def test_a_plan_has_the_memory_for_photos_that_the_fit_will_have(tiny, monkeypatch):
    seen, planned_photos = [], photos.planned_photos
    monkeypatch.setattr(memory, "available_mb", lambda: 1e4)
    monkeypatch.setattr(
        photos, "planned_photos",
        lambda scene, asked, run: seen.append(run.image_bytes) or planned_photos(scene, asked, run),
    )  # fmt: skip
    assert main(PLAN) == 0
    assert seen == [image_allowance(1e4)]
    assert seen[0] > Run.image_bytes


def test_the_command_that_a_plan_names_is_the_plan(tiny, capsys):
    given = [
        "--megabytes",
        "1.5",
        "--db",
        "30",
        "--protocol",
        "city_400",
        "--width",
        "48",
        "--seed",
        "7",
        "--points",
        "triangulated",
        "--threads",
        "1",
    ]
    flags = ["--strict", "--allow-outside"]
    assert main([*PLAN, *given, *flags]) == 0
    told = capsys.readouterr().err
    command = shlex.split(told[told.index("`") + 1 : told.rindex("`")])
    assert command[:4] == ["bench", "fit", "auto", "my scene"]
    assert command[-2:] == flags
    assert dict(zip(command[4:-2:2], command[5:-2:2], strict=True)) == {
        "--out": "OUT", "--seconds": "2", **dict(zip(given[::2], given[1::2], strict=True)),
    }  # fmt: skip
    assert (tiny[0].width, tiny[0].points, tiny[0].strict) == (48, "triangulated", True)
    assert tiny[0].name == "city_400-48px-triangulated"  # as `bench fit` calls it
    assert "left out: x.jpg: its photo is missing" in told


def test_a_plan_is_made_with_the_threads_that_it_is_given(tiny, capsys, monkeypatch):
    found = []
    monkeypatch.setattr(f"{planned.__module__}.planned", lambda scene, asked, run, photos: (
        found.append(run.threads), planned(scene, asked, run, photos))[1])  # fmt: skip
    assert main([*PLAN, "--threads", "1"]) == 0
    assert main(PLAN) == 0
    assert found == [1, None]


def test_what_is_for_cities_is_refused_for_a_scene(tiny, capsys):
    for option in (["--views", "5"], ["--iterations", "7"], ["--blocks", "2"], ["--all"], ["--simulate"],
                   ["--memory-gb", "2"], ["--height", "5"], ["--spread", "0.5"]):  # fmt: skip
        assert main([*PLAN, *option]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert f"{option[0]} is for the plan of a city; leave 'my scene' or it out" in said.err
    assert tiny == []


def test_what_is_for_scenes_is_refused_for_a_city(capsys):
    for option in (["--seconds", "5"], ["--points", "scene"], ["--strict"], ["--threads", "1"]):
        assert main(["plan", *option]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert f"{option[0]} is for the plan of a scene; name the scene or leave it out" in said.err
