"""Rows, shared tensors and labels: what an edit reorders, with the moments, and what it never touches."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.training.optimizer import Adam, Momentum, adam_by_torch


def parameters(count: int = 5) -> Parameters:
    steps = torch.arange(float(count))
    return Parameters(
        {"means": steps[:, None].repeat(1, 3), "weights": steps},
        shared={"network": torch.arange(12.0).reshape(4, 3)},
        labels={"role": torch.arange(count)},
    )


@given(data=st.data(), count=st.integers(1, 8))
def test_an_edit_reorders_rows_labels_and_moments_together_and_nothing_else(data, count):
    of = parameters(count)
    adam = Adam(of)
    for name in of.rows:
        adam.first[name] += of.rows[name]
        adam.second[name] += 2 * of.rows[name]
    adam.first["network"] += 7
    parents = torch.tensor(data.draw(st.lists(st.integers(0, count - 1), min_size=1, max_size=12)))
    fresh = torch.tensor(data.draw(st.lists(st.booleans(), min_size=len(parents),
                                            max_size=len(parents))))  # fmt: skip
    edit = Edit(parents=parents, fresh=fresh)
    of.edit(edit)
    adam.edit(edit)
    want = parents.float()
    assert torch.equal(of.rows["weights"], want)
    assert torch.equal(of.rows["means"], want[:, None].repeat(1, 3))
    assert torch.equal(of.labels["role"], parents)
    assert torch.equal(adam.first["weights"], want.where(~fresh, 0))
    assert torch.equal(adam.second["means"][:, 0], (2 * want).where(~fresh, 0))
    assert torch.equal(of.shared["network"], torch.arange(12.0).reshape(4, 3))
    assert torch.equal(adam.first["network"], torch.full((4, 3), 7.0))


def test_an_edit_takes_new_values_and_forgets_moments_where_told():
    of = parameters()
    adam = Adam(of)
    adam.first["weights"] += 1
    adam.first["means"] += 1
    edit = Edit(values={"weights": torch.full((5,), 9.0)}, forget=frozenset({"weights"}))
    of.edit(edit)
    adam.edit(edit)
    assert torch.equal(of.rows["weights"], torch.full((5,), 9.0))
    assert not adam.first["weights"].any()
    assert adam.first["means"].all()


def test_labels_are_not_trained():
    assert set(parameters().trained) == {"means", "weights", "network"}


@pytest.mark.parametrize(
    "wrong",
    [
        {"rows": {"a": torch.zeros(3), "b": torch.zeros(2)}},
        {"rows": {"a": torch.zeros(3)}, "labels": {"b": torch.zeros(2)}},
        {"rows": {"a": torch.zeros(3)}, "shared": {"a": torch.zeros(2)}},
    ],
)
def test_tensors_that_do_not_fit_together_are_refused(wrong):
    with pytest.raises(ValueError, match="rows disagree|there twice"):
        Parameters(**wrong)


def test_state_comes_back():
    of, other = parameters(), parameters(2)
    other.restore(of.state())
    for name, value in of.state().items():
        assert torch.equal(other.state()[name], value)


@given(seed=st.integers(0, 99), number=st.integers(1, 2000))
def test_adam_of_other_devices_is_the_kernels_up_to_rounding(seed, number):
    generator = torch.Generator().manual_seed(seed)

    def draw() -> torch.Tensor:
        return torch.randn(50, 3, generator=generator)

    gradient, start = draw(), draw()
    first, second = 0.1 * draw(), 0.1 * draw().square()
    state = [[t.clone() for t in (start, gradient, first, second)] for _ in range(2)]
    from splatproof.methods.kernels import adam as kernels

    for update, of in zip((kernels.step, adam_by_torch), state, strict=True):
        update([of[0]], [of[1]], [of[2]], [of[3]], [0.01], number)
    # a handful of float32 roundings, of values up to 4 and steps up to 0.01 / (1 - 0.9)
    for mine, other in zip(*state, strict=True):
        torch.testing.assert_close(mine, other, atol=3e-6, rtol=1e-5)


def test_momentum_is_torchs_own():
    of = Parameters({"weights": torch.arange(4.0)})
    wanted = torch.arange(4.0).requires_grad_()
    mine, torchs = Momentum(of), torch.optim.SGD([wanted], lr=0.1, momentum=0.9)
    for step in range(5):
        of.rows["weights"].grad = torch.full((4,), float(step))
        wanted.grad = torch.full((4,), float(step))
        mine.step({"weights": 0.1})
        torchs.step()
        torch.testing.assert_close(of.rows["weights"].detach(), wanted.detach())
