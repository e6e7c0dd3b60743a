"""The native rasterizer against the float64 reference on random scenes, at every SIMD level."""

import inspect
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatproof import _ext
from splatproof.methods.kernels import rasterizer as native
from splatproof.reference.checks.agreement import compare_gradients, largest_error
from splatproof.reference.checks.discontinuities import discontinuity_pixels
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.types.render import RenderOutput
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene, random_scene

# Worst of six whole runs with different seeds at every SIMD level: colour 7e-7, alpha 8e-7, depth 3.0e-6,
# distance 3.4e-6 (of about 5 units), median depth 2.4e-7.
PIXEL_TOLERANCE = 2e-5
# Worst of the same runs: relative L2 6.2e-6 (opacities), 1 - cosine 1.1e-11 (means).
GRADIENT_TOLERANCE = 1e-4
NAMES = ("means", "quaternions", "scales", "opacities", "sh", "signed", "absolute", "background")
PICTURES = ("colour", "alpha", "depth", "distance", "median_depth")
SEEN = {"pixels": 0, "discontinuities": 0, "scenes": 0}


def run(rasterize, scene: GaussianScene, dtype: torch.dtype, weights, **options):
    """Pictures, and the gradients of a weighted sum of them by everything."""
    leaves = scene.arguments(dtype)
    probe = ScreenProbe.zeros(len(scene.means), leaves[0])
    background = torch.tensor([0.2, 0.5, 0.7], dtype=dtype, requires_grad=True)
    out: RenderOutput = rasterize(
        scene.camera, *leaves[:4], sh=leaves[4], background=background, probe=probe, **options
    )
    total = torch.zeros((), dtype=dtype)
    for name, weight in weights.items():
        picture = getattr(out, name)
        total = total + (picture * weight.to(dtype)).sum()
    total.backward()
    gradients = [leaf.grad for leaf in leaves]
    gradients += [probe.signed.grad, probe.absolute.grad, background.grad]
    return out, [torch.zeros(1) if g is None else g for g in gradients]


def cotangents(scene: GaussianScene, names, ignored, seed: int):
    """Random weights of each picture's pixels, zero at discontinuities."""
    g = torch.Generator().manual_seed(seed)
    height, width = scene.camera.height, scene.camera.width
    made = {}
    for name in names:
        shape = (height, width, 3) if name == "colour" else (height, width)
        weight = torch.randn(shape, generator=g)
        weight[ignored] = 0
        made[name] = weight
    return made


def assert_twins(
    scene: GaussianScene, names=PICTURES, *, seed: int = 0, count: bool = True, **options
):
    """Native pictures and gradients of `scene` agree with the reference's in float64."""
    ignored = discontinuity_pixels(
        scene.camera, *(v.double() for v in scene.arguments(torch.float32)[:4]),
        mode=options.get("mode", "classic"),
    )  # fmt: skip
    weights = cotangents(scene, names, ignored, seed)
    wanted = {"distance": "distance" in names, "median": "median_depth" in names} | options
    truth, true_gradients = run(reference.rasterize, scene, torch.float64, weights, **wanted)
    out, gradients = run(native.rasterize, scene, torch.float32, weights, **wanted)
    for name in names:
        error = largest_error(getattr(out, name), getattr(truth, name), ignore=ignored)
        assert error <= PIXEL_TOLERANCE, f"{name}: {error}"
    floor = 1e-6 * max(float(g.norm()) for g in true_gradients)
    for name, value, wanted_value in zip(NAMES, gradients, true_gradients, strict=True):
        agreement = compare_gradients(value, wanted_value, floor=floor)
        assert agreement.good(GRADIENT_TOLERANCE), f"{name}: {agreement}"
    torch.testing.assert_close(out.radii.double(), truth.radii, rtol=1e-5, atol=1e-4)
    if count:
        SEEN["pixels"] += ignored.numel()
        SEEN["discontinuities"] += int(ignored.sum())
        SEEN["scenes"] += 1
    return out, truth


def test_the_signature_is_the_references():
    assert str(inspect.signature(native.rasterize)) == str(inspect.signature(reference.rasterize))


@settings(
    max_examples=75, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    count=st.integers(0, 150),
    seed=st.integers(0, 2**20),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    degree=st.integers(0, 3),
    mode=st.sampled_from(["classic", "antialiased"]),
    names=st.sampled_from([PICTURES, ("colour",), ("colour", "alpha", "depth"), ("distance",)]),
)
def test_pictures_and_gradients_are_the_references(
    simd_level, count, seed, size, degree, mode, names
):
    scene = random_scene(count, seed, width=size[0], height=size[1], degree=degree)
    assert_twins(scene, names, seed=seed, mode=mode)


def test_few_pixels_are_at_discontinuities():
    for seed in range(20):  # so that the share means something when this test runs alone
        scene = random_scene(100, seed)
        ignored = discontinuity_pixels(
            scene.camera, *(v.double() for v in scene.arguments(torch.float32)[:4])
        )
        SEEN["pixels"] += ignored.numel()
        SEEN["discontinuities"] += int(ignored.sum())
    assert SEEN["discontinuities"] < 1e-3 * SEEN["pixels"], SEEN


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 6, 7, 8, 9, 15, 16, 17, 31, 32])
@pytest.mark.parametrize("names", [("colour",), ("colour", "depth", "distance", "alpha")])
@pytest.mark.parametrize("watched", [False, True])
def test_any_number_of_channels(simd_level, channels, names, watched):
    scene = random_scene(60, channels)
    g = torch.Generator().manual_seed(channels)
    values = torch.rand(60, channels, generator=g)
    weight = torch.randn(scene.camera.height, scene.camera.width, channels, generator=g)
    behind = torch.rand(channels, generator=g)
    results = []
    for rasterize, dtype in (
        (reference.rasterize, torch.float64),
        (native.rasterize, torch.float32),
    ):
        leaves = scene.arguments(dtype)
        colours = values.to(dtype).requires_grad_()
        probe = ScreenProbe.zeros(60, leaves[0]) if watched else None
        out = rasterize(
            scene.camera, *leaves[:4], colours=colours, background=behind.to(dtype),
            distance="distance" in names, probe=probe,
        )  # fmt: skip
        total = (out.colour * weight.to(dtype)).sum()
        for name in names[1:]:
            total = total + (getattr(out, name) * weight[..., 0].to(dtype)).sum()
        total.backward()
        probes = [] if probe is None else [probe.signed, probe.absolute]
        results.append((out.colour, [leaf.grad for leaf in (*leaves[:4], colours, *probes)]))
    assert largest_error(results[1][0], results[0][0]) <= PIXEL_TOLERANCE
    for value, truth in zip(results[1][1], results[0][1], strict=True):
        assert value is not None
        assert truth is not None
        assert compare_gradients(value, truth).good(GRADIENT_TOLERANCE)


@pytest.mark.parametrize("channels", [1, 2, 3, 6])
def test_colours_alone_get_the_gradient_that_they_get_with_all(simd_level, channels):
    scene = random_scene(300, channels, width=50, height=40)
    g = torch.Generator().manual_seed(channels)
    values, weight = (
        torch.rand(300, channels, generator=g),
        torch.randn(40, 50, channels, generator=g),
    )
    found = []
    for every in (True, False):
        leaves = [
            leaf.detach().requires_grad_(every) for leaf in scene.arguments(torch.float32)[:4]
        ]
        colours = values.clone().requires_grad_()
        out = native.rasterize(scene.camera, *leaves, colours=colours)
        (out.colour * weight).sum().backward()
        assert colours.grad is not None
        found.append(colours.grad)
    assert torch.equal(*found)


@pytest.mark.parametrize("k", [1, 3, 8])
def test_strongest_contributors_are_the_references(simd_level, k):
    scene = random_scene(80, 7)
    truth = reference.rasterize(
        scene.camera, *scene.arguments(torch.float64)[:4], sh=scene.sh.double(), contributors=k
    )
    out = native.rasterize(
        scene.camera, *scene.arguments(torch.float32)[:4], sh=scene.sh, contributors=k
    )
    assert out.contributor_ids is not None
    assert out.contributor_weights is not None
    assert truth.contributor_ids is not None
    assert truth.contributor_weights is not None
    # equal weights up to rounding may change places; the weights themselves agree
    assert largest_error(out.contributor_weights, truth.contributor_weights) < PIXEL_TOLERANCE
    assert (out.contributor_ids != truth.contributor_ids).double().mean() < 0.01


@pytest.mark.parametrize("threads", [2, 3])
def test_bits_do_not_depend_on_threads(simd_level, threads):
    scene = random_scene(700, 3, width=90, height=70)
    names = ("colour", "depth")
    weights = cotangents(scene, names, torch.zeros(70, 90, dtype=torch.bool), 1)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one, one_gradients = run(native.rasterize, scene, torch.float32, weights)
        torch.set_num_threads(threads)
        many, many_gradients = run(native.rasterize, scene, torch.float32, weights)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(one.colour, many.colour)
    assert torch.equal(one.depth, many.depth)
    for a, b in zip(one_gradients[:-1], many_gradients[:-1], strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("names", [("colour",), ("colour", "alpha", "depth")])
def test_tiles_with_more_gaussians_than_are_prepared_at_once(simd_level, names):
    """Pixels see hundreds of faint Gaussians, and fill up behind two opaque ones in some places only."""
    scene = random_scene(900, 4, width=23, height=19)
    faint = 0.005 + 0.04 * scene.opacities
    opacities = torch.where(torch.arange(900) % 90 == 0, torch.tensor(0.98), faint)
    assert_twins(replace(scene, opacities=opacities, scales=2 * scene.scales), names, seed=4)


@pytest.mark.parametrize("threads", [2, 3])
def test_many_gaussians_are_sorted_alike_by_any_number_of_threads(threads):
    """The sort shares out its work from 16384 on; a fifth of these depths is equal."""
    scene = random_scene(70_000, 3, width=40, height=30)
    means = torch.where(torch.arange(70_000)[:, None] % 5 == 0, scene.means[:1], scene.means)
    arguments = (means, *(t.detach() for t in scene.arguments(torch.float32)[1:4]))
    before = torch.get_num_threads()
    pictures = []
    try:
        for count in (1, threads):
            torch.set_num_threads(count)
            out = native.rasterize(scene.camera, *arguments, sh=scene.sh, contributors=4)
            pictures.append(out)
    finally:
        torch.set_num_threads(before)
    one, many = pictures
    assert torch.equal(one.colour, many.colour)
    assert one.contributor_ids is not None
    assert many.contributor_ids is not None
    assert torch.equal(one.contributor_ids, many.contributor_ids)


def test_exp2_is_within_its_stated_error(simd_level):
    x = torch.linspace(-100, 0, 1_000_003)
    y = torch.empty_like(x)
    _ext.exp2(x, y)
    truth = torch.exp2(x.double())
    assert float(((y.double() - truth) / truth).abs().max()) < 2.5e-7
    assert y[-1] == 1


PLANTED = {
    "sign": lambda g: -g,
    "scale": lambda g: 1.01 * g,
    "axis": lambda g: g[:, [1, 0, 2]],
    "nan": lambda g: g.index_put((torch.tensor(0), torch.tensor(0)), torch.tensor(float("nan"))),
}


@pytest.mark.parametrize("error", PLANTED)
def test_planted_gradient_errors_are_seen(error):
    scene = random_scene(60, 5)
    weights = cotangents(scene, ("colour",), torch.zeros(21, 33, dtype=torch.bool), 1)
    _, truth = run(reference.rasterize, scene, torch.float64, weights)
    _, value = run(native.rasterize, scene, torch.float32, weights)
    assert compare_gradients(value[0], truth[0]).good()
    assert not compare_gradients(PLANTED[error](value[0]), truth[0]).good()


@pytest.mark.parametrize("error", ["lost", "shifted", "nan"])
def test_planted_image_errors_are_seen(error):
    scene = random_scene(60, 5)
    truth = reference.rasterize(
        scene.camera, *scene.arguments(torch.float64)[:4], sh=scene.sh.double()
    )
    planted = scene.but(opacities=scene.opacities.clone())
    if error == "lost":
        planted.opacities[int(truth.radii.argmax())] = 0
    image = native.rasterize(
        planted.camera, *planted.arguments(torch.float32)[:4], sh=scene.sh
    ).colour.clone()
    if error == "shifted":
        image = image.roll(1, dims=1)
    if error == "nan":
        image[3, 4, 1] = float("nan")
    assert largest_error(image, truth.colour) > PIXEL_TOLERANCE


def test_values_are_told_from_gradients_of_no_one():
    """Without anything to differentiate, the render is the same and no graph is kept."""
    scene = random_scene(50, 2)
    values = [v.detach() for v in scene.arguments(torch.float32)]
    out = native.rasterize(scene.camera, *values[:4], sh=values[4])
    assert not out.colour.requires_grad
    again = native.rasterize(
        scene.camera, *scene.arguments(torch.float32)[:4], sh=scene.sh.requires_grad_()
    )
    assert torch.equal(out.colour, again.colour.detach())


@pytest.mark.parametrize("lit", [0, 1, 15, 16, 17, 40, 60])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_harmonics_of_the_first_and_colours_of_the_others(simd_level, lit, degree):
    scene = random_scene(60, lit, degree=degree)
    g = torch.Generator().manual_seed(lit)
    colours, weight = torch.rand(60 - lit, 3, generator=g), None
    found = []
    ignored = discontinuity_pixels(
        scene.camera, *(v.double() for v in scene.arguments(torch.float32)[:4])
    )
    for rasterize, dtype in (
        (reference.rasterize, torch.float64),
        (native.rasterize, torch.float32),
    ):
        *leaves, sh = scene.arguments(dtype)
        first = sh.detach()[:lit].clone().requires_grad_()
        others = colours.to(dtype).requires_grad_()
        drawn = rasterize(scene.camera, *leaves, sh=first, colours=others)
        if weight is None:
            weight = torch.randn(drawn.colour.shape, generator=g)
            weight[ignored] = 0
        (drawn.colour * weight.to(dtype)).sum().backward()
        by_none = torch.zeros(1, dtype=dtype)
        found.append((drawn.colour, [by_none if t.grad is None else t.grad
                                     for t in (*leaves, first, others)]))  # fmt: skip
    (truth, wanted), (colour, gradients) = found
    assert largest_error(colour, truth, ignore=ignored) <= PIXEL_TOLERANCE
    floor = 1e-6 * max(float(by.norm()) for by in wanted)
    for name, value, exact in zip((*NAMES[:5], "colours"), gradients, wanted, strict=True):
        assert compare_gradients(value, exact, floor=floor).good(GRADIENT_TOLERANCE), name


@pytest.mark.parametrize(("lit", "plain", "channels"), [(2, 2, 3), (1, 1, 3), (1, 2, 4), (4, 0, 3)])
def test_harmonics_and_colours_that_do_not_add_up_are_refused(lit, plain, channels):
    scene = random_scene(3, 0)
    *leaves, sh = scene.arguments(torch.float32)
    with pytest.raises(ValueError, match="shape"):
        native.rasterize(
            scene.camera, *leaves, sh=sh.repeat(2, 1, 1)[:lit], colours=torch.rand(plain, channels)
        )


def test_gradients_by_a_distance_that_was_not_drawn_are_refused():
    scene = random_scene(5, 0)
    parts: list[Any] = [t.detach() for t in scene.arguments(torch.float32)[:4]]
    parts += [torch.zeros(5, 3), None, 0, False, False]
    model = _ext.Model(*parts)
    flat = [torch.zeros(scene.camera.height, scene.camera.width) for _ in range(4)]
    wanted: list[Any] = [None, flat[0][..., None].repeat(1, 1, 3), *flat[:2], torch.zeros(5)]
    state = _ext.render(model, *native.native_camera(scene.camera), *wanted, *[None] * 5)
    given: list[Any] = [None, *flat[:3], None, None, None, flat[3], *[None] * 9]
    with pytest.raises(ValueError, match="a picture without it"):
        _ext.render_backward(state, model, *given)


AGAIN = ("means", "quaternions", "scales", "opacities")


@pytest.mark.parametrize("channels", [1, 2, 3, 6])
@pytest.mark.parametrize("first", [3, 6])
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_other_colours_of_what_was_drawn_are_those_of_a_new_picture(
    simd_level, channels, first, mode
):
    """More Gaussians than a chunk has, some opaque, so that blocks end early."""
    scene = random_scene(900, channels, width=50, height=40)
    opacities = torch.where(torch.arange(900) % 9 == 0, torch.tensor(0.99), 0.3 * scene.opacities)
    scene = replace(scene, opacities=opacities)
    g = torch.Generator().manual_seed(channels)
    values, weight = (
        torch.rand(900, channels, generator=g),
        torch.randn(40, 50, channels, generator=g),
    )
    found = []
    for fresh in (True, False):
        leaves = [leaf.detach().requires_grad_() for leaf in scene.arguments(torch.float32)[:4]]
        drawn = native.rasterize(
            scene.camera, *leaves, colours=torch.rand(900, first, generator=g), mode=mode
        )
        colours = values.clone().requires_grad_()
        fixed = leaves[0], leaves[1].detach(), leaves[2].detach(), leaves[3]
        draw = (
            partial(native.rasterize, mode=mode)
            if fresh
            else partial(native.rasterize_again, drawn)
        )
        out = draw(scene.camera, *fixed, colours=colours)
        (out.colour * weight).sum().backward()
        assert leaves[1].grad is None
        found.append(
            [out.colour, out.alpha, out.depth, leaves[0].grad, leaves[3].grad, colours.grad]
        )
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)


def test_nothing_can_be_drawn_again():
    scene = random_scene(30, 1)
    none = [leaf[:0].detach() for leaf in scene.arguments(torch.float32)[:4]]
    colours = torch.zeros(0, 3, requires_grad=True)
    drawn = native.rasterize(scene.camera, *none, colours=colours)
    again = native.rasterize_again(drawn, scene.camera, *none, colours=torch.zeros(0, 1))
    assert again.colour.shape == (*drawn.alpha.shape, 1)
    assert not again.colour.any()


def test_only_what_was_drawn_is_drawn_again():
    scene = random_scene(30, 1)
    leaves = dict(zip(AGAIN, scene.arguments(torch.float32)[:4], strict=True))
    colours = torch.rand(30, 3, generator=torch.Generator().manual_seed(2))
    drawn = native.rasterize(scene.camera, *leaves.values(), colours=colours)
    with pytest.raises(ValueError, match="camera is not the one"):
        native.rasterize_again(drawn, replace(scene.camera), *leaves.values(), colours=colours)
    for name in AGAIN:
        other = {**leaves, name: leaves[name].clone()}
        with pytest.raises(ValueError, match=f"{name} is not the tensor"):
            native.rasterize_again(drawn, scene.camera, *other.values(), colours=colours)
    with torch.no_grad():
        still = native.rasterize(scene.camera, *leaves.values(), colours=colours)
    with pytest.raises(ValueError, match="has a gradient"):
        native.rasterize_again(still, scene.camera, *leaves.values(), colours=colours)
