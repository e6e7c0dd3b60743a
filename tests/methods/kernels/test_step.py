"""The whole native training step against rasterizer, loss and autograd, and against the reference."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatproof.methods.kernels import rasterizer as native
from splatproof.methods.kernels.loss import photometric
from splatproof.methods.kernels.step import ViewGradients, observe
from splatproof.methods.models.gaussian_model import assemble
from splatproof.reference.checks.agreement import compare_gradients
from splatproof.reference.checks.discontinuities import discontinuity_pixels
from splatproof.reference.rasterizer import rasterize as reference
from splatproof.reference.rasterizer.screen_gradient import ScreenProbe
from splatproof.reference.supervision import losses
from splatproof.suites.hard_cases.gaussian_scenes import GaussianScene, random_scene

BACKGROUND = (0.2, 0.5, 0.7)
NATIVE_TOLERANCE = 1e-5
"""Of gradients against the autograd route, which rounds opacities and scales to float32 before it draws."""
TOLERANCE = 1e-4
"""The rasterizer's. Where one pixel sees 44 Gaussians that rounding alone is 2.6e-5 of the opacities' gradient;
SSIM at 1 x 1 pixels, where variances cancel, makes 1.3e-5 of the 2D gradient."""


def trained_tensors(scene: GaussianScene, seed: int) -> dict[str, torch.Tensor]:
    """The scene's Gaussians as they are trained, with quaternions of several lengths."""
    g = torch.Generator().manual_seed(seed)
    length = 0.5 + torch.rand(len(scene.means), 1, generator=g)
    return {
        "means": scene.means.clone(),
        "sh_dc": scene.sh[:, :1].clone(),
        "sh_rest": scene.sh[:, 1:].clone(),
        "opacity_logits": torch.logit(scene.opacities.clamp(1e-6, 1 - 1e-6)),
        "log_scales": scene.scales.log(),
        "quaternions": scene.quaternions * length,
    }


def photo(scene: GaussianScene, seed: int) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed + 1)
    return torch.rand(scene.camera.height, scene.camera.width, 3, generator=g)


def rounding_decides(scene: GaussianScene, tensors: dict[str, torch.Tensor], mode) -> torch.Tensor:
    """Pixels at which the reference jumps: whoever rounds otherwise draws another Gaussian there. Of one scene
    a single pixel was 2.5e-4 of the opacities' gradient."""
    exact = assemble({name: t.double() for name, t in tensors.items()}, 0)
    return discontinuity_pixels(
        scene.camera, exact.means, exact.quaternions, exact.scales, exact.opacities, mode=mode
    )


def by_autograd(rasterize, loss, dtype, scene, tensors, truth, *, degree, mode, mask, dssim):
    """Loss, gradients by the trained tensors and by the 2D means, radii."""
    leaves = {name: t.to(dtype, copy=True).requires_grad_() for name, t in tensors.items()}
    model = assemble(leaves, degree)
    probe = ScreenProbe.zeros(len(model), model.means)
    image = rasterize(
        scene.camera, model.means, model.quaternions, model.scales, model.opacities, sh=model.sh,
        background=torch.tensor(BACKGROUND, dtype=dtype), probe=probe, mode=mode,
    )  # fmt: skip
    value = loss(image.colour, truth.to(dtype), dssim=dssim, mask=mask)
    value.backward()
    gradients = {n: torch.zeros_like(t) if t.grad is None else t.grad for n, t in leaves.items()}
    assert probe.signed.grad is not None
    return float(value.detach()), gradients | {"screen": probe.signed.grad}, image.radii


def by_kernels(scene, tensors, truth, *, degree, mode, mask, dssim, own=None):
    step = (own or ViewGradients()).of(
        scene.camera, tensors, truth, degree=degree, background=torch.tensor(BACKGROUND), mask=mask,
        dssim=dssim, mode=mode,
    )  # fmt: skip
    gradients = {"sh_rest": torch.zeros_like(tensors["sh_rest"])} | step.gradients
    return step.loss, gradients | {"screen": step.screen}, step.radii


def assert_agree(got, truth, tolerance: float) -> None:
    assert got[0] == pytest.approx(truth[0], rel=1e-5, abs=1e-6)
    floor = 1e-4 * max(float(g.norm()) for g in truth[1].values())
    for name, gradient in truth[1].items():
        agreement = compare_gradients(got[1][name], gradient, floor=floor)
        assert agreement.good(tolerance), f"{name}: {agreement}"


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    count=st.integers(0, 120),
    seed=st.integers(0, 2**20),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    stored=st.integers(0, 3),
    lower=st.integers(0, 3),
    mode=st.sampled_from(["classic", "antialiased"]),
    masked=st.booleans(),
    dssim=st.sampled_from([0.0, 0.2, 1.0]),
)
def test_step_is_render_loss_and_autograd(
    simd_level, count, seed, size, stored, lower, mode, masked, dssim
):
    scene = random_scene(count, seed, width=size[0], height=size[1], degree=stored)
    tensors, truth = trained_tensors(scene, seed), photo(scene, seed)
    mask = truth[..., 0] < 0.7 if masked else None
    unsure = rounding_decides(scene, tensors, mode)
    if unsure.any():
        mask = ~unsure if mask is None else mask & ~unsure
    options = {"degree": max(0, stored - lower), "mode": mode, "mask": mask, "dssim": dssim}
    wanted = by_autograd(
        native.rasterize, photometric, torch.float32, scene, tensors, truth, **options
    )
    got = by_kernels(scene, tensors, truth, **options)
    assert_agree(got, wanted, TOLERANCE)
    torch.testing.assert_close(got[2], wanted[2], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_step_is_the_references(simd_level, seed, mode):
    scene = random_scene(80, seed)
    tensors, truth = trained_tensors(scene, seed), photo(scene, seed)
    options = {"degree": 3, "mode": mode, "mask": None, "dssim": 0.2}
    wanted = by_autograd(
        native.rasterize, photometric, torch.float32, scene, tensors, truth, **options
    )
    assert_agree(by_kernels(scene, tensors, truth, **options), wanted, NATIVE_TOLERANCE)
    wanted = by_autograd(
        reference.rasterize, losses.photometric, torch.float64, scene, tensors, truth, **options
    )
    assert_agree(by_kernels(scene, tensors, truth, **options), wanted, TOLERANCE)


@pytest.mark.parametrize("error", ["sign", "scale", "rest"])
def test_planted_errors_are_seen(error):
    scene = random_scene(60, 5)
    tensors, truth = trained_tensors(scene, 5), photo(scene, 5)
    options = {"degree": 3, "mode": "classic", "mask": None, "dssim": 0.2}
    wanted = by_autograd(
        native.rasterize, photometric, torch.float32, scene, tensors, truth, **options
    )
    got = by_kernels(scene, tensors, truth, **options)
    name = {"sign": "quaternions", "scale": "log_scales", "rest": "sh_rest"}[error]
    if error == "rest":
        got[1][name] = got[1][name].roll(1, dims=1)
    else:
        got[1][name] *= -1 if error == "sign" else 1.01
    with pytest.raises(AssertionError, match=name):
        assert_agree(got, wanted, TOLERANCE)


@pytest.mark.parametrize("threads", [2, 3])
def test_bits_depend_neither_on_threads_nor_on_what_memory_held(simd_level, threads):
    scene, other = random_scene(700, 3, width=90, height=70), random_scene(30, 1)
    tensors, truth = trained_tensors(scene, 3), photo(scene, 3)
    options = {"degree": 3, "mode": "classic", "mask": None, "dssim": 0.2}
    own = ViewGradients()
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = by_kernels(scene, tensors, truth, **options)
        torch.set_num_threads(threads)
        by_kernels(other, trained_tensors(other, 1), photo(other, 1), own=own, **options)
        for _ in range(2):
            again = by_kernels(scene, tensors, truth, own=own, **options)
            assert again[0] == one[0]
            assert torch.equal(again[2], one[2])
            for name, gradient in one[1].items():
                assert torch.equal(again[1][name], gradient), name
    finally:
        torch.set_num_threads(before)


def test_a_photo_that_is_not_finite_gives_a_loss_that_is_not_finite():
    scene = random_scene(20, 1)
    truth = torch.full_like(photo(scene, 1), torch.nan)
    assert not ViewGradients().of(scene.camera, trained_tensors(scene, 1), truth, degree=3).loss < 9


def test_what_the_kernels_cannot_read_is_named():
    scene = random_scene(20, 1)
    good, truth = trained_tensors(scene, 1), photo(scene, 1)

    def of(changed: dict[str, torch.Tensor], photo=truth):
        ViewGradients().of(scene.camera, good | changed, photo, degree=3)

    with pytest.raises(ValueError, match="log_scales is torch.float64"):
        of({"log_scales": good["log_scales"].double()})
    with pytest.raises(ValueError, match=r"quaternions is torch.float32 \(20, 3\)"):
        of({"quaternions": good["quaternions"][:, :3].contiguous()})
    with pytest.raises(ValueError, match="means is .*expected contiguous"):
        of({"means": good["means"].T.contiguous().T})
    with pytest.raises(ValueError, match="at degree 3"):
        of({"sh_rest": good["sh_rest"][:, :8].contiguous()})
    with pytest.raises(ValueError, match="colour missing or unknown"):
        of({"colour": good["means"]})
    with pytest.raises(ValueError, match="truth is torch.float32"):
        of({}, photo=truth[1:])


@given(seed=st.integers(0, 2**16), count=st.integers(0, 2000))
@settings(max_examples=15, deadline=None)
def test_observed_are_norms_of_gradients_in_half_images(seed, count):
    g = torch.Generator().manual_seed(seed)
    camera = random_scene(1, 1).camera
    screen, radii = torch.randn(count, 2, generator=g), torch.randn(count, generator=g)
    total, seen = torch.rand(count, generator=g), torch.rand(count, generator=g)
    half = torch.tensor([camera.width / 2, camera.height / 2])
    wanted = total + torch.where(radii > 0, (screen * half).norm(dim=1), 0)
    wanted_seen = seen + (radii > 0)
    observe(screen, radii, camera, total, seen)
    torch.testing.assert_close(total, wanted, rtol=1e-6, atol=1e-6)
    assert torch.equal(seen, wanted_seen)
