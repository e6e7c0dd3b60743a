"""Growing and pruning of anchors on cases that are worked out by hand."""

import math
from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera
from splatproof.base.errors import UsageError
from splatproof.methods.anchors.control import AnchorControl, AnchorDensity
from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.training.optimizer import Adam
from splatproof.reference.anchors import scaffold

K, VOXEL = 2, 0.25
"""Cells of 4, 1 and 0.25 units."""
EVERY = AnchorDensity(start=0, adjust_start=0, interval=10, least_interval=10, levels=3)


def parameters() -> Parameters:
    """Three anchors along x, 10 apart; the second slot of each stands 2 to the right of it."""
    offsets = torch.zeros(3, K, 3)
    offsets[:, 1, 0] = 2.0
    return Parameters(
        {
            "offsets": offsets,
            "features": torch.tensor([[-1.0, 2], [-3, 4], [-5, 6]]),
            "log_scales": torch.zeros(3, 6),
        },
        shared={"network": torch.ones(2)},
        labels={
            "centres": torch.tensor([[0.0, 0, 0], [10, 0, 0], [20, 0, 0]]),
            "levels": torch.full((3,), -1),
        },
    )


def control(settings: AnchorDensity = EVERY) -> AnchorControl:
    return AnchorControl(settings, iterations=30_000, voxel=VOXEL, extent=100.0, k=K)


def seen(slots: list[int], pull: list[float], opacity: float = 0.5, rows: int = 3) -> Observation:
    """One view in which slots are drawn, pulled at by so much in units of half the image."""
    where, index = camera(0), torch.tensor(slots)
    signed = torch.zeros(len(slots), 2)
    signed[:, 0] = torch.tensor(pull) / (where.width / 2)
    return Observation(
        camera=where, radii=torch.ones(len(slots)), opacities=torch.full((len(slots),), opacity),
        signed=signed, absolute=None, rows=index // K, slots=index, decoded=torch.arange(rows),
        count=rows,
    )  # fmt: skip


def adjusted(strategy: AnchorControl, model: Parameters, seed: int = 0) -> Edit:
    (edit,) = strategy.edits(10, model, torch.Generator().manual_seed(seed))
    return edit


def grown(pull: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Centres and levels of what one pulled slot (of the second anchor, at x = 12) asked for."""
    strategy, model = control(), parameters()
    for _ in range(9):
        strategy.observe(seen([3], [pull]))
    edit = adjusted(strategy, model, seed)
    assert edit.fresh is not None
    return edit.values["centres"][edit.fresh], edit.values["levels"][edit.fresh]


@pytest.mark.parametrize(("pull", "highest"), [(1.9e-4, -1), (3e-4, 0), (7e-4, 1), (9e-4, 2)])
def test_a_pull_grows_anchors_up_to_its_level(pull, highest):
    found = [grown(pull, seed) for seed in range(30)]
    levels = torch.cat([level for _, level in found])
    assert set(levels.tolist()) == set(range(highest + 1))  # half and more of the draws are heard
    for centres, level in found:
        for centre, one in zip(centres, level, strict=True):
            cell = VOXEL * 4 ** (2 - one)
            assert torch.equal(centre / cell, (centre / cell).round())
            assert abs(centre[0] - 12) <= cell / 2


def test_each_level_has_its_own_grid():
    """By a slot that is on none of the grids: no level's anchor stands where that of another does."""
    found = []
    for seed in range(12):  # each level is heard with a chance of a half and more
        strategy, model = control(), parameters()
        model.rows["log_scales"][:, :3] = math.log(2)
        model.rows["offsets"][1, 1] = torch.tensor([2.3, 0.55, -0.7]) / 2
        for _ in range(9):
            strategy.observe(seen([3], [9e-4]))
        edit = adjusted(strategy, model, seed)
        assert edit.fresh is not None
        new = (edit.values[name][edit.fresh] for name in ("levels", "centres", "log_scales"))
        found += zip(*new, strict=True)
    want = {0: [12.0, 0, 0], 1: [12.0, 1, -1], 2: [12.25, 0.5, -0.75]}
    assert {int(level) for level, _, _ in found} == want.keys()
    for level, centre, log_scales in found:
        assert centre.tolist() == want[int(level)]
        cell = torch.full((6,), VOXEL * 4.0 ** (2 - int(level)))
        torch.testing.assert_close(log_scales, cell.log())


def test_a_new_anchor_is_where_its_slot_is_with_the_feature_of_its_source():
    strategy, model = control(), parameters()
    for _ in range(9):
        strategy.observe(seen([0, 3, 4], [0.0, 3e-4, 0.0]))
    heard = next(s for s in range(30) if len(grown(3e-4, s)[0]))  # half of the draws are
    values = adjusted(strategy, model, heard).values
    assert values["centres"][:, 0].tolist() == [0, 10, 20, 12]
    assert values["features"][3].tolist() == [-3, 4]
    assert values["offsets"][3].abs().max() == 0
    torch.testing.assert_close(values["log_scales"][3], torch.full((6,), math.log(4.0)))


def test_no_anchor_where_one_is_and_no_twins():
    strategy, model = control(), parameters()
    model.rows["offsets"][:] = 0  # both slots of an anchor where it is itself
    model.labels["centres"][:, 0] = torch.tensor([0.0, 4, 8])  # cells of level 0 are 4 wide
    for _ in range(9):
        strategy.observe(seen([0, 1, 2, 3, 4, 5], [1.0] * 6))
    for seed in range(5):
        edit = adjusted(strategy, model, seed)
        assert len(edit.values["centres"]) == 3
    strategy = control()
    model.rows["offsets"][0] = torch.tensor([2.5, 0.5, 0.1])  # both slots in one empty cell
    for _ in range(9):
        strategy.observe(seen([0, 1], [1.0, 1.0]))
    for seed in range(10):
        centres = adjusted(strategy, model, seed).values["centres"]
        assert len(torch.unique(centres, dim=0)) == len(centres)


def test_slots_that_were_drawn_too_rarely_wait_and_keep_their_statistics():
    strategy, model = control(), parameters()
    for _ in range(4):  # 0.4 of an interval of 10 is not more than 0.4 of it
        strategy.observe(seen([3], [1.0]))
    edit = adjusted(strategy, model)
    assert len(edit.values["centres"]) == 3
    assert strategy.state()["drawn"].tolist() == [0, 0, 0, 4, 0, 0]
    assert strategy.state()["gradient"][3].item() == pytest.approx(4.0)
    strategy.observe(seen([3], [1.0]))
    edits = [adjusted(strategy, model)]
    assert len(edits[0].values["centres"]) > 3
    assert strategy.state()["drawn"].sum() == 0
    assert len(strategy.state()["drawn"]) == K * len(edits[0].values["centres"])


def test_what_was_not_drawn_asks_for_nothing_and_what_was_not_decoded_was_not_visited():
    strategy, view = control(), seen([2, 3, 5], [0.5, 1.0, 2.0])
    drawn = torch.tensor([1.0, 0.0, 1.0])  # the second is too faint or too far for any pixel
    strategy.observe(replace(view, radii=drawn, decoded=torch.tensor([1, 2])))
    state = strategy.state()
    assert state["gradient"].tolist() == pytest.approx([0, 0, 0.5, 0, 0, 2.0])
    assert state["drawn"].tolist() == [0, 0, 1, 0, 0, 1]
    assert state["visits"].tolist() == [0, 1, 1]
    assert state["opacity"].tolist() == [0, 1.0, 0.5]


def test_what_stays_transparent_goes_with_its_moments_and_the_rest_keeps_its_own():
    strategy, model = control(), parameters()
    optimizer = Adam(model)
    optimizer.first["features"] = torch.tensor([[1.0, 1], [2, 2], [3, 3]])
    optimizer.first["network"] = torch.tensor([7.0, 7])
    for _ in range(7):  # the middle one is decoded every time and shows nothing
        strategy.observe(seen([0, 4], [0.0, 0.0]))
    for _ in range(2):
        strategy.observe(seen([0, 4, 5], [0.0, 0.0, 1.0]))  # too rarely to ask yet
    edit = adjusted(strategy, model)
    model.edit(edit)
    optimizer.edit(edit)
    assert model.labels["centres"][:, 0].tolist() == [0, 20]
    assert model.rows["features"].tolist() == [[-1, 2], [-5, 6]]
    assert optimizer.first["features"].tolist() == [[1, 1], [3, 3]]
    assert optimizer.first["network"].tolist() == [7, 7]
    assert strategy.state()["visits"].tolist() == [0, 0]
    assert strategy.state()["drawn"].tolist() == [0, 0, 0, 2]
    assert strategy.state()["gradient"].tolist() == pytest.approx([0, 0, 0, 2.0])


def test_new_anchors_start_without_moments():
    strategy, model = control(), parameters()
    optimizer = Adam(model)
    optimizer.first["features"] = torch.tensor([[1.0, 1], [2, 2], [3, 3]])
    for _ in range(9):
        strategy.observe(seen([0, 2, 3, 4], [0.0, 0.0, 1.0, 0.0]))
    edit = adjusted(strategy, model)
    optimizer.edit(edit)
    assert len(optimizer.first["features"]) > 3
    assert optimizer.first["features"][:3].tolist() == [[1, 1], [2, 2], [3, 3]]
    assert optimizer.first["features"][3:].abs().max() == 0


def test_an_anchor_is_not_judged_before_it_was_seen_often_enough():
    strategy, model = control(), parameters()
    for _ in range(8):
        strategy.observe(seen([0, 4], [0.0, 0.0]))
    assert len(adjusted(strategy, model).values["centres"]) == 3
    assert strategy.state()["visits"].tolist() == [8, 8, 8]


def test_the_last_anchor_stays_and_scales_are_bounded():
    strategy, model = control(), parameters()
    model.rows["log_scales"][:] = 5.0
    for _ in range(9):
        strategy.observe(seen([2], [0.0], opacity=1e-4))
    edit = adjusted(strategy, model)
    assert edit.values["centres"].tolist() == [[10, 0, 0]]
    assert edit.values["log_scales"][0, 3:].tolist() == pytest.approx([math.log(20.0)] * 3)
    assert edit.values["log_scales"][0, :3].tolist() == [5, 5, 5]  # how far offsets reach


def test_steps_shrink_with_the_run():
    strategy = AnchorControl(AnchorDensity(), iterations=3000, voxel=1.0, extent=1.0, k=K)
    assert [step for step in (50, 51, 1499, 1500) if strategy.watches(step)] == [51, 1499]
    assert [s for s in range(3000) if strategy.adjusts(s)] == list(range(200, 1500, 100))


def test_statistics_are_restored():
    strategy, other = control(), control()
    for _ in range(9):
        strategy.observe(seen([1, 3], [1.0, 2.0]))
    other.restore(strategy.state())
    one, two = (adjusted(each, parameters()) for each in (strategy, other))
    assert all(torch.equal(one.values[name], two.values[name]) for name in one.values)


def test_by_the_reference_a_level_is_heard_more_often_the_finer_it_is():
    shares = []
    for level in range(3):
        draw = torch.linspace(0, 1, 1001)
        ones = torch.ones(1001)
        heard = scaffold.candidates(9 * ones, 9 * ones.long(), level, 1e-4, 4, draw)
        shares.append(float(heard.float().mean()))
    assert shares == pytest.approx([0.5, 0.75, 0.875], abs=0.002)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"coarsest": 4}, r"density.coarsest is 4, expected >= 16"),
        ({"interval": 0}, r"density.interval is 0, expected >= 1"),
        ({"drawn_share": 2.0}, r"density.drawn_share is 2.0, expected 0 to 1"),
        ({"largest_size": 0.0}, r"density.largest_size is 0.0, expected > 0"),
    ],
)
def test_settings_that_cannot_be_followed_are_refused(given, told):
    with pytest.raises(UsageError, match=told):
        AnchorDensity(**given)
