"""The native photometric loss against the reference in float64, value and gradient."""

import inspect

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatproof.methods.kernels import loss as native
from splatproof.reference.checks.agreement import compare_gradients
from splatproof.reference.supervision import losses as reference

# Worst of six whole runs with different seeds at every SIMD level: value 2.1e-7, relative L2 of the gradient
# 1.3e-6. A single window may lose more: SSIM subtracts squares of order 1 and divides by C2 = 9e-4.
VALUE = 3e-6
GRADIENT = 1e-4


def pair(height: int, width: int, channels: int, seed: int):
    """A photo with structure, and a render that is near it here and far there."""
    g = torch.Generator().manual_seed(seed)
    x = torch.linspace(0, 9, width)[None, :, None] + torch.rand(channels, generator=g)
    truth = 0.5 + 0.4 * torch.sin(x + torch.linspace(0, 5, height)[:, None, None])
    image = truth + 0.2 * torch.randn(height, width, channels, generator=g)
    mask = torch.rand(height, width, generator=g) < 0.8
    return image, truth, mask


def both(image, truth, mask, dssim, scale=1.0):
    results = []
    for photometric, dtype in (
        (reference.photometric, torch.float64),
        (native.photometric, torch.float32),
    ):
        leaf = image.to(dtype).clone().requires_grad_()
        value = photometric(leaf, truth.to(dtype), dssim=dssim, mask=mask)
        (scale * value).backward()
        results.append((value, leaf.grad))
    return results


def test_the_signature_is_the_references():
    twins = (native.photometric, reference.photometric)
    assert len({str(inspect.signature(f)) for f in twins}) == 1


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    channels=st.sampled_from([1, 3, 4]),
    seed=st.integers(0, 1000),
    dssim=st.sampled_from([0.0, 0.2, 1.0]),
    masked=st.booleans(),
)
def test_value_and_gradient_are_the_references(simd_level, size, channels, seed, dssim, masked):
    image, truth, mask = pair(size[0], size[1], channels, seed)
    (true, true_gradient), (value, gradient) = both(
        image, truth, mask if masked else None, dssim, scale=2.5
    )
    assert abs(float(value.detach()) - float(true.detach())) < VALUE
    assert compare_gradients(gradient, true_gradient).good(GRADIENT)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(("width", "channels"), [(107, 3), (321, 1), (230, 3), (90, 4)])
def test_images_wider_than_a_strip(simd_level, width, channels, masked):
    """Kernels work in strips of 320 floats; what lies left and right of one is in its windows."""
    image, truth, mask = pair(14, width, channels, 5)
    (true, true_gradient), (value, gradient) = both(image, truth, mask if masked else None, 0.2)
    assert abs(float(value.detach()) - float(true.detach())) < VALUE
    assert compare_gradients(gradient, true_gradient).good(GRADIENT)
    with torch.no_grad():  # without a gradient the same value
        assert native.photometric(image, truth, mask=mask if masked else None) == value


def test_equal_images_have_no_loss(simd_level):
    _, truth, _ = pair(20, 30, 3, 1)
    assert abs(float(native.photometric(truth, truth))) < 1e-6


def test_no_valid_pixel_is_no_loss(simd_level):
    image, truth, mask = pair(20, 30, 3, 1)
    (_, _), (value, gradient) = both(image, truth, torch.zeros_like(mask), 0.2)
    assert float(value.detach()) == 0
    assert not gradient.any()


@pytest.mark.parametrize("threads", [2, 3, 5])
def test_bits_do_not_depend_on_threads(threads):
    image, truth, mask = pair(47, 61, 3, 1)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = both(image, truth, mask, 0.2)[1]
        torch.set_num_threads(threads)
        many = both(image, truth, mask, 0.2)[1]
    finally:
        torch.set_num_threads(before)
    assert torch.equal(one[0], many[0])
    assert torch.equal(one[1], many[1])


@pytest.mark.parametrize("planted", [lambda g: -g, lambda g: 1.01 * g, lambda g: g.roll(1, 1)])
def test_planted_errors_are_seen(planted):
    image, truth, mask = pair(20, 30, 3, 1)
    (_, true_gradient), (_, gradient) = both(image, truth, mask, 0.2)
    assert not compare_gradients(planted(gradient), true_gradient).good()


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("image", {"image": torch.zeros(4, 5, 3, dtype=torch.float64)}),
        ("image", {"image": torch.zeros(0, 5, 3)}),
        ("truth", {"truth": torch.zeros(4, 6, 3)}),
        ("truth", {"truth": torch.zeros(4, 5, 3, requires_grad=True)}),
        ("mask", {"mask": torch.zeros(4, 5)}),
    ],
)
def test_bad_arguments_are_refused_with_their_name(name, change):
    good = {"image": torch.zeros(4, 5, 3), "truth": torch.zeros(4, 5, 3)}
    function = getattr(native.photometric, "__wrapped__", native.photometric)
    with pytest.raises((ValueError, TypeError), match=name):
        function(**good | change)
