import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.layered_memory import depth_adaptation as adaptation
from splatproof.reference.layered_memory import layered_depth
from splatproof.reference.layered_memory.edge_diffusion import EdgeDiffusion
from splatproof.reference.types.camera import Camera

D = torch.float64


def camera(x: float = 0.0, scale: int = 2) -> Camera:
    pose = torch.eye(4, dtype=D)
    pose[0, 3] = -x
    intrinsics = torch.tensor(
        [[10.0 * scale, 0, 6 * scale], [0, 10.0 * scale, 4.5 * scale], [0, 0, 1]], dtype=D
    )
    return Camera(K=intrinsics, world_to_camera=pose, width=12 * scale, height=9 * scale)


def some_depths(n: int, seed: int) -> adaptation.SparseDepths:
    g = torch.Generator().manual_seed(seed)
    pixels = torch.randperm(24 * 18, generator=g)[:n]
    return adaptation.SparseDepths(
        rows=pixels // 24, columns=pixels % 24, depths=1 + torch.rand(n, generator=g, dtype=D)
    )


def prediction(seed: int) -> Tensor:
    return torch.rand(18, 24, generator=torch.Generator().manual_seed(seed), dtype=D)


@given(n=st.integers(2, 50), seed=st.integers(0, 2**16), a=st.floats(0.1, 50), b=st.floats(-5, 5))
def test_alignment_recovers_scale_and_shift(n, seed, a, b):
    clean, sparse = prediction(seed), some_depths(n, seed)
    depths = a * clean[sparse.rows, sparse.columns] + b
    sparse = adaptation.SparseDepths(rows=sparse.rows, columns=sparse.columns, depths=depths)
    got = adaptation.align(clean, sparse)
    assert [float(x) for x in got] == pytest.approx([a, b], abs=1e-6, rel=1e-6)


@given(n=st.integers(3, 50), seed=st.integers(0, 2**16))
def test_alignment_is_the_least_squares_line(n, seed):
    clean, sparse = prediction(seed), some_depths(n, seed)
    here = clean[sparse.rows, sparse.columns]
    design = torch.stack([here, torch.ones_like(here)], dim=1)
    want = torch.linalg.lstsq(design, sparse.depths).solution
    a, b = adaptation.align(clean, sparse)
    if torch.corrcoef(torch.stack([here, sparse.depths]))[0, 1] >= 0.3:
        assert_close(torch.stack([a, b]), want)
    else:  # the prediction knows nothing: the points' own range
        assert float(b) == float(sparse.depths.min())
        assert float(a) == pytest.approx(float(sparse.depths.max() - sparse.depths.min()))


@pytest.mark.parametrize("n", [0, 1])
def test_alignment_without_enough_points(n):
    clean, sparse = prediction(0), some_depths(n, 3)
    a, b = adaptation.align(clean, sparse)
    here = clean[sparse.rows, sparse.columns]
    want = float(sparse.depths.mean() - here.mean()) if n else 0.0
    assert (float(a), float(b)) == (1.0, pytest.approx(want))


def test_alignment_of_points_at_one_predicted_depth():
    sparse = some_depths(5, 1)
    a, b = adaptation.align(torch.full((18, 24), 0.4, dtype=D), sparse)
    low, high = float(sparse.depths.min()), float(sparse.depths.max())
    assert (float(a), float(b)) == pytest.approx((high - low, low))


def test_points_all_at_one_depth_have_no_slope_to_follow():
    clean, sparse = prediction(2), some_depths(6, 1)
    sparse = adaptation.SparseDepths(
        rows=sparse.rows, columns=sparse.columns, depths=torch.full((6,), 3.0, dtype=D)
    )
    a, b = adaptation.align(clean, sparse)
    assert float(a) > 0
    assert torch.isfinite(b)


def test_loss_by_hand():
    depth = torch.tensor([[1.0, 2.0], [3.0, 4.0]], dtype=D)
    sparse = adaptation.SparseDepths(
        rows=torch.tensor([0, 1]), columns=torch.tensor([1, 0]),
        depths=torch.tensor([2.5, 3.0], dtype=D),
    )  # fmt: skip
    guide = torch.tensor([[1.5, 9.0], [9.0, 3.0]], dtype=D)
    visible = torch.tensor([[True, False], [False, True]])
    loss = adaptation.guidance_loss(depth, sparse, guide, visible, 0.1)
    assert float(loss) == pytest.approx(0.5 + 0.1 * (0.5 + 1.0))


@given(seed=st.integers(0, 2**16))
@settings(max_examples=20)
def test_diffusion_conserves_depth_and_never_overshoots(seed):
    g = torch.Generator().manual_seed(seed)
    image = torch.rand(9, 11, 3, generator=g, dtype=D)
    latent = torch.randn(9, 11, generator=g, dtype=D)
    out = EdgeDiffusion(sweeps=20).predict_clean(latent, image, 0)
    assert float(out.mean()) == pytest.approx(float(latent.mean()))
    assert float(out.max()) <= float(latent.max()) + 1e-12
    assert float(out.min()) >= float(latent.min()) - 1e-12


def test_diffusion_stops_at_an_edge():
    image = torch.zeros(8, 10, 3, dtype=D)
    image[:, 5:] = 1.0
    latent = torch.zeros(8, 10, dtype=D)
    latent[:, :5] = torch.randn(8, 5, generator=torch.Generator().manual_seed(0), dtype=D)
    out = EdgeDiffusion(sweeps=400).predict_clean(latent, image, 0)
    assert_close(out[:, 5:], latent[:, 5:])
    assert float(out[:, :5].std()) < 0.1 * float(latent[:, :5].std())


def test_diffusion_gradient():
    g = torch.Generator().manual_seed(1)
    image = torch.rand(4, 5, 3, generator=g, dtype=D)
    latent = torch.randn(4, 5, generator=g, dtype=D).requires_grad_()
    model = EdgeDiffusion(sweeps=3)
    assert torch.autograd.gradcheck(lambda x: model.decode(x, image), latent)


def test_edge_diffusion_advances_as_its_noise_falls():
    """Three steps at noise 1, 2/3, 1/3, 0: by hand, and clean at the end."""
    model, g = EdgeDiffusion(steps=3), torch.Generator().manual_seed(2)
    latent, clean = torch.randn(2, 4, 5, generator=g, dtype=D)
    assert_close(model.advance(latent, clean, 0), (2 * latent + clean) / 3)
    assert_close(model.advance(latent, clean, 1), (latent + clean) / 2)
    assert_close(model.advance(latent, clean, 2), clean)


@pytest.mark.parametrize("options", [{"steps": 0}, {"sweeps": 0}, {"contrast": 0.0}])
def test_senseless_diffusion_is_refused(options):
    with pytest.raises(ValueError, match="positive"):
        EdgeDiffusion(**options)


def two_surfaces(scale: int = 2) -> tuple[Tensor, Tensor]:
    """An image of a bright near block on dark ground, and its true depth."""
    image = torch.zeros(9 * scale, 12 * scale, 3, dtype=D)
    depth = torch.full((9 * scale, 12 * scale), 3.0, dtype=D)
    block = slice(5 * scale // 2, 13 * scale // 2), slice(4 * scale, 8 * scale)
    image[block] = 1.0
    depth[block] = 2.0
    return image, depth


def small_diffusion() -> EdgeDiffusion:
    """Sweeps for half the image's edge, where values have half as far to go: a quarter of the usual 60."""
    return EdgeDiffusion(sweeps=15)


def at(depth: Tensor, *pixels: tuple[int, int]) -> adaptation.SparseDepths:
    rows, columns = torch.tensor(pixels).unbind(dim=1)
    return adaptation.SparseDepths(rows=rows, columns=columns, depths=depth[rows, columns])


def test_a_few_points_and_the_edges_give_the_whole_depth():
    image, truth = two_surfaces()
    sparse = at(truth, (8, 10), (10, 14), (2, 3), (2, 20), (15, 3), (15, 20))
    nothing = torch.zeros(18, 24, dtype=D)
    got = adaptation.adapt_view(
        EdgeDiffusion(), image, sparse, nothing, nothing.bool(),
        adaptation.AdaptationSettings(guidance_steps=40), torch.Generator().manual_seed(0),
    )  # fmt: skip
    assert float((got - truth).abs().mean()) < 0.03  # 0.012 was seen; constant steps swing: 0.045
    # The control: alignment alone, without guidance, cannot find the block.
    start = EdgeDiffusion().start(image, torch.Generator().manual_seed(0)).sigmoid()
    a, b = adaptation.align(start, sparse)
    assert float((a * start + b - truth).abs().mean()) > 0.3


def test_the_memory_guides_where_there_are_no_points():
    image, truth = two_surfaces(1)
    sparse = at(truth, (1, 1), (7, 10), (1, 10))
    visible = torch.zeros(9, 12, dtype=torch.bool)
    visible[2:5, 4:7] = True
    options = adaptation.AdaptationSettings(guidance_steps=40)
    errors = []
    for mask in (visible, torch.zeros_like(visible)):
        got = adaptation.adapt_view(
            small_diffusion(), image, sparse, truth, mask, options, torch.Generator().manual_seed(0)
        )
        errors.append(float((got - truth)[2:5, 4:7].abs().mean()))
    assert errors[0] < 0.15
    assert errors[0] < 0.3 * errors[1]


def test_a_view_without_points_takes_its_first_scale_from_the_memory():
    """Depths of 40 and 60: without guidance the scale 1 and shift 0 of nobody's knowledge are left."""
    image, truth = two_surfaces()
    none = adaptation.SparseDepths(
        rows=torch.zeros(0).long(), columns=torch.zeros(0).long(), depths=torch.zeros(0, dtype=D)
    )
    visible = torch.ones(18, 24, dtype=torch.bool)
    visible[:, 20:] = False
    got = adaptation.adapt_view(
        EdgeDiffusion(), image, none, 20 * truth, visible,
        adaptation.AdaptationSettings(guidance_steps=0), torch.Generator().manual_seed(0),
    )  # fmt: skip
    assert (
        35 < float(got.min()) < float(got.max()) < 65
    )  # a line fitted to noise leaves 40 to 60 a little


def test_a_prior_is_kept_where_nothing_contradicts_it():
    """Relief that neither points nor the photo's edges show comes from the prior alone."""
    image = torch.full((18, 24, 3), 0.5, dtype=D)
    prior = torch.rand(18, 24, generator=torch.Generator().manual_seed(1), dtype=D) * 0.8 + 0.1
    truth = 5 + 3 * prior
    sparse, nothing = at(truth, (2, 3), (15, 20), (2, 20), (9, 9)), torch.zeros(18, 24, dtype=D)
    errors = []
    for known in (prior, None):
        got = adaptation.adapt_view(
            EdgeDiffusion(prior=known), image, sparse, nothing, nothing.bool(),
            adaptation.AdaptationSettings(), torch.Generator().manual_seed(0),
        )  # fmt: skip
        errors.append(float((got - truth).abs().mean()))
    assert errors[0] < 0.15 * errors[1]  # 0.07 was seen; 0.30 where steps stay as large


@pytest.mark.parametrize("value", [0.0, 1.0, float("nan")])
def test_a_prior_that_is_no_depth_is_refused(value):
    with pytest.raises(ValueError, match="between 0 and 1"):
        EdgeDiffusion(prior=torch.full((4, 4), value))


class ScheduledDiffusion:
    """Stands for a latent diffusion model: a known posterior mean, a DDIM schedule, a VAE-like decoder.

    The photo's red channel is the clean latent, four numbers a pixel; so guidance has nothing to
    correct, and every state on the way is known.
    """

    steps = 4

    def __init__(self) -> None:
        """Keep what the adaptation calls."""
        self.latents: list[Tensor] = []
        self.steps_seen: list[int] = []
        self.network_gradients: list[bool] = []
        self.alpha = torch.linspace(0.02, 1, self.steps + 1, dtype=D)
        """alpha_bar after each step; the last one is free of noise."""
        self.noise = torch.randn(4, 18, 24, generator=torch.Generator().manual_seed(5), dtype=D)

    def at(self, clean: Tensor, step: int) -> Tensor:
        """x_t of a clean latent with the noise that the whole trajectory keeps."""
        return self.alpha[step].sqrt() * clean + (1 - self.alpha[step]).sqrt() * self.noise

    def start(self, image: Tensor, generator: torch.Generator) -> Tensor:
        del generator
        return self.at(self.truth(image), 0)

    def truth(self, image: Tensor) -> Tensor:
        return torch.logit(0.1 + 0.8 * image[..., 0]).expand(4, -1, -1)

    def predict_clean(self, latent: Tensor, image: Tensor, step: int) -> Tensor:
        self.latents.append(latent)
        self.steps_seen.append(step)
        self.network_gradients.append(torch.is_grad_enabled() or latent.requires_grad)
        return self.truth(image).clone()

    def advance(self, latent: Tensor, clean: Tensor, step: int) -> Tensor:
        now, after = self.alpha[step], self.alpha[step + 1]
        noise = (latent - now.sqrt() * clean) / (1 - now).sqrt()
        return after.sqrt() * clean + (1 - after).sqrt() * noise

    def decode(self, latent: Tensor, image: Tensor) -> Tensor:
        del image
        return torch.sigmoid(latent.mean(dim=0))


def test_a_diffusion_model_with_its_own_schedule_fits():
    """x_t is what its scheduler makes of it, and the network never sees a clean latent."""
    image = torch.rand(18, 24, 3, generator=torch.Generator().manual_seed(3), dtype=D)
    model = ScheduledDiffusion()
    assert isinstance(model, adaptation.DepthDenoiser)
    truth = 5 + 3 * model.decode(model.truth(image), image)
    sparse, nothing = at(truth, (2, 3), (9, 9), (15, 20)), torch.zeros(18, 24, dtype=D)
    got = adaptation.adapt_view(
        model, image, sparse, nothing, nothing.bool(),
        adaptation.AdaptationSettings(guidance_steps=0), torch.Generator(),
    )  # fmt: skip
    assert_close(got, truth)
    assert model.steps_seen == [0, 1, 2, 3]
    for step, latent in enumerate(model.latents):
        assert_close(latent, model.at(model.truth(image), step))


def test_gradients_go_through_the_decoder_only():
    image, truth = two_surfaces()
    image = 0.5 + 0.1 * image
    model, nothing = ScheduledDiffusion(), torch.zeros(18, 24, dtype=D)
    adaptation.adapt_view(
        model, image, at(truth, (8, 10), (2, 3)), nothing, nothing.bool(),
        adaptation.AdaptationSettings(guidance_steps=3), torch.Generator(),
    )  # fmt: skip
    assert model.network_gradients == [False] * 4


def test_what_guidance_finds_at_one_step_reaches_the_next():
    image, truth = two_surfaces()
    image = 0.5 + 0.1 * image
    model, nothing = ScheduledDiffusion(), torch.zeros(18, 24, dtype=D)
    adaptation.adapt_view(
        model, image, at(truth, (8, 10), (2, 3)), nothing, nothing.bool(),
        adaptation.AdaptationSettings(guidance_steps=3), torch.Generator(),
    )  # fmt: skip
    moved = (model.latents[1] - model.at(model.truth(image), 1)).abs().sum(dim=0) > 1e-6
    assert sorted(moved.nonzero().tolist()) == [[2, 3], [8, 10]]


@pytest.mark.parametrize("scale", [pytest.param(0.01, marks=pytest.mark.slow), 100.0])
def test_depth_does_not_depend_on_scene_units(scale):
    """Sparse points and guide in other units give the same depth in these units."""
    image, truth = two_surfaces(1)
    sparse = at(truth, (4, 5), (5, 7), (1, 1), (1, 10), (7, 1), (7, 10))
    visible = torch.zeros(9, 12, dtype=torch.bool)
    visible[:, :2] = True

    def adapted(by: float) -> Tensor:
        known = adaptation.SparseDepths(
            rows=sparse.rows, columns=sparse.columns, depths=by * sparse.depths
        )
        return adaptation.adapt_view(
            small_diffusion(), image, known, by * truth, visible,
            adaptation.AdaptationSettings(guidance_steps=10), torch.Generator().manual_seed(0),
        )  # fmt: skip

    got = adapted(scale) / scale
    assert (
        float(((got - truth) / truth).abs().mean()) < 0.06
    )  # 0.033 to 0.043 were seen; unguided 0.18
    # a rounding error can turn the sign of a residual near 0, and with it one of Adam's steps
    assert_close(got, adapted(1.0), rtol=0, atol=2e-3)


def test_unit_of_depth_by_hand():
    guide = torch.tensor([[4.0, 50.0], [60.0, 8.0]], dtype=D)
    visible = torch.tensor([[True, False], [False, True]])
    three = torch.tensor([0, 0, 1])
    sparse = adaptation.SparseDepths(
        rows=three, columns=three, depths=torch.tensor([1.0, 2.0, 3.0], dtype=D)
    )
    assert adaptation.depth_unit(sparse, guide, visible) == pytest.approx(8 - 1)
    assert adaptation.depth_unit(sparse, guide, visible & False) == pytest.approx(3 - 1)
    alike = adaptation.SparseDepths(rows=three, columns=three, depths=torch.full((3,), 7.0).to(D))
    assert adaptation.depth_unit(alike, guide, visible & False) == pytest.approx(7)
    none = adaptation.SparseDepths(rows=three[:0], columns=three[:0], depths=guide[0, :0])
    assert adaptation.depth_unit(none, guide, visible & False) == 1


def test_a_wrong_point_in_a_hundred_does_not_set_the_unit():
    depths = torch.cat([torch.linspace(2, 3, 149, dtype=D), torch.tensor([1e6]).to(D)])
    index = torch.zeros(150, dtype=torch.int64)
    sparse = adaptation.SparseDepths(rows=index, columns=index, depths=depths)
    nothing = torch.zeros(2, 2, dtype=D)
    assert 0.9 < adaptation.depth_unit(sparse, nothing, nothing.bool()) < 1


def test_the_memory_of_one_view_guides_the_next():
    """Three points say nothing of the block; a memory that holds it does."""
    image, truth = two_surfaces(1)
    g = torch.Generator().manual_seed(0)
    points = torch.tensor([[-1.0, -0.6, 3.0], [1.0, 0.6, 3.0], [-1.0, 0.6, 3.0]], dtype=D)
    empty = layered_depth.empty(camera(scale=1), 0.05)
    full = layered_depth.insert(
        empty, adaptation.unproject(camera(scale=1), truth), torch.zeros(9 * 12, 3, dtype=D)
    )
    errors = []
    for memory in (full, empty):
        _, depths = adaptation.adapt_all(
            small_diffusion(), [camera(scale=1)], [image], points, torch.ones(1, 3).bool(), [0], memory,
            adaptation.AdaptationSettings(guidance_steps=40), g,
        )  # fmt: skip
        errors.append(float((depths[0] - truth)[2:5, 4:7].abs().mean()))
    assert errors[0] < 0.15
    assert errors[1] > 0.5


def test_views_enter_the_memory_one_after_another():
    cameras = [camera(0.0), camera(0.4)]
    image, _ = two_surfaces()
    g = torch.Generator().manual_seed(0)
    points = torch.rand(40, 3, generator=g, dtype=D) * torch.tensor([2.0, 1.5, 0.2], dtype=D)
    points = points + torch.tensor([-1.0, -0.75, 2.0], dtype=D)
    seen = torch.ones(2, 40, dtype=torch.bool)
    seen[1, 20:] = False
    memory = layered_depth.empty(cameras[0], 0.05)
    visited: list[int] = []
    order = adaptation.order_by_coverage(seen.flip(0))
    final, depths = adaptation.adapt_all(
        EdgeDiffusion(steps=1, sweeps=5), cameras, [image, image], points, seen, order, memory,
        adaptation.AdaptationSettings(guidance_steps=3), g, visited.append,
    )  # fmt: skip
    assert visited == [1, 0]
    assert sorted(depths) == [0, 1]
    assert len(final) > 300
    # Everything the reference camera itself contributed is there: all its pixels hold a layer.
    assert len(final.pixels.unique()) == 24 * 18


def test_orders():
    seen = torch.tensor([[1, 0, 0], [1, 1, 1], [0, 1, 0]]).bool()
    assert adaptation.order_by_coverage(seen) == [1, 0, 2]
    centres = torch.tensor([[3.0, 0, 0], [1, 0, 0], [2, 0, 0]], dtype=D)
    assert adaptation.order_by_distance(centres, torch.zeros(3, dtype=D)) == [1, 2, 0]
    shuffled = adaptation.order_at_random(9, torch.Generator().manual_seed(1))
    assert sorted(shuffled) == list(range(9))
    assert shuffled == adaptation.order_at_random(9, torch.Generator().manual_seed(1))


def test_sparse_depths_are_those_of_the_points_in_the_image():
    points = torch.tensor([[0.0, 0, 2], [0, 0, -2], [50, 0, 2], [0.5, 0.25, 4]], dtype=D)
    got = adaptation.sparse_depths(camera(), points)
    assert got.rows.tolist() == [9, 10]
    assert got.columns.tolist() == [12, 14]
    assert got.depths.tolist() == [2, 4]
