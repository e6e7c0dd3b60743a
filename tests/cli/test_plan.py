import json

from splatproof.cli import main
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
