import json

from splatproof.cli import main


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


def test_what_fits_nowhere_is_told(capsys):
    assert main(["plan", "--blocks", "1", "--machines", "1"]) == 0
    assert "–" in capsys.readouterr().out
    assert main(["plan", "--memory-gb", "0.1"]) == 2
    assert "use larger machines" in capsys.readouterr().err
