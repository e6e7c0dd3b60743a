"""Metrics of other packages: named in a protocol, scored, loaded, shown and ranked like ours."""

import dataclasses
from importlib.metadata import EntryPoint

import pytest
import torch

from helpers.case_folders import result
from splatproof.base import plugins
from splatproof.base.errors import UsageError
from splatproof.metrics import registry
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.registry import BUILT_IN, all_metrics, find_metric, load_weights
from splatproof.metrics.scoring import scene_metrics, score_image
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
