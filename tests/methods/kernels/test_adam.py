"""The native Adam update against torch.optim.Adam in float64."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatproof.methods.kernels import adam

SHAPES = [(37, 3), (37,), (37, 15, 3), (37, 4)]
RATES = [1e-2, 3e-3, 1e-4, 5e-2]


def gradients(seed: int, step: int) -> list[torch.Tensor]:
    g = torch.Generator().manual_seed(100 * seed + step)
    return [torch.randn(shape, generator=g) * 10.0 ** (-2 * i) for i, shape in enumerate(SHAPES)]


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 100), steps=st.integers(1, 12))
def test_numbers_are_torchs(simd_level, seed, steps):
    start = gradients(seed, 0)
    truth = [torch.nn.Parameter(v.double()) for v in start]
    optimizer = torch.optim.Adam(
        [{"params": [p], "lr": rate} for p, rate in zip(truth, RATES, strict=True)], eps=1e-15
    )
    values = [v.clone() for v in start]
    first, second = ([torch.zeros_like(v) for v in start] for _ in range(2))
    for step in range(1, steps + 1):
        new = gradients(seed, step)
        for p, g in zip(truth, new, strict=True):
            p.grad = g.double()
        optimizer.step()
        adam.step(values, new, first, second, RATES, step)
    for value, p, rate, begun in zip(values, truth, RATES, start, strict=True):
        moved = (value.double() - begun.double()) - (p.detach() - begun.double())
        # float32 of the value, and 1e-6 of each step's length
        bound = torch.finfo(torch.float32).eps * begun.abs().double() * steps + 1e-6 * rate * steps
        assert bool((moved.abs() <= bound + 1e-12).all())
    assert torch.allclose(
        first[0].double(), optimizer.state[truth[0]]["exp_avg"], rtol=1e-5, atol=1e-6
    )
    assert torch.allclose(second[0].double(), optimizer.state[truth[0]]["exp_avg_sq"], rtol=1e-5)


def test_rows_that_are_not_chosen_stay(simd_level):
    rows = torch.rand(37, generator=torch.Generator().manual_seed(1)) < 0.5
    start, new = gradients(1, 0), gradients(1, 1)
    all_values, some_values = ([v.clone() for v in start] for _ in range(2))
    moments = [[torch.zeros_like(v) for v in start] for _ in range(4)]
    adam.step(all_values, new, moments[0], moments[1], RATES, 1)
    adam.step(some_values, new, moments[2], moments[3], RATES, 1, rows=rows)
    for i, begun in enumerate(start):
        assert torch.equal(some_values[i][~rows], begun[~rows])
        assert torch.equal(some_values[i][rows], all_values[i][rows])
        assert not moments[2][i][~rows].any()
        assert torch.equal(moments[3][i][rows], moments[1][i][rows])


def test_a_zero_gradient_moves_nothing():
    values = [torch.ones(5, 3)]
    adam.step(values, [torch.zeros(5, 3)], [torch.zeros(5, 3)], [torch.zeros(5, 3)], [0.1], 1)
    assert torch.equal(values[0], torch.ones(5, 3))


def test_nothing_is_fine():
    empty = [torch.zeros(0, 3)]
    adam.step(empty, empty, empty, empty, [0.1], 1)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("number", {"number": 0}),
        ("gradients", {"gradients": []}),
        (r"first\[0\]", {"first": [torch.zeros(4, 2)]}),
        (r"second\[0\]", {"second": [torch.zeros(4, 3, dtype=torch.float64)]}),
        (r"gradients\[0\]", {"gradients": [torch.zeros(3, 4).T]}),
    ],
)
def test_bad_arguments_are_refused_with_their_name(name, arguments):
    good = {key: [torch.zeros(4, 3)] for key in ("values", "gradients", "first", "second")}
    with pytest.raises(ValueError, match=name):
        adam.step(**({**good, "rates": [0.1], "number": 1} | arguments))
