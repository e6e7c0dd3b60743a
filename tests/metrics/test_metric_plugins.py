"""Metrics of other packages: named in a protocol, scored, loaded, shown and ranked like ours."""

import dataclasses
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import torch

from helpers.case_folders import result
from splatproof.base import plugins
from splatproof.base.errors import UsageError
from splatproof.metrics import registry, scoring
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.registry import BUILT_IN, Metric, all_metrics, find_metric, load_weights
from splatproof.metrics.scoring import scene_metrics, score_image
from splatproof.reference.types.protocol import Protocol
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.text import explained


@pytest.fixture
def offered(monkeypatch):
    """Pretends that installed packages offer metrics; says how often they were looked for."""
    looked = []

    def offer(**values: str) -> list[str]:
        points = [
            EntryPoint(name=name, value=f"helpers.plugin_metrics:{value}", group=registry.GROUP)
            for name, value in values.items()
        ]

        def entry_points(group: str) -> list[EntryPoint]:
            looked.append(group)
            return points if group == registry.GROUP else []

        monkeypatch.setattr(plugins, "entry_points", entry_points)
        return looked

    registry._all_metrics.cache_clear()
    yield offer
    registry._all_metrics.cache_clear()


def test_it_stands_behind_ours_and_is_looked_up_once(offered):
    looked = offered(brightness="BRIGHTNESS")
    assert looked == []
    assert list(all_metrics()) == [*BUILT_IN, "brightness"]
    assert find_metric("brightness").unit == "lx"
    assert looked == ["splatproof.metrics"]
    assert load_weights(["brightness", "psnr"]) == {}
    with pytest.raises(UsageError, match="did you mean 'brightness'"):
        find_metric("brightnes")


def test_a_protocol_names_it_and_it_is_scored_and_ranked(offered, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('source = "ours"\nmetrics = ["brightness", "psnr"]\nrounding = "float"\n')
    offered()
    with pytest.raises(UsageError, match="metric: unknown 'brightness'"):
        load_protocol(path)
    registry._all_metrics.cache_clear()
    offered(brightness="BRIGHTNESS")
    rules = load_protocol(path)
    truth, results = torch.full((4, 4, 3), 0.5), []
    for method, off in (("near", 0.1), ("far", 0.2)):
        for seed in range(3):
            images = [
                score_image(f"{i}.png", truth + off + 1e-3 * (seed + i), truth, rules)
                for i in range(2)
            ]
            case = result(method=method, seed=seed, protocol=rules)
            scores = scene_metrics(images)
            results.append(dataclasses.replace(case, images=tuple(images), metrics=scores))
    assert results[0].images[0].metrics["brightness"] == pytest.approx(0.1, abs=1e-6)
    (table,) = build_tables(results)
    assert [(row.label, row.rank) for row in table.rows] == [("near", 1), ("far", 2)]
    assert explained([table])["brightness [lx] ↓"] == "another package's own"


def test_masks_reach_it(offered):
    offered(brightness="BRIGHTNESS")
    truth, mask = torch.zeros(4, 4, 3), torch.zeros(4, 4, dtype=torch.bool)
    mask[0] = True
    image = truth + torch.where(mask, 0.0, 1.0)[..., None]
    rules = dataclasses.replace(load_protocol("default"), metrics=("brightness",))
    assert score_image("a", image, truth, rules, mask).metrics == {"brightness": 0.0}
    assert score_image("a", image, truth, rules).metrics == {"brightness": 0.75}


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("psnr", "BRIGHTNESS", "psnr = .*the name is taken"),
        ("shine", "BRIGHTNESS", "shine .*its metric is called 'brightness'"),
        ("nbgj", "TAKEN_BY_A_SCENE", "nbgj .*taken by a metric of whole scenes"),
        ("odd", "Metric", "odd = .*is a type, expected a Metric"),
        ("gone", "NOTHING", "gone = .*cannot be loaded"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(offered, name, value, said):
    offered(**{name: value})
    with pytest.raises(UsageError, match=said):
        all_metrics()


def added(function, name: str = "mine") -> Metric:
    return Metric(
        name=name,
        function=function,
        unit="",
        higher_is_better=True,
        range=(0.0, 1.0),
        source="test",
    )


@pytest.fixture
def known(monkeypatch):
    """Has protocols know one metric more."""

    def know(metric: Metric) -> Protocol:
        monkeypatch.setattr(
            scoring, "find_metric", lambda name: metric if name == metric.name else BUILT_IN[name]
        )
        return Protocol(name="test", source="ours", metrics=(metric.name, "psnr"))

    return know


def raises(image, target, mask):
    raise ValueError("two\nlines")


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (raises, "metric mine: fails on a.png (ValueError: two lines); mend it"),
        (lambda image, target, mask: "x", "it gave a str, expected a float"),
        (lambda image, target, mask: None, "it gave a NoneType, expected a float"),
        (lambda image, target, mask: image, "it gave a Tensor, expected a float"),
        (lambda image, target, mask: 1j, "it gave a complex, expected a float"),
        (lambda image, target: 0.5, "TypeError"),
    ],
)
def test_one_that_fails_or_gives_no_number_is_named_in_one_line(known, function, said):
    image = torch.full((4, 4, 3), 0.5)
    with pytest.raises(UsageError) as error:
        score_image("a.png", image, image, known(added(function)))
    assert said in str(error.value)
    assert "metric mine: fails on a.png" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_number_of_any_kind_is_a_float(known):
    image = torch.full((4, 4, 3), 0.5)
    for value in (torch.tensor(0.25), np.float32(0.25), 0.25):
        rules = known(added(lambda *_, value=value: value))
        found = score_image("a.png", image, image, rules).metrics["mine"]
        assert (type(found), found) == (float, 0.25)


def test_one_that_writes_into_its_images_changes_no_other_metric(known):
    def spoils(image, target, mask):
        for one in (image, target, mask):
            one.zero_()
        return 0.5

    image, target = torch.full((4, 4, 3), 0.5), torch.full((4, 4, 3), 0.6)
    rules, mask = known(added(spoils)), torch.ones(4, 4, dtype=torch.bool)
    found = score_image("a.png", image, target, rules, mask)
    without = score_image(
        "a.png", image, target, dataclasses.replace(rules, metrics=("psnr",)), mask
    )
    assert found.metrics["psnr"] == without.metrics["psnr"]
    assert found.truth_sha256 == without.truth_sha256


@pytest.mark.parametrize("name", ["image", "train_seconds", "a b/c"])
def test_a_name_that_records_use_otherwise_is_refused(monkeypatch, name):
    table = {**BUILT_IN, name: added(len, name)}
    monkeypatch.setattr(registry, "with_plugins", lambda *_: table)
    registry._all_metrics.cache_clear()
    with pytest.raises(UsageError, match=f"'{name}'.*expected a name of letters"):
        all_metrics()
    registry._all_metrics.cache_clear()
