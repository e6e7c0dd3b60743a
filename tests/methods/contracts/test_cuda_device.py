"""The backend `cuda` with gsplat itself on a real GPU; skipped where there is none."""

import importlib.util

import pytest
import torch

from helpers.tiny_drive import tiny_drive
from helpers.tiny_scene import camera, random_gaussians, tiny_scene
from splatproof.methods.contracts import cuda_gsplat
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method
from splatproof.reference.checks.agreement import compare_gradients
from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.suites.studies.speed.judge import judge
from splatproof.suites.studies.speed.session import with_backend

READY = torch.cuda.is_available() and importlib.util.find_spec("gsplat") is not None
pytestmark = pytest.mark.skipif(
    not READY, reason="needs a CUDA device and `pip install splatproof[cuda]`"
)
STATIC = ("3dgs", "absgs", "mip-splatting", "scaffold-gs")
DYNAMIC = ("pvg", "hdgs")


@pytest.mark.parametrize("name", ["rasterizer", "pipeline"])
def test_gsplats_twins_are_within_their_budget(name):
    component = with_backend(name, "cuda")
    found = judge(component, component.problem(component.tiny))
    for twin in ("cuda adapter", "gsplat's own call"):
        assert found[twin]["ok"], found[twin]


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
@pytest.mark.parametrize("degree", [0, 3])
def test_pictures_and_gradients_are_the_references(mode, degree):
    g = random_gaussians(200, degree=degree)
    background = torch.tensor([0.2, 0.5, 0.9])
    weights = torch.rand(
        camera(2).height, camera(2).width, 3, generator=torch.Generator().manual_seed(0)
    )

    def drawn(rasterize, dtype):
        leaves = [
            value.detach().to(dtype).requires_grad_()
            for value in (g.means, g.quaternions, g.scales, g.opacities, g.sh)
        ]
        out = rasterize(
            camera(2), *leaves[:4], sh=leaves[4], background=background.to(dtype), mode=mode
        )
        (out.colour * weights.to(dtype)).sum().backward()
        gradients = [leaf.grad for leaf in leaves if leaf.grad is not None]
        assert len(gradients) == len(leaves)
        return out, gradients

    want, true = drawn(rasterizer.rasterize, torch.float64)
    got, found = drawn(cuda_gsplat.rasterize, torch.float32)
    # a pixel where gsplat stops one Gaussian earlier (T <= 1e-4) changes by at most 1e-4
    torch.testing.assert_close(got.colour.double(), want.colour, atol=2e-4, rtol=0)
    torch.testing.assert_close(got.alpha.double(), want.alpha, atol=2e-4, rtol=0)
    for mine, theirs in zip(found, true, strict=True):
        assert compare_gradients(mine, theirs, floor=1e-6).relative_l2 < 1e-2


@pytest.mark.parametrize("name", [*STATIC, *DYNAMIC])
def test_a_method_trains_and_renders_there(name):
    scene = tiny_drive() if name in DYNAMIC else tiny_scene()
    method = get_method(name)
    settings = method.settings(iterations=40)
    errors = {}
    for backend in ("cpu", "cuda"):
        model = method.fit(scene, settings, Run(backend=backend, threads=1, seed=3))
        with torch.no_grad():
            shown = [model.render(scene.views[i]).colour.cpu() for i in scene.train]
        assert all(bool(image.isfinite().all()) for image in shown)
        errors[backend] = sum(
            float((image - scene.views[i].load()).square().mean())
            for image, i in zip(shown, scene.train, strict=True)
        )
    assert errors["cuda"] == pytest.approx(errors["cpu"], rel=0.1)
