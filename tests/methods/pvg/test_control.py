"""Density control in time: who is split and cloned, where the children go, and what is kept."""

import math
from dataclasses import replace

import torch

from helpers.tiny_scene import camera, random_gaussians
from splatproof.methods.contracts.density_strategy import Observation
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.pvg.control import MovingControl
from splatproof.methods.pvg.settings import Motion, MovingDensity

MOTION = Motion()
DENSITY = MovingDensity(start=0, interval=5, least_interval=5, stop=100, reset_interval=0,
                        gradient=1.0, least_opacity=0.0)  # fmt: skip


def tensors(count: int = 6, span: float = 0.05) -> Parameters:
    one = random_gaussians(count)
    return Parameters({
        "means": one.means, "opacity_logits": one.opacity_logits, "log_scales": one.log_scales,
        "quaternions": one.quaternions, "peaks": torch.zeros(count),
        "log_spans": torch.full((count,), span).log(), "velocities": torch.ones(count, 3),
    })  # fmt: skip


def control(parameters: Parameters, density: MovingDensity = DENSITY) -> MovingControl:
    return MovingControl(
        density, iterations=30_000, extent=100.0, parameters=parameters, motion=MOTION
    )


def observe(of: MovingControl, by_peak: list[float], by_place: float = 0.0) -> None:
    count = len(by_peak)
    of.parameters.rows["peaks"].requires_grad_().grad = torch.tensor(by_peak)
    of.observe(
        Observation(
            camera=camera(0),
            radii=torch.ones(count),
            opacities=None,
            signed=torch.full((count, 2), by_place),
            absolute=None,
            rows=None,
            slots=None,
            count=count,
        )
    )


def apply(of: MovingControl, step: int = 5) -> list[torch.Tensor]:
    """Parents of every edit of a step, which is made."""
    generator, parents = torch.Generator().manual_seed(0), []
    for edit in of.edits(step, of.parameters, generator):
        of.parameters.edit(edit)
        assert edit.parents is not None
        parents.append(edit.parents)
    return parents


def test_long_lives_are_split_and_short_ones_cloned_by_the_gradient_of_their_peak():
    spans = torch.tensor([0.05, 0.05, 0.005, 0.005, 0.05, 0.05])
    parameters = tensors()
    parameters.rows["log_spans"] = spans.log()
    of = control(parameters)
    observe(of, [3e-3, 1e-3, -3e-3, 1e-3, -3e-3, 0.0])
    first, second = apply(of)
    assert first.tolist() == [0, 1, 2, 3, 4, 5]
    assert second.tolist() == [1, 2, 3, 5, 2, 0, 4, 0, 4]
    peaks = parameters.rows["peaks"]
    assert not peaks[:5].any()
    assert bool(peaks[5:].abs().min() > 0)
    torch.testing.assert_close(parameters.rows["log_spans"].exp(), spans[second])  # not yet shorter


def test_gradients_of_opposite_signs_cancel_and_the_mean_counts():
    of = control(tensors(3))
    observe(of, [5e-3, 5e-3, 1.5e-3])
    observe(of, [-5e-3, 1e-4, 1.5e-3])  # the last one's sum is above 2e-3, and its mean below
    _, second = apply(of)
    assert second.tolist() == [0, 2, 1, 1]


def test_later_three_children_live_shorter_and_start_without_moments():
    parameters = tensors(2)
    of = control(parameters)
    observe(of, [3e-3, 0.0])
    _, last = list(of.edits(50, parameters, torch.Generator().manual_seed(0)))
    assert last.parents is not None
    assert last.parents.tolist() == [1, 0, 0, 0]
    assert last.fresh is not None
    assert last.fresh.tolist() == [False, True, True, True]
    torch.testing.assert_close(
        last.values["log_spans"].exp(), torch.tensor([0.05, *[0.05 / 1.6] * 3])
    )


def test_children_of_a_split_follow_the_average_velocity_to_their_moments():
    parameters = tensors(1)
    start = parameters.rows["means"].clone()
    of = control(parameters)
    observe(of, [3e-3])
    apply(of)
    peaks, means = parameters.rows["peaks"], parameters.rows["means"]
    slow = math.exp(-0.05 / (2 * 0.2))
    torch.testing.assert_close(means, start + slow * peaks[:, None].expand(-1, 3))


def test_moments_of_children_are_spread_over_the_life_but_not_beyond_a_period():
    for span, wanted in ((0.05, 0.05), (math.inf, 0.2)):
        parameters = tensors(1)
        rows = {name: value.repeat(4000, *[1] * (value.ndim - 1))
                for name, value in parameters.rows.items()}  # fmt: skip
        rows["log_spans"] = torch.full((4000,), math.log(span))
        new = control(parameters).spread(
            rows, torch.arange(4000) >= 1000, torch.Generator().manual_seed(0)
        )
        assert not new["peaks"][:1000].any()
        deviation = float(new["peaks"][1000:].std())
        assert math.isclose(deviation, wanted, rel_tol=0.05)  # 4 standard errors


def test_what_is_split_in_space_is_spread_in_time_and_not_split_again():
    parameters = tensors(3)
    parameters.rows["log_scales"] = torch.full((3, 3), math.log(2.0))  # larger than 1 % of 100
    of = control(parameters, replace(DENSITY, gradient=0.5, largest_size=1.0))
    observe(of, [3e-3] * 3, by_place=0.1)
    (parents,) = apply(of)
    assert parents.tolist() == [0, 1, 2, 0, 1, 2]
    assert bool(parameters.rows["peaks"].abs().min() > 0)
    torch.testing.assert_close(parameters.rows["log_spans"].exp(), torch.full((6,), 0.05))


def test_clones_in_space_stay_at_their_moment():
    of = control(tensors(3), replace(DENSITY, gradient=0.5))
    observe(of, [0.0] * 3, by_place=0.1)
    (parents,) = apply(of)
    assert len(parents) == 6
    assert not of.parameters.rows["peaks"].any()


def test_never_more_than_asked_for():
    of = control(tensors(6), replace(DENSITY, most=9))
    observe(of, [3e-3] * 6)
    apply(of)
    assert len(of.parameters) <= 9
    full = control(tensors(6), replace(DENSITY, most=6))
    observe(full, [3e-3] * 6)
    apply(full)
    assert len(full.parameters) == 6


def test_growth_in_space_and_in_time_share_what_a_step_may_add():
    paced = replace(DENSITY, most=101, pace="even", gradient=0.5)
    for by_place, want in ((0.0, 8), (0.1, 11)):  # 19 densifications: (101 - 6) / 19 = 5 a step
        of = control(tensors(6), paced)
        observe(of, [3e-3] * 6, by_place=by_place)
        apply(of)
        assert len(of.parameters) == want  # in time two of six, as each may become three


def test_statistics_come_back_and_are_forgotten_after_a_densification():
    of = control(tensors(3))
    observe(of, [1e-3, 2e-3, 3e-3])
    again = control(tensors(3))
    again.restore(of.state())
    assert torch.equal(again.peak_sum, of.peak_sum)
    apply(of)
    assert not of.peak_sum.any()
    assert len(of.peak_sum) == len(of.parameters)


def test_without_an_observed_view_nothing_is_split():
    of = control(tensors(3))
    assert [parents.tolist() for parents in apply(of)] == [[0, 1, 2]]
