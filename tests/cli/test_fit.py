"""`bench fit` and `bench run` are one road: the same options, records and reports."""

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
import torch

from helpers import fake_methods
from helpers.empty_store import lay_empty_store
from helpers.fake_methods import fake_scene
from splatproof.cli import main, report
from splatproof.cli.expected_time import expected_time
from splatproof.cli.fit import fit as fit_command
from splatproof.cli.running import BlockRunning
from splatproof.cli.short_runs import short_run
from splatproof.datasets.pose_noise import LEVELS
from splatproof.methods.city.executor import ENGINES
from splatproof.methods.city.settings import CitySettings
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_origin
from splatproof.methods.registry import METHODS
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.protocol import key_rules
from splatproof.suites import held_out, runner
from splatproof.suites import run_case as cases
from splatproof.suites.records import read_record
from splatproof.suites.suite_files import load_suite
from splatproof.suites.workers import in_process
from splatproof.viewing.poses import resized

SUITE = """
description = "For tests"
[[cases]]
scenes = ["./town"]
methods = ["METHOD"]
protocols = ["default"]
"""


@pytest.fixture
def town(tmp_path, monkeypatch):
    """The fake method on a fake scene; cases run in this process."""
    monkeypatch.setitem(METHODS, "fake", None)  # removed again after the test
    monkeypatch.setattr(cases, "open_scene", fake_scene)
    monkeypatch.setattr("splatproof.suites.scenes.open_scene", fake_scene)
    for name in ("run_suite", "run_alone"):
        monkeypatch.setattr(runner, name, partial(getattr(runner, name), launch=in_process))
    monkeypatch.setattr(held_out, "TIMED_FRAMES", 3)  # 15 were a third of what a case takes
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    monkeypatch.chdir(tmp_path)
    fake_methods.register()
    (tmp_path / "town").mkdir()
    return tmp_path


@pytest.fixture
def no_store(monkeypatch):
    """Cases are not logged: a new database takes seconds."""
    monkeypatch.setattr(report, "sync_cases", lambda out, uri: False)


def fit(*more: object, method: str = "fake", out: str = "out", scene: str = "town") -> int:
    options = ["--out", out, "--backend", "reference", "--quiet"]
    return main(["fit", method, scene, *options, *map(str, more)])


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes()
            for path in sorted(folder.rglob("*")) if path.is_file()}  # fmt: skip


def test_a_report_shows_a_fit_and_all_fits_of_a_folder_above(town, capsys):
    assert fit("--iterations", 6, out="all/one") == 0
    assert (town / "all/one/mlflow.db").exists()
    assert main(["report", "--out", "all/one", "--json", "--quiet"]) == 0
    (line,) = map(json.loads, capsys.readouterr().out.splitlines()[-1:])
    assert (line["suite"], line["scene"], line["method"]) == ("fit", "town", "fake")
    assert line["psnr"] == read_record(town / "all/one").metrics["psnr"]
    lay_empty_store(town / "all")
    assert main(["report", "--out", "all", "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out) == line


@pytest.mark.usefixtures("no_store")
def test_what_is_there_is_never_replaced_unasked(town, capsys):
    assert fit("--iterations", 6) == 0
    capsys.readouterr()
    before = tree(town)
    for other, said in (
        (["--iterations", 7], "holds town/fake/default/seed0 of backend reference with other"),
        (
            ["--iterations", 7, "--inner.rate", 2],
            "(settings.iterations 6 before, 7 now; settings.inner",
        ),
        (["--iterations", 6, "--seed", 1], "holds town/fake/default/seed0"),
        (["--iterations", 6, "--backend", "cpu"], "of backend reference; take another folder"),
    ):
        assert fit(*other) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
        assert "--no-resume" in line
        assert tree(town) == before
    assert fit("--iterations", 7, "--no-resume", "--json") == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["status"] == "finished"
    assert read_record(town / "out").curve[-1][0] == 7


@pytest.mark.usefixtures("no_store")
@pytest.mark.parametrize("more", [[], ["--no-resume"]])
def test_a_folder_with_other_things_is_refused_and_left_alone(town, capsys, more):
    (town / "mine" / "model").mkdir(parents=True)
    (town / "mine" / "model" / "thesis.txt").write_text("years of work")
    before = tree(town)
    assert fit(*more, out="mine") == 2
    assert "mine: holds 'model', which no `bench fit` left there" in capsys.readouterr().err
    assert tree(town) == before


@pytest.mark.usefixtures("no_store")
def test_data_that_changed_are_told_and_the_model_stays(town, capsys, monkeypatch):
    from splatproof.suites.scene_data import SceneData

    def found(sha: str) -> None:
        monkeypatch.setattr(SceneData, "of", lambda *_: {"photos_sha256": sha})

    found("a")
    assert fit() == 0
    assert fit() == 0
    capsys.readouterr()
    before = tree(town)
    found("b")
    assert fit() == 2
    assert "its photos changed since this was trained" in capsys.readouterr().err
    assert tree(town) == before
    assert fit("--no-resume") == 0


@pytest.mark.usefixtures("no_store")
def test_a_fit_that_fails_leaves_its_reason_and_runs_again(town, capsys):
    assert fit("--fail-with", "no sky") == 1
    assert (
        "town/fake/default/seed0 failed: no sky (traceback: out/failure.txt)"
        in capsys.readouterr().err
    )
    assert read_record(town / "out").error == "no sky"
    assert "no sky" in (town / "out/failure.txt").read_text()
    assert fit("--fail-with", "no sky") == 1


@pytest.mark.usefixtures("no_store")
def test_a_protocol_without_held_out_views_trains_and_scores_nothing(town, capsys, monkeypatch):
    monkeypatch.setattr(cases, "open_scene", lambda *a: replace(fake_scene(*a), test=()))
    assert main(["fit", "fake", "town", "--out", "out", "--backend", "reference"]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert "not scored: protocol default holds no view out" in said.err
    result = read_record(town / "out")
    assert (result.images, result.metrics, result.error) == ((), {}, "")
    assert (town / "out/model/model.json").exists()
    (town / "mine.toml").write_text(SUITE.replace("METHOD", "fake"))
    assert main(["run", "mine.toml", "--backend", "reference"]) == 1  # a suite compares scores


def spied(monkeypatch) -> list[Run]:
    """What methods are told: a method with blocks and one without, which keep their Run."""
    seen: list[Run] = []

    def remembers(scene, settings, run):
        seen.append(run)
        run.say("the plan of it all")
        return fake_methods.model_of(0.5, run.backend)

    fake = replace(METHODS["fake"], fit=remembers)
    monkeypatch.setitem(METHODS, "fake", fake)
    monkeypatch.setitem(METHODS, "blocky", replace(fake, name="blocky", blocks=True))
    return seen


@pytest.mark.usefixtures("no_store")
@pytest.mark.parametrize("command", ["fit", "run"])
@pytest.mark.parametrize("method", ["fake", "blocky"])
def test_every_option_reaches_the_method(town, capsys, monkeypatch, command, method):
    seen = spied(monkeypatch)
    (town / "mine.toml").write_text(SUITE.replace("METHOD", method))
    options = ["--backend", "reference", "--threads", "1", "--checkpoint-seconds", "2.5"]
    if method == "blocky":
        options += ["--workers", "3", "--engine", "inline"]
    what = ["fit", method, "town", "--out", "o"] if command == "fit" else ["run", "mine.toml"]
    assert main([*what, *options]) == 0
    (run,) = seen
    assert (run.backend, run.threads, run.checkpoint_seconds) == ("reference", 1, 2.5)
    if method == "blocky":
        assert (run.workers, run.engine) == (3, "inline")
    assert "the plan of it all" in capsys.readouterr().err


@pytest.mark.usefixtures("no_store")
def test_options_of_blocks_are_refused_where_no_method_has_blocks(town, capsys):
    (town / "mine.toml").write_text(SUITE.replace("METHOD", "fake"))
    before = tree(town)
    assert fit("--engine", "inline") == 2
    assert "--engine" in capsys.readouterr().err
    assert main(["fit", "fake", "--help"]) == 0
    assert "--engine" not in capsys.readouterr().out
    for options in (["--engine", "inline"], ["--workers", "2"]):
        assert main(["run", "mine.toml", *options]) == 2
        assert "none does (fake)" in capsys.readouterr().err
    assert tree(town) == before


def test_the_levels_of_pose_noise_are_those_that_there_are():
    assert get_args(get_type_hints(fit_command)["pose_noise"]) == tuple(LEVELS)


@pytest.mark.usefixtures("no_store")
def test_pose_noise_reaches_the_training_and_is_kept_with_the_model(town, monkeypatch, capsys):
    given = []

    def remembers(scene, settings, run):
        given.append(scene)
        return fake_methods.model_of(0.5, run.backend)

    monkeypatch.setitem(METHODS, "fake", replace(METHODS["fake"], fit=remembers))
    assert fit("--pose-noise", "L2", "--json", "--seed", "3") == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["pose_noise"] == "L2"
    ((true,), (noisy,)) = [fake_scene("town", load_protocol("default"))], given
    moved = [
        not torch.equal(a.camera.world_to_camera, b.camera.world_to_camera)
        for a, b in zip(true.views, noisy.views, strict=True)
    ]
    assert moved == [index in true.train for index in range(len(true.views))]
    assert load_origin(town / "out" / "model").pose_noise == "L2"
    assert fit("--pose-noise", "L1", "--seed", "3") == 2  # the folder holds another case


@pytest.mark.usefixtures("no_store")
def test_a_depth_prior_is_refused_by_name_or_for_what_the_scene_lacks(town, capsys):
    assert fit("--depth-prior", "lidra") == 2
    assert "--depth-prior: unknown 'lidra', did you mean 'lidar'" in capsys.readouterr().err
    assert not (town / "out").exists()
    assert fit("--depth-prior", "lidar", "--json") == 1
    said = capsys.readouterr()
    assert json.loads(said.out.splitlines()[-1])["depth_prior"] == "lidar"
    assert "no training view has a LiDAR sweep" in said.err


def test_methods_in_blocks_say_so():
    kinds = {name: issubclass(method.settings, CitySettings) for name, method in METHODS.items()}
    assert {name: method.blocks for name, method in METHODS.items()} == kinds
    assert set(kinds.values()) == {True, False}


def test_the_engines_are_those_that_there_are():
    assert set(get_args(BlockRunning.__annotations__["engine"])) == set(ENGINES)


@pytest.mark.usefixtures("no_store")
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--threads", "0"], "--threads is 0, expected 1 or more"),
        (["--checkpoint-seconds", "-1"], "--checkpoint-seconds is -1.0, expected 0 or more"),
        (["--protocol", "3dsg"], "3dgs"),
        (["--backend", "gpu"], "did you mean"),
    ],
)
def test_values_that_cannot_be_are_told_in_one_line(town, capsys, options, said):
    before = tree(town)
    assert main(["fit", "fake", "town", "--out", "out", *options]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert tree(town) == before
    assert not (town / "out").exists()


@pytest.mark.usefixtures("no_store")
def test_a_scene_that_is_not_there_is_told_before_anything_is_written(town, capsys):
    assert fit(scene="twon") == 2
    assert "unknown 'twon'" in capsys.readouterr().err
    assert not (town / "out").exists()


@pytest.mark.usefixtures("no_store")
def test_points_and_strictness_are_rules_and_what_is_left_out_is_told(town, capsys):
    options = ["--out", "other", "--backend", "reference", "--iterations", "6"]
    assert main(["fit", "fake", "town", *options, "--points", "triangulated", "--strict"]) == 0
    record = read_record(town / "other")
    assert record.protocol == "default-triangulated"
    rules = record.protocol_rules
    assert (rules["points"], rules["strict"]) == ("triangulated", True)
    assert "left out: blurred.jpg: did not register" in capsys.readouterr().err


@pytest.mark.usefixtures("no_store")
def test_a_result_from_before_a_rule_was_there_is_kept(town, capsys):
    rules = load_protocol("default")
    assert not {"strict", "least_seen"} & set(key_rules(asdict(rules)))
    assert key_rules(asdict(replace(rules, strict=True)))["strict"] is True
    assert fit("--iterations", 6) == 0
    assert fit("--iterations", 6, "--json") == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["status"] == "kept"
    assert fit("--iterations", 6, "--strict") == 2
    assert "(protocol.strict false before, true now)" in capsys.readouterr().err


def test_a_long_fit_says_how_long_and_how_a_first_look_is_had():
    case = load_suite("quick").cases[0]
    small = fake_scene("town", case.protocol)
    views = tuple(replace(view, camera=resized(view.camera, 2000)) for view in small.views)
    large = replace(small, views=views)
    long = replace(case, method="3dgs", settings=Settings(iterations=30_000))
    told = expected_time(long, large, "cpu")
    assert told.startswith("30000 steps over 4 photos of 2000 x ")
    assert "a first look in " in told
    assert "--width 320 --iterations 2000" in told
    assert "first look" not in expected_time(
        replace(case, settings=Settings(iterations=9)), small, "cpu"
    )


@pytest.mark.usefixtures("no_store")
def test_a_fit_says_how_long_it_takes_but_not_where_it_is_done(town, capsys):
    options = ["--out", "out", "--backend", "reference", "--iterations", "6"]
    for said in (True, False):
        assert main(["fit", "fake", "town", *options]) == 0
        told = capsys.readouterr().err
        assert ("6 steps over 4 photos" in told) is said
        assert "look at it: bench view out;" in told


def test_a_short_run_of_the_releases_schedule_is_told_what_it_does():
    assert "squeezed into steps 33 to 1000" in short_run(Settings(iterations=2000))
    assert short_run(Settings(iterations=7000)) == ""
    assert short_run(Settings(iterations=2000, density=Density(start=7500))) == ""
    suite = load_suite("brighton")
    assert {case.settings.iterations for case in suite.cases} == {2000}
    assert {short_run(case.settings) for case in suite.cases} == {""}


@pytest.mark.usefixtures("no_store")
def test_a_width_is_part_of_the_protocol_that_the_record_names(town):
    assert fit("--iterations", 6, "--width", 20) == 0
    record = read_record(town / "out")
    assert record.protocol == "default-20px"
    assert record.protocol_rules["width"] == 20
    assert main(["run", "quick", "--width", "60", "--dry-run", "--quiet"]) == 0
