"""What is trained through is what the file gives back, and gradients pass as if nothing were rounded."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.sh_models import model
from splatproof.methods.models.gaussian_model import assemble
from splatproof.methods.storage.packed.coded_chunk import quantise, restore
from splatproof.methods.storage.packed.coded_writer import CodeSettings, chosen_steps
from splatproof.methods.storage.packed.rows import MemoryRows
from splatproof.methods.storage.packed.straight_through import rate, rounded, stored
from splatproof.reference.compression import quantisers
from splatproof.reference.compression.quantisers import Steps
from splatproof.reference.types.gaussians import Gaussians

SEEDS = st.integers(0, 2**16)


def rows_of(model: Gaussians) -> dict[str, torch.Tensor]:
    return {
        "means": model.means, "quaternions": model.quaternions, "log_scales": model.log_scales,
        "opacity_logits": model.opacity_logits, "sh_dc": model.sh[:, :1], "sh_rest": model.sh[:, 1:],
    }  # fmt: skip


def there_and_back(model: Gaussians, steps: Steps) -> Gaussians:
    corner = quantisers.cells(model.means.double().numpy(), steps.position).min(axis=0)
    return restore(quantise(model, steps, corner), steps, corner)


def drawn(seed: int) -> tuple[Gaussians, Steps]:
    whole = model(20, 2, seed)
    whole = replace(whole, means=whole.means / 1e3)
    steps = chosen_steps(MemoryRows(whole), CodeSettings())
    return there_and_back(whole, steps), steps  # so that w is the largest component


@settings(max_examples=30)
@given(seed=SEEDS)
def test_it_is_what_the_file_gives_back(seed):
    start, steps = drawn(seed)
    g = torch.Generator().manual_seed(seed)
    moved = {
        name: values + 0.01 * torch.randn(values.shape, generator=g)
        for name, values in vars(start).items()
    }
    moved["quaternions"] = start.quaternions * 1.5
    found = assemble(stored(rows_of(Gaussians(**moved)), steps), 2)
    want = there_and_back(Gaussians(**moved), steps)
    for name, values in vars(want).items():
        # float32's rounding; numbers half-way between two steps go either way, and are few
        off = (getattr(found, name) - values).abs() > 1e-5 * (1 + values.abs())
        assert int(off.sum()) <= 2, name
    again = there_and_back(found, steps)
    for name, values in vars(found).items():
        torch.testing.assert_close(getattr(again, name), values, rtol=1e-5, atol=1e-5)


@settings(max_examples=20)
@given(seed=SEEDS)
def test_gradients_pass_as_if_nothing_were_rounded(seed):
    start, steps = drawn(seed)
    rows = {name: values.clone().requires_grad_() for name, values in rows_of(start).items()}
    given_ = {name: torch.randn_like(values) for name, values in rows.items()}
    found = stored(rows, steps)
    whole = [(found[name] * given_[name]).sum() for name in rows]
    torch.stack(whole).sum().backward()
    for name in rows.keys() - {"quaternions"}:  # those are made of length 1 first
        torch.testing.assert_close(rows[name].grad, given_[name], rtol=1e-4, atol=1e-5)


def test_the_rate_is_0_without_colour_and_grows_with_it():
    start, steps = drawn(0)
    rows = rows_of(start)
    nothing = rows | {"sh_rest": torch.zeros_like(rows["sh_rest"])}
    assert float(rate(nothing, steps)) == 0
    rest = rows["sh_rest"].clone().requires_grad_()
    value = rate(rows | {"sh_rest": rest}, steps)
    twice = rate(rows | {"sh_rest": 2 * rest.detach()}, steps)
    assert 0 < float(value.detach()) < float(twice)
    finer = rate(rows, replace(steps, harmonics=steps.harmonics / 2))
    assert float(finer) == pytest.approx(float(twice), rel=1e-5)
    value.backward()
    assert rest.grad is not None
    assert (rest.grad * rest.detach()).sum() > 0


def test_rounding_is_to_the_nearest_multiple():
    assert rounded(torch.tensor([0.14, -0.16]), 0.1).tolist() == pytest.approx([0.1, -0.2])
