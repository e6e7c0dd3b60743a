"""Decoupled appearance: no change at the start, images of any size, structure of the render itself."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.supervision.decoupled_appearance import (
    EMBEDDING,
    colour_map,
    decoupled_loss,
    drawn_network,
)
from splatproof.reference.supervision.losses import photometric

SEEDS = st.integers(0, 2**16)


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def network(seed: int = 0, last: float = 0.0) -> dict[str, Tensor]:
    made = drawn_network(torch.Generator().manual_seed(seed))
    made["last.weight"] = last * (drawn(*made["last.weight"].shape, seed=seed) - 0.5)
    return made


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 70), st.integers(1, 70), SEEDS)
def test_a_new_network_changes_nothing_in_images_of_any_size(height, width, seed):
    image, photo = drawn(height, width, 3, seed=seed), drawn(height, width, 3, seed=seed + 1)
    factors = colour_map(network(seed), image, drawn(EMBEDDING, seed=seed))
    assert torch.equal(factors, torch.ones(height, width, 3))
    assert_close(decoupled_loss(image, factors, photo), photometric(image, photo))


def test_factors_lie_between_none_and_twice_and_depend_on_the_photo():
    image, made = drawn(40, 50, 3), network(last=30.0)
    one, other = (colour_map(made, image, drawn(EMBEDDING, seed=seed)) for seed in (1, 2))
    assert bool((one > 0).all())
    assert bool((one < 2).all())
    assert float(one.std()) > 0.01
    assert not torch.equal(one, other)


def test_a_gain_is_learnt_by_colours_and_leaves_structure_to_the_render():
    image = 0.2 + 0.4 * drawn(20, 20, 3)
    photo = 1.5 * image
    right = decoupled_loss(image, torch.full((20, 20, 3), 1.5), photo)
    assert float(decoupled_loss(image, torch.full((20, 20, 3), 1.5), photo, dssim=0.0)) < 1e-6
    assert float(right) == pytest.approx(0.2 * float(photometric(image, photo, dssim=1.0)))
    assert float(right) < float(photometric(image, photo))


def test_pixels_that_do_not_count_do_not():
    image, photo = drawn(20, 20, 3), drawn(20, 20, 3, seed=1)
    mask = drawn(20, 20, seed=2) > 0.5
    spoilt = torch.where(mask[..., None], photo, 0.3)
    ones = torch.ones_like(image)
    assert_close(
        decoupled_loss(image, ones, photo, mask=mask),
        decoupled_loss(image, ones, spoilt, mask=mask),
    )


def test_every_tensor_and_the_render_get_a_gradient():
    made = {name: value.requires_grad_() for name, value in network(last=1.0).items()}
    image, embedding = drawn(40, 33, 3).requires_grad_(), drawn(EMBEDDING, seed=3).requires_grad_()
    loss = decoupled_loss(image, colour_map(made, image, embedding), drawn(40, 33, 3, seed=1))
    loss.backward()
    for name, value in (made | {"image": image, "embedding": embedding}).items():
        assert value.grad is not None, name
        assert bool(value.grad.isfinite().all()), name
        assert float(value.grad.abs().sum()) > 0, name
