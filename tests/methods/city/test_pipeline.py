"""Rows of the city end to end on a tiny scene: what they share, what they leave, where they break."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from helpers.baking import baked
from helpers.city_scene import small_scene
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.tensor_files import read_tensors, write_tensors
from splatproof.methods.city.model import CONTAINER, CityModel, in_hundredths
from splatproof.methods.city.planted import PlantSettings
from splatproof.methods.city.refine import RefineSettings
from splatproof.methods.city.train_block import read_gaussians
from splatproof.methods.contracts.reconstruction import ARRAYS, Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.settings import NO_SIDES, SideSettings
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.registry import METHODS
from splatproof.methods.storage.packed.coded_writer import CodeSettings
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.metrics.seam import INNER, OUTER, overlap_band
from splatproof.reference.stitching.preclean import CleanSettings
from splatproof.reference.stitching.stochastic import RIM, StitchSettings
from splatproof.reference.supervision.spiral_path import SpiralSettings
from splatproof.suites.scene_scores.block_balance import over_hard_cut

SHORT = {
    "iterations": 20,
    "sh_degree": 1,
    "density": Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=0,
                       gradient=1e-6, largest_size=10.0),
}  # fmt: skip
CITY: dict[str, Any] = SHORT | {"blocks": 2}
ROWS = {
    "citygaussian": {"coarse_iterations": 5},
    "vastgaussian": {},
    "blockgaussian": {},
    "dpgs-partition": {},
    "stitchgs": {},
    "odbp+stitch": {},
}
BARE = {"gcr": False, "quantise": False}
SCENE = small_scene(60)


def run(folder: Path | None = None, **more: Any) -> Run:
    usual: dict[str, Any] = {"folder": folder, "backend": "cpu", "threads": 1, "engine": "inline"}
    return Run(**usual | more)


def fit(row: str, at: Run, **more) -> CityModel:
    method = METHODS[row]
    settings = method.settings(**(CITY | ROWS[row] | more))
    model = method.fit(SCENE, settings, at)
    assert isinstance(model, CityModel)
    return model


def arrays(model: CityModel):
    """What a file holds of a model, which has distances in hundredths."""
    return {name: getattr(model.model, name) for name in FIELDS} | {
        "blocks": model.blocks, "distances": in_hundredths(model.distances),
    }  # fmt: skip


def same(one: CityModel, other: CityModel) -> bool:
    first, second = arrays(one), arrays(other)
    return all(torch.equal(first[name], second[name]) for name in first)


@given(
    st.lists(
        st.one_of(st.floats(0, 3, width=32), st.sampled_from([INNER, OUTER, 2.55])), min_size=1
    )
)
def test_a_file_says_the_same_of_who_lies_in_the_overlap_band(given_distances):
    true = torch.tensor(given_distances, dtype=torch.float32)
    near = ((true - INNER).abs() < 2e-6) | ((true - OUTER).abs() < 2e-6)
    exact = (true == INNER) | (true == torch.tensor(OUTER))
    true = true[exact | ~near]
    stored = in_hundredths(true) / 100
    assert torch.equal(overlap_band(stored), overlap_band(true))
    assert torch.equal(stored <= INNER, true <= INNER)
    inside = true <= 2.55
    assert ((stored - true)[inside] <= 0.01 + 1e-6).all()
    assert ((stored - true)[inside] >= -2e-6).all()


@pytest.mark.parametrize("row", sorted(ROWS))
def test_a_row_runs_from_scene_to_loaded_model(tmp_path, row):
    stages: dict[str, float] = {}
    steps: list[tuple[int, int]] = []
    model = fit(row, run(tmp_path, on_stage=stages.__setitem__,
                         report=lambda step, total, values: steps.append((step, total))))  # fmt: skip
    settings = METHODS[row].settings(**(CITY | ROWS[row]))
    names = ["coarse"] * bool(settings.coarse_iterations) + ["partition", "blocks", "stitch"]
    names += ["refine"] * settings.gcr + ["compress"] * settings.quantise
    assert list(model.stage_seconds) == names
    assert sum(model.stage_seconds.values()) == pytest.approx(stages["train"])
    assert [facts.block for facts in model.block_facts] == [0, 1]
    for facts in model.block_facts:
        assert facts.views > 0
        assert 0 < facts.kept <= facts.primitives or facts.note
    assert sum(facts.points for facts in model.block_facts) == len(SCENE.points)
    kept = {facts.block for facts in model.block_facts if facts.kept}
    assert set(model.blocks.tolist()) == kept
    assert float(model.distances.max()) <= RIM + 1e-6
    assert {total for _, total in steps} == {steps[0][1]}
    if not any(facts.note for facts in model.block_facts):
        assert max(step for step, _ in steps) == steps[0][1]
    save_model(model, tmp_path / "model", Origin(method=row))
    back = load_reconstruction(tmp_path / "model", backend="cpu")
    assert isinstance(back, CityModel)
    assert same(model, back)
    assert back.block_facts == model.block_facts
    assert back.stage_peak_mb == model.stage_peak_mb
    assert (back.packed is not None) == settings.quantise
    assert back.packed_parts == model.packed_parts
    assert sum(model.packed_parts.values()) == len(model.packed or b"")
    image = back.render(SCENE.views[0]).colour
    assert image.isfinite().all()
    assert image.max() > 0.1


def test_blocks_take_side_views_where_views_are_drawn_uniformly(tmp_path):
    side = SideSettings(every=3, spiral=SpiralSettings(layers=1, views=3))
    scene = replace(SCENE, up=torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64))
    method = METHODS["dpgs-partition"]
    with_, without = (
        method.fit(scene, method.settings(**CITY, side=one), run(tmp_path / name))
        for name, one in (("with", side), ("without", NO_SIDES))
    )
    assert isinstance(with_, CityModel)
    assert isinstance(without, CityModel)
    assert not same(with_, without)
    with pytest.raises(UsageError, match="sampling is 'balanced', expected 'uniform' with side"):
        METHODS["stitchgs"].settings(side=side)


def test_our_small_file_is_what_the_refinement_saw_and_keeps_whose_is_whose(tmp_path):
    cache = tmp_path / "cache"
    of = {"refine": RefineSettings(iterations=40)}
    plain, paper, small = (
        fit("stitchgs", run(tmp_path / name, cache=cache), **of | more)
        for name, more in (
            ("plain", {"quantise": False}), ("paper", {}), ("small", {"coder": "small"}),
        )
    )  # fmt: skip
    assert small.packed is not None
    assert paper.packed is not None
    assert len(small.packed) < 0.75 * len(paper.packed)
    assert len(small.model) == len(plain.model)
    regions = small.regions
    for block in small.blocks.unique().tolist():
        rows = small.blocks == block
        away = regions[block].distance(small.model.means[rows].double())
        # a cell is a twentieth of the median Gaussian's scale
        assert float((away - small.distances[rows]).abs().max()) < 0.02
    save_model(small, tmp_path / "model", Origin(method="stitchgs"))
    back = load_reconstruction(tmp_path / "model", backend="cpu")
    assert isinstance(back, CityModel)
    assert same(small, back)
    assert sum(back.packed_parts.values()) == len(small.packed)
    view = SCENE.views[0]
    apart = small.render(view).colour - plain.render(view).colour
    assert float(apart.square().mean()) < 1e-3


def test_what_is_cleaned_is_invisible_before_it_fades(tmp_path):
    """What one block has faded to less than the bound is the rest of a share, and stays with the others'."""
    fade: dict[str, Any] = {"merge": "fade", "quantise": False}
    fit("stitchgs", run(tmp_path / "a", cache=tmp_path), gcr=False, **fade)
    whose, _ = read_tensors(next((tmp_path / "a").rglob("blocks.safetensors")))
    left = read_gaussians(next((tmp_path / "a").rglob("merged")) / ARRAYS).opacity_logits
    before = whose["unfaded"]
    assert bool((left <= before).all())
    bound = float(left.median())
    here = before > bound
    assert int(here.sum()) > int((left > bound).sum())
    clean = CleanSettings(least_logit=bound, volume_quantile=1.0)
    refined = fit(
        "stitchgs", run(tmp_path / "b", cache=tmp_path),
        refine=RefineSettings(iterations=2, clean=clean), **fade,
    )  # fmt: skip
    assert torch.equal(refined.blocks, whose["blocks"][here])


@pytest.mark.parametrize("parts", [False, True])
def test_what_moves_beyond_the_grid_of_our_small_file_while_it_is_refined_is_stored(
    parts, tmp_path
):
    """Cells are as small as the farthest Gaussian allows, and then a rate throws it outward."""
    rates = replace(Settings().rates, means=0.1, means_final=0.1)
    of = {"coder": "small", "code": CodeSettings(position=1e-6), "rates": rates,
          "refine": RefineSettings(iterations=10, walls=10.0, parts=parts)}  # fmt: skip
    model = fit("stitchgs", run(tmp_path), **of)
    assert same(model, fit("stitchgs", run(tmp_path), **of))  # read again from what is there
    assert model.packed is not None


@pytest.mark.parametrize("row", ["blockgaussian", "stitchgs", "odbp+stitch"])
def test_one_block_is_plain_3dgs(row):
    extra = BARE | {"blocks": 1, "sampling": "uniform"}
    city = fit(row, run(), **extra)
    plain = METHODS["3dgs"].fit(SCENE, Settings(**SHORT), run())
    for name in FIELDS:
        assert torch.equal(getattr(city.model, name), getattr(baked(plain), name))
    assert not city.blocks.any()


def test_stitching_keeps_every_core_and_some_of_the_rims(tmp_path):
    hard, soft = (
        fit(
            "stitchgs",
            run(tmp_path / merge, cache=tmp_path / "cache"),
            merge=merge,
            stitch=StitchSettings(sharpness=0.0),
            **BARE,
        )
        for merge in ("hard", "sis")
    )
    for block in (0, 1):
        core = [model.model.means[(model.blocks == block) & (model.distances <= 1)]
                for model in (hard, soft)]  # fmt: skip
        assert torch.equal(*core)
    assert not bool((hard.distances > 1).any())
    assert bool((soft.distances > 1).any())


def test_cores_that_overlap_keep_more_and_the_record_says_how_much(tmp_path):
    def merged(merge: str, overlap: float) -> CityModel:
        at = run(tmp_path / f"{merge}{overlap}", cache=tmp_path / "cache")
        return fit("stitchgs", at, merge=merge, overlap=overlap, **BARE)

    hard, wide, competing = (merged(*of) for of in (("hard", 0.0), ("hard", 0.3), ("sis", 0.3)))
    assert over_hard_cut(hard.block_facts) == {"over_hard_cut": 1.0}
    growth = wide.primitives / hard.primitives
    assert growth > 1
    assert over_hard_cut(wide.block_facts)["over_hard_cut"] == pytest.approx(growth)
    assert 1 < float(wide.distances.max()) <= 1.3
    # what competes lies beyond the wider cores, all of which stay
    cores = [int((one.distances <= 1.3).sum()) for one in (wide, competing)]
    assert cores[0] == cores[1] == wide.primitives
    assert float(competing.distances.max()) <= 1.3 * RIM + 1e-6
    fading = merged("fade", 0.3)
    assert 1.1 < float(fading.distances.max()) < 1.3 * RIM
    assert bool(fading.model.opacity_logits.isfinite().all())
    with pytest.raises(UsageError, match="overlap"):
        METHODS["stitchgs"].settings(overlap=-0.1)


def test_stages_say_what_memory_they_took_and_who_did_not_say_it_is_not_guessed(tmp_path):
    more = {"coarse_iterations": 5} | BARE
    first = fit("stitchgs", run(tmp_path / "a", cache=tmp_path), **more)
    assert list(first.stage_peak_mb) == list(first.stage_seconds)
    assert min(first.stage_peak_mb.values()) > 50  # no interpreter with torch takes less
    (coarse,) = tmp_path.glob("coarse-*.safetensors")
    tensors, facts = read_tensors(coarse)
    again = fit("stitchgs", run(tmp_path / "b", cache=tmp_path), **more)
    assert again.stage_peak_mb["coarse"] >= facts["peak_mb"] > 50
    assert again.stage_peak_mb["blocks"] >= max(one.peak_mb for one in first.block_facts) > 50
    del facts["peak_mb"]
    write_tensors(coarse, tensors, facts)  # as earlier releases did
    older = fit("stitchgs", run(tmp_path / "c", cache=tmp_path), **more)
    assert set(older.stage_peak_mb) == set(older.stage_seconds) - {"coarse"}


def test_equal_blocks_are_trained_once_where_runs_share_a_cache(tmp_path):
    def forbidden(step: int, total: int, values: dict[str, float]) -> None:
        raise AssertionError("trained again")

    cache = tmp_path / "cache"
    first = fit("stitchgs", run(tmp_path / "a", cache=cache), merge="hard", **BARE)
    again = fit("stitchgs", run(tmp_path / "b", cache=cache, report=forbidden), **BARE)
    assert [facts.seconds for facts in again.block_facts] == [
        facts.seconds for facts in first.block_facts
    ]
    with pytest.raises(AssertionError, match="trained again"):
        fit("stitchgs", run(cache=cache, report=forbidden), sampling="uniform", **BARE)


def test_what_blocks_cost_is_told_wherever_they_were_trained(tmp_path):
    told: list[tuple[float, float]] = []

    def listening(name: str, **more):
        return run(tmp_path / name, on_elsewhere=lambda *at: told.append(at), **more)

    cache = tmp_path / "cache"
    first = fit("blockgaussian", listening("a", cache=cache), coarse_iterations=5)
    fit("blockgaussian", listening("b", cache=cache), coarse_iterations=5)
    apart = fit("blockgaussian", listening("c", engine="processes"), coarse_iterations=5)
    assert len(told) == 3
    here, shared, there = told
    blocks = sum(facts.cpu_seconds for facts in first.block_facts)
    assert here[0] == 0
    assert shared[0] > blocks > 0  # and the coarse model, which was there, too
    assert there[0] == pytest.approx(sum(facts.cpu_seconds for facts in apart.block_facts))
    assert there[1] == max(facts.peak_mb for facts in apart.block_facts) > 0


def test_a_run_whose_blocks_an_earlier_release_trained_goes_on(tmp_path, straight):
    with pytest.raises(Killed):
        fit("odbp+stitch", run(tmp_path, on_stage=killed_after("blocks")))
    stages = tmp_path / "checkpoint" / "city.json"
    told = json.loads(stages.read_text())
    del told["stages"]["blocks"]["elsewhere"]  # which it did not say
    stages.write_text(json.dumps(told))
    after = fit("odbp+stitch", run(tmp_path))
    assert torch.equal(after.model.means, straight.model.means)


class Killed(Exception):
    """Stands for a kill."""


def killed_after(name: str):
    def on_stage(stage: str, seconds: float) -> None:
        if stage == name:
            raise Killed

    return on_stage


def killed_at(share: float):
    def report(step: int, total: int, values: dict[str, float]) -> None:
        if step >= share * total:
            raise Killed

    return report


@pytest.fixture(scope="module")
def straight() -> CityModel:
    return fit("odbp+stitch", run())


KILLS: dict[str, dict[str, Any]] = {
    "partition": {"on_stage": killed_after("partition")},
    "a block's steps": {"report": killed_at(0.3)},
    "blocks": {"on_stage": killed_after("blocks")},
    "stitch": {"on_stage": killed_after("stitch")},
    "refinement's first steps": {"report": killed_at(0.7)},
    "last step": {"report": killed_at(1.0)},
    "refine": {"on_stage": killed_after("refine")},
    "compress": {"on_stage": killed_after("compress")},
}
"""In the order in which one run comes to them."""


def test_a_run_that_is_killed_wherever_it_comes_to_goes_on_to_the_same_model(tmp_path, straight):
    """One run that is killed eight times; eight runs, each killed once, take eight times as long."""
    at = run(tmp_path, checkpoint_seconds=0.0)
    for kill in KILLS.values():
        with pytest.raises(Killed):
            fit("odbp+stitch", replace(at, **kill))
    assert same(straight, fit("odbp+stitch", at))


@pytest.mark.slow
@pytest.mark.parametrize("kill", KILLS.values(), ids=KILLS)
def test_a_run_that_was_killed_anywhere_goes_on_to_the_same_model(tmp_path, kill, straight):
    at = run(tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit("odbp+stitch", replace(at, **kill))
    assert same(straight, fit("odbp+stitch", at))


def test_a_kill_in_the_coarse_model_is_continued(tmp_path):
    at = run(tmp_path, checkpoint_seconds=0.0)
    more = {"coarse_iterations": 20}
    with pytest.raises(Killed):
        fit("citygaussian", replace(at, report=killed_at(0.2)), **more)
    assert same(fit("citygaussian", run(), **more), fit("citygaussian", at, **more))


@pytest.mark.parametrize("stage", ["coarse", "blocks"])
def test_a_run_goes_on_whose_cache_was_emptied_meanwhile(tmp_path, stage):
    more = {"coarse_iterations": 5} | BARE
    at = run(tmp_path / "run", cache=tmp_path / "cache")
    with pytest.raises(Killed):
        fit("citygaussian", replace(at, on_stage=killed_after(stage)), **more)
    shutil.rmtree(tmp_path / "cache")
    assert same(fit("citygaussian", run(), **more), fit("citygaussian", at, **more))


def test_a_planted_light_is_told_and_taken_back_before_the_refinement(tmp_path):
    said: list[str] = []
    planted = {
        "planted": PlantSettings(light=0.4),
        "iterations": 150,
        "quantise": False,
        "merge": "hard",
    }
    plain, level = (
        fit(
            "stitchgs",
            run(tmp_path / str(on), cache=tmp_path / "cache", say=said.append),
            refine=RefineSettings(iterations=1, level=on),
            **planted,
        )
        for on in (False, True)
    )
    assert sum("which is the photos' level" in line for line in said) == 2
    errors = [
        sum(
            float((one.render(view).colour - view.load()).abs().mean())
            for view in SCENE.train_views
        )
        for one in (plain, level)
    ]
    assert errors[1] < 0.9 * errors[0]


PARTS = {"merge": "shares", "coder": "small", "coarse_iterations": 5,
         "refine": RefineSettings(iterations=60, parts=True, walls=0.2)}  # fmt: skip


@pytest.fixture(scope="module")
def in_parts() -> tuple[CityModel, list[tuple[int, int]]]:
    """The model of an undisturbed run, refined in parts, and the steps that were reported."""
    steps: list[tuple[int, int]] = []
    at = run(report=lambda step, total, values: steps.append((step, total)))
    return fit("odbp+stitch", at, **PARTS), steps


def test_a_refinement_in_parts_is_the_same_wherever_it_is_done_and_says_what_each_part_took(
    tmp_path, in_parts
):
    told: list[tuple[float, float]] = []
    here, steps = in_parts
    apart = run(tmp_path, engine="processes", on_elsewhere=lambda *at: told.append(at))
    there = fit("odbp+stitch", apart, **PARTS)
    assert same(here, there)
    assert all(block.refine_seconds > 0 for block in there.block_facts)
    ((seconds, peak),) = told
    spent = sum(block.cpu_seconds + block.refine_cpu_seconds for block in there.block_facts)
    assert seconds == pytest.approx(spent)
    assert peak >= max(block.peak_mb for block in there.block_facts)
    assert there.stage_peak_mb["blocks"] >= max(block.peak_mb for block in there.block_facts)
    assert there.stage_peak_mb["refine"] > 50
    assert steps[-1][0] == steps[-1][1]
    assert [step for step, _ in steps] == sorted(step for step, _ in steps)
    assert set(there.stage_cpu_seconds) == set(there.stage_seconds)
    for model in (here, there):  # what is done beside the parts, wherever these are refined
        assert 0 < model.refine_alone["seconds"] < model.stage_seconds["refine"]
        parts = sum(block.refine_cpu_seconds for block in model.block_facts)
        assert 0 < model.refine_alone["cpu_seconds"] < parts
    whole = fit(
        "odbp+stitch", run(), **PARTS | {"refine": RefineSettings(iterations=60, walls=0.2)}
    )
    assert not same(here, whole)
    assert whole.refine_alone == {}


@pytest.mark.parametrize("share", [0.9, pytest.param(0.97, marks=pytest.mark.slow)])
def test_a_kill_in_a_part_of_the_refinement_is_continued(tmp_path, share, in_parts):
    at = run(tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit("odbp+stitch", replace(at, report=killed_at(share)), **PARTS)
    assert (tmp_path / "checkpoint" / "refine" / "part-0").is_dir()
    assert same(in_parts[0], fit("odbp+stitch", at, **PARTS))
    assert not (tmp_path / "checkpoint" / "refine").exists()


def moved_after_training(folder: Path, where: dict[int, torch.Tensor]) -> Run:
    """A run that was killed after its blocks were trained, some of which then moved elsewhere."""
    with pytest.raises(Killed):
        fit("blockgaussian", run(folder, on_stage=killed_after("blocks")))
    for record in folder.glob("checkpoint/blocks/*/block.json"):
        block = json.loads(record.read_text())["facts"]["block"]
        if block in where:
            model = load_reconstruction(record.parent / "model")
            assert isinstance(model, ExplicitModel)
            means = where[block].float().repeat(model.primitives, 1)
            moved = replace(model, model=replace(model.model, means=means))
            save_model(moved, record.parent / "model", Origin(method="block"))
    return run(folder)


def test_a_block_that_loses_everything_at_the_merge_is_told(tmp_path):
    centres = [region.centre for region in fit("blockgaussian", run()).regions]
    told: list[str] = []
    at = moved_after_training(tmp_path, {1: centres[0]})
    model = fit("blockgaussian", replace(at, say=told.append))
    assert model.block_facts[0].kept == model.primitives > 0
    assert model.block_facts[1].kept == 0 < model.block_facts[1].primitives
    assert any("block 1: lost all" in line for line in told)


def test_blocks_that_all_lose_everything_are_refused(tmp_path):
    centres = [region.centre for region in fit("blockgaussian", run()).regions]
    at = moved_after_training(tmp_path, {0: centres[1], 1: centres[0]})
    with pytest.raises(DataError, match="all 2 blocks lost every primitive"):
        fit("blockgaussian", at)


@pytest.mark.parametrize("row", ["blockgaussian", "dpgs-partition"])
def test_points_without_tracks_are_refused_before_blocks_are_trained(monkeypatch, row):
    points = SCENE.points
    none = replace(points, track_starts=0 * points.track_starts, track_views=points.track_views[:0])
    monkeypatch.setattr(sys.modules[__name__], "SCENE", replace(SCENE, points=none))
    with pytest.raises(DataError, match=r"no training view sees .* 2 blocks .* the 0 observations"):
        fit(row, run())


def test_a_folder_of_another_run_is_refused(tmp_path):
    fit("blockgaussian", run(tmp_path))
    with pytest.raises(UsageError, match="differs: seed 0 before, 1 now"):
        fit("blockgaussian", run(tmp_path, seed=1))


def test_a_damaged_container_is_refused(tmp_path):
    model = fit("stitchgs", run())
    save_model(model, tmp_path, Origin(method="stitchgs"))
    path = tmp_path / CONTAINER
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DataError, match=CONTAINER):
        load_reconstruction(tmp_path)


@pytest.mark.parametrize(
    ("row", "blocks", "told"), [("odbp+stitch", 61, "61 blocks"), ("vastgaussian", 9, "8 cameras")]
)
def test_more_blocks_than_there_is_work_for_are_refused_before_a_coarse_model_is_trained(
    row, blocks, told
):
    def forbidden(step: int, total: int, values: dict[str, float]) -> None:
        raise AssertionError("trained")

    with pytest.raises(DataError, match=told):
        fit(row, run(report=forbidden), blocks=blocks, coarse_iterations=10)


def test_many_blocks_still_end_in_a_model(tmp_path):
    model = fit("odbp+stitch", run(tmp_path), blocks=7, **BARE)
    assert len(model.block_facts) == 7
    assert model.primitives == sum(facts.kept for facts in model.block_facts)
    for facts in model.block_facts:
        assert facts.primitives > 0 or facts.note


def test_what_cannot_fit_into_memory_is_refused_with_a_number_of_blocks(monkeypatch):
    monkeypatch.setattr("splatproof.methods.city.memory_plan.available_mb", lambda: 450.2)
    with pytest.raises(MissingError, match=r"450 MB are free; .*blocks") as refusal:
        fit("stitchgs", run())
    enough = int(str(refusal.value).split("at least ")[1].split()[0])
    assert enough > 2
    monkeypatch.setattr("splatproof.methods.city.memory_plan.available_mb", lambda: 100.0)
    with pytest.raises(MissingError, match="use smaller images"):
        fit("stitchgs", run())


@pytest.mark.parametrize(
    ("setting", "value"),
    [("blocks", 0), ("coarse_iterations", -1), ("iterations", 0)],
)
def test_settings_that_no_run_can_follow_are_refused(setting, value):
    with pytest.raises(UsageError, match=setting):
        METHODS["odbp+stitch"].settings(**{setting: value})


def test_still_ghosts_of_sparse_points_are_refused_for_they_would_stay_a_guess():
    with pytest.raises(UsageError, match="setting follow is False, expected True"):
        METHODS["dpgs-partition"].settings(follow=False)
    METHODS["dpgs-partition"].settings(follow=False, coarse_iterations=5)


@pytest.mark.parametrize("row", ["vastgaussian", "blockgaussian", "dpgs-partition", "odbp+stitch"])
def test_every_row_starts_from_a_coarse_model_where_one_is_asked_for(tmp_path, row):
    model = fit(row, run(tmp_path), coarse_iterations=5, **BARE)
    assert next(iter(model.stage_seconds)) == "coarse"
    assert model.primitives == sum(facts.kept for facts in model.block_facts)
    assert all(facts.kept > 0 for facts in model.block_facts)


def test_a_coarse_model_is_trained_once_where_runs_share_a_cache(tmp_path):
    def forbidden(step: int, total: int, values: dict[str, float]) -> None:
        assert step > 5, "coarse steps again"

    cache, more = tmp_path / "cache", {"coarse_iterations": 5} | BARE
    fit("blockgaussian", run(tmp_path / "a", cache=cache), **more)
    (coarse,) = cache.glob("coarse-*.safetensors")
    at = run(tmp_path / "b", cache=cache, report=forbidden)
    fit("dpgs-partition", at, **more)
    coarse.unlink()
    with pytest.raises(AssertionError, match="coarse steps again"):
        fit("odbp+stitch", replace(at, folder=tmp_path / "c"), **more)


def test_blocks_that_visit_their_views_equally_often_share_the_steps_by_their_views(tmp_path):
    model = fit("blockgaussian", run(tmp_path), even="visits")
    views, steps = zip(*((facts.views, facts.steps) for facts in model.block_facts), strict=True)
    assert sum(steps) == 2 * CITY["iterations"]
    for count, of in zip(steps, views, strict=True):
        assert count == pytest.approx(sum(steps) * of / sum(views), abs=1)


@pytest.mark.parametrize(
    ("wrong", "error", "told"),
    [
        ({"engine": "magic"}, UsageError, "engine 'magic'"), ({"workers": 0}, UsageError, "0 workers"),
        ({"engine": "ray"}, MissingError, r"pip install splatproof\[distributed\]"),
    ],
)  # fmt: skip
def test_engines_that_cannot_run_are_refused_before_a_coarse_model_is_trained(
    wrong, error, told, monkeypatch
):
    monkeypatch.setitem(sys.modules, "ray", None)

    def forbidden(step: int, total: int, values: dict[str, float]) -> None:
        raise AssertionError("trained")

    with pytest.raises(error, match=told):
        fit("citygaussian", run(report=forbidden, **wrong))


@pytest.mark.parametrize("merge", ["shares", "fade"])
def test_blocks_that_share_their_rims_are_one_model_with_both_sides_in_them(tmp_path, merge):
    at = run(tmp_path / merge, cache=tmp_path / "cache")
    model = fit("stitchgs", at, merge=merge, **BARE)
    if merge == "fade":  # draws may happen to keep none of so few
        assert bool((model.distances > 1).any())
    assert float(model.distances.max()) < RIM
    assert same(model, fit("stitchgs", run(cache=tmp_path / "cache"), merge=merge, **BARE))


@pytest.mark.parametrize("engine", ["inline", "processes"])
def test_what_blocks_say_of_their_training_is_in_the_record(engine):
    told: dict[str, str] = {}
    side = SideSettings(every=4, refiner="own", spiral=SpiralSettings(layers=1, views=3))
    up = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
    method = METHODS["dpgs-partition"]
    settings = method.settings(**(CITY | BARE | {"side": side}))
    method.fit(replace(SCENE, up=up), settings, run(engine=engine, on_fact=told.__setitem__))
    assert told["side views"] == "3 on 1 spirals, own"
    assert told["refiner"].startswith("out of domain: ")
    assert "side pixels trained on, round 0" in told
