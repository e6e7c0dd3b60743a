"""Growing and pruning: where anchors come to stand, what they take along, who has to go."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_drive import tiny_drive
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.contracts.run import Run
from splatproof.methods.hdgs.control import HdgsControl, alone
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.hdgs.fit import prepare
from splatproof.methods.hdgs.settings import Settings
from splatproof.methods.hdgs.start import cells_of

K = 4
SMALL = Settings(iterations=20, gaussians=K, features=6, instance=3, anchors=40)
DENSITY = HdgsDensity(temporal_gradient=0.0, drawn_share=0.0)


def control(**more) -> tuple[HdgsControl, Parameters]:
    """Control with statistics of nothing, and the parameters that it controls."""
    settings = replace(SMALL, density=replace(DENSITY, **more))
    model, plan = prepare(tiny_drive(), settings, Run(threads=1))
    assert isinstance(plan.density, HdgsControl)
    plan.density._clear(len(model.parameters), torch.device("cpu"))
    plan.density.visits += 1
    plan.density.opacity += K
    return plan.density, model.parameters


def edited(chosen: HdgsControl, parameters: Parameters) -> int:
    """Adjust once; number of rows before."""
    before = len(parameters)
    parameters.edit(chosen.adjust(parameters, torch.Generator().manual_seed(0)))
    return before


def pulled(chosen: HdgsControl, parameters: Parameters, row: int, away: float) -> None:
    """The Gaussians of one anchor stand `away` beside it, and are pulled at."""
    offsets = torch.zeros_like(parameters.rows["offsets2"])
    parameters.rows["offsets1"].zero_()
    offsets[row, :, 0] = away / parameters.rows["log_scales"][row, 0].exp()
    parameters.rows["offsets2"] = offsets
    chosen.drawn += 1
    chosen.gradient.reshape(-1, K)[row] = 1.0


def test_sparse_pulled_gaussians_get_one_anchor_in_the_middle_of_their_voxel():
    chosen, parameters = control(density=5.0)
    voxel = 2 * chosen.voxel
    pulled(chosen, parameters, 3, 50 * voxel)  # K of them, fewer than 5, all at one place
    target = parameters.labels["centres"][3] + torch.tensor([50 * voxel, 0, 0])
    before = edited(chosen, parameters)
    assert len(parameters) == before + 1
    new = parameters.labels["centres"][-1]
    want = (cells_of(target[None], voxel)[0] + 0.5) * voxel
    torch.testing.assert_close(new, want.float(), atol=1e-4, rtol=1e-5)
    scale = parameters.rows["log_scales"][-1].exp()
    torch.testing.assert_close(scale, torch.full((3,), voxel), atol=0, rtol=1e-4)


@pytest.mark.parametrize(("growing", "edge"), [("adaptive", 1.0), ("uniform", 2.0)])
def test_crowded_ones_get_finer_anchors_unless_growing_is_uniform(growing, edge):
    chosen, parameters = control(density=2.0, growing=growing)
    pulled(chosen, parameters, 3, 100 * chosen.voxel)
    before = edited(chosen, parameters)
    assert len(parameters) == before + 1
    scale = parameters.rows["log_scales"][-1].exp()
    torch.testing.assert_close(scale, torch.full((3,), edge * chosen.voxel), atol=0, rtol=1e-4)


def test_a_new_anchor_takes_its_motion_and_features_from_the_one_that_asked():
    chosen, parameters = control()
    for name in ("velocities", "peaks", "log_spans", "instances", "features"):
        rows = parameters.rows[name]
        rows += torch.arange(len(rows)).reshape(-1, *[1] * (rows.ndim - 1)).float()
    pulled(chosen, parameters, 5, 50 * chosen.voxel)
    edited(chosen, parameters)
    for name in ("velocities", "peaks", "log_spans", "instances", "features"):
        rows = parameters.rows[name]
        assert torch.equal(rows[-1], rows[5]), name
    assert not torch.equal(parameters.rows["offsets2"][-1], parameters.rows["offsets2"][5])


def test_none_grows_without_a_pull_or_where_an_anchor_stands():
    chosen, parameters = control()
    pulled(chosen, parameters, 3, 0.0)
    assert edited(chosen, parameters) == len(parameters)
    chosen, parameters = control(gradient=2.0)
    pulled(chosen, parameters, 3, 50 * chosen.voxel)
    assert edited(chosen, parameters) == len(parameters)


def test_no_two_anchors_ever_share_a_voxel():
    chosen, parameters = control(gradient=0.0, density=3.0, temporal_gradient=1e-9)
    generator = torch.Generator().manual_seed(1)
    rows = parameters.rows
    for _ in range(3):
        chosen._clear(len(parameters), torch.device("cpu"))
        chosen.visits += 1
        chosen.opacity += K
        chosen.drawn += 1
        chosen.gradient += 1
        chosen.temporal += 1
        rows["offsets2"] = 9 * torch.randn(rows["offsets2"].shape, generator=generator)
        rows["velocities"] += 9 * torch.randn(rows["velocities"].shape, generator=generator)
        before = edited(chosen, parameters)
        assert len(parameters) > before
        cells = cells_of(parameters.labels["centres"], chosen.voxel)
        assert len(torch.unique(cells, dim=0)) == len(cells)


def test_growing_in_time_copies_an_anchor_along_its_path():
    chosen, parameters = control(temporal_gradient=1e-3, temporal_share=1.0)
    rows, centres = parameters.rows, parameters.labels["centres"]
    rows["velocities"][4] = torch.tensor([40.0, 0.0, 0.0])
    rows["log_spans"][4] = -2.5
    rows["peaks"][4] = 0.0
    chosen.temporal[4] = 1.0
    chosen.voxel = 0.01
    before = edited(chosen, parameters)
    assert len(parameters) == before + 1
    shift = rows["peaks"][-1] - rows["peaks"][4]
    span = rows["log_spans"][4].exp()
    torch.testing.assert_close(shift.abs(), span)
    period = chosen.sizes.period
    swing = period / (2 * torch.pi) * torch.sin(2 * torch.pi * shift / period)
    moved = parameters.labels["centres"][-1] - centres[4]
    torch.testing.assert_close(moved, swing * torch.tensor([40.0, 0.0, 0.0]), atol=1e-5, rtol=1e-4)


def test_nothing_grows_in_time_where_an_anchor_stands():
    """What does not move would be copied onto itself."""
    chosen, parameters = control(temporal_gradient=1e-3, temporal_share=1.0)
    parameters.rows["velocities"][4] = 0.0
    parameters.rows["log_spans"][4] = -2.5
    parameters.rows["peaks"][4] = 0.0
    chosen.temporal[4] = 1.0
    assert edited(chosen, parameters) == len(parameters)


def test_the_record_of_visits_goes_on():
    chosen, parameters = control()
    chosen.unvisited[:] = torch.arange(len(parameters)) % 5
    record = chosen.unvisited.tolist()
    pulled(chosen, parameters, 3, 50 * chosen.voxel)
    assert edited(chosen, parameters) == len(parameters) - 1
    assert chosen.unvisited.tolist() == [*record, 0]


def test_the_faint_and_the_unvisited_go_and_the_unvisited_only_where_asked():
    for unvisited, left in ((10, 2), (0, 1)):
        chosen, parameters = control(unvisited=unvisited)
        chosen.unvisited[7] = 2 * chosen.views + 1  # two passes at least
        chosen.unvisited[8] = 2 * chosen.views
        chosen.opacity[2] = 0.004 * K
        chosen.opacity[1], chosen.visits[1] = 0.0, 0.0  # never seen: nothing is known of it
        before, centres = len(parameters), parameters.labels["centres"]
        edited(chosen, parameters)
        gone = [
            row
            for row in range(before)
            if not (parameters.labels["centres"] == centres[row]).all(dim=1).any()
        ]
        assert gone == [2, 7][:left]


def test_one_anchor_stays_in_any_case():
    chosen, parameters = control()
    chosen.opacity.zero_()
    chosen.opacity[6] = 1e-3
    centres = parameters.labels["centres"]
    edited(chosen, parameters)
    assert torch.equal(parameters.labels["centres"], centres[6:7])


def test_what_a_view_says_is_counted_by_slot_and_by_anchor():
    chosen, parameters = control()
    count = len(parameters)
    chosen._clear(0, torch.device("cpu"))
    camera = tiny_drive().views[0].camera
    parameters.rows["peaks"].requires_grad_()
    parameters.rows["peaks"].grad = torch.zeros(count)
    parameters.rows["peaks"].grad[2] = -3.0
    rows = torch.tensor([2, 2, 5])
    seen = Observation(
        camera=camera, radii=torch.tensor([1.0, 0.0, 2.0]), opacities=torch.tensor([0.5, 0.25, 1]),
        signed=torch.tensor([[1.0, 0], [1, 0], [0, 2]]), absolute=None, rows=rows,
        slots=torch.tensor([2 * K, 2 * K + 1, 5 * K + 3]), decoded=torch.tensor([2, 5, 6]),
        count=count,
    )  # fmt: skip
    for _ in range(2):
        chosen.observe(seen)
    assert chosen.gradient[2 * K] == 2 * camera.width / 2
    assert chosen.gradient[2 * K + 1] == 0  # not drawn
    assert chosen.gradient[5 * K + 3] == 2 * camera.height
    assert chosen.drawn[2 * K : 2 * K + 2].tolist() == [2, 0]
    assert chosen.opacity[[2, 5, 6]].tolist() == [1.5, 2, 0]
    assert chosen.visits[[2, 5, 6, 0]].tolist() == [2, 2, 2, 0]
    assert chosen.unvisited[[2, 6, 0]].tolist() == [0, 0, 2]
    assert chosen.temporal[[2, 5]].tolist() == [6, 0]


@pytest.mark.parametrize("iterations", [10, 60, 300, 1500, 30_000])
def test_runs_of_any_length_adjust_several_times_and_stop(iterations):
    chosen = DENSITY.shrunk(iterations)
    steps = [
        s for s in range(1, iterations) if chosen.start < s < chosen.stop
        and (s - chosen.start) % chosen.interval == 0
    ]  # fmt: skip
    assert len(steps) >= min(4, iterations // 5)
    assert steps[-1] <= iterations / 2


def test_places_are_alone_in_a_free_voxel_first_come():
    places = torch.tensor([[0.1, 0, 0], [0.2, 0, 0], [1.5, 0, 0], [-0.1, 0, 0]])
    taken = torch.tensor([[1.1, 0.5, 0.5]])
    assert alone(places, taken, 1.0).tolist() == [True, False, False, True]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"interval": 0}, "density.interval is 0, expected >= 1"),
        ({"opacity": 2.0}, "density.opacity is 2.0, expected 0 to 1"),
        ({"gradient": -1.0}, "density.gradient is -1.0, expected >= 0"),
    ],
)
def test_settings_that_no_run_can_follow_are_refused(given, told):
    with pytest.raises(UsageError, match=told):
        HdgsDensity(**given)
