"""The speed study's CUDA path against a stand-in for gsplat on the CPU: no line of gsplat runs."""

import sys
from types import SimpleNamespace

import pytest
import torch

from splatproof.cli import main
from splatproof.methods.contracts import cuda_gsplat
from splatproof.reference.rasterizer import rasterize as rasterizer
from splatproof.reference.types.camera import Camera
from splatproof.suites.studies.speed import judge as speed_judge
from splatproof.suites.studies.speed.idle import Patience
from splatproof.suites.studies.speed.measure import Timer, takes_part
from splatproof.suites.studies.speed.session import Here, with_backend
from splatproof.suites.twins import cuda
from splatproof.suites.twins.registry import COMPONENTS
from splatproof.suites.twins.twin import Case

NAMES = ("cuda adapter", "gsplat's own call")


def rasterization(
    means, quats, scales, opacities, colors, viewmats, Ks, width, height, *, near_plane=0.01,
    sh_degree: int = 0, packed=True, render_mode="RGB", backgrounds=None, rasterize_mode: rasterizer.Mode = "classic",
    absgrad=False,
):  # fmt: skip
    """gsplat's function and defaults on the reference rasterizer, for one camera."""
    assert (viewmats.shape, Ks.shape, packed) == ((1, 4, 4), (1, 3, 3), False)
    assert colors.shape[1:] == ((sh_degree + 1) ** 2, 3)
    view = Camera(K=Ks[0], world_to_camera=viewmats[0], width=width, height=height, near=near_plane)
    out = rasterizer.rasterize(
        view, means, quats, scales, opacities, sh=colors, background=backgrounds,
        mode=rasterize_mode,
    )  # fmt: skip
    image = {"RGB": out.colour, "RGB+ED": torch.cat([out.colour, out.depth[..., None]], dim=2)}
    shifts = torch.zeros(1, len(means), 2, requires_grad=absgrad)
    meta = {"means2d": shifts, "radii": out.radii.ceil().int()[None]}
    return image[render_mode][None], out.alpha[None, :, :, None], meta


@pytest.fixture(autouse=True)
def stand_in(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=rasterization))
    monkeypatch.setattr(cuda_gsplat, "gpu", lambda: torch.device("cpu"))
    monkeypatch.setattr(cuda, "device_mb", lambda: 12.0)


@pytest.mark.parametrize("name", ["rasterizer", "pipeline"])
def test_gsplats_twins_are_added_and_judged(name):
    component = with_backend(name, "cuda")
    assert tuple(twin.name for twin in component.twins[-2:]) == NAMES
    assert len(COMPONENTS[name].twins) == len(component.twins) - 2
    found = speed_judge.judge(component, component.problem(component.tiny))
    for twin in NAMES:
        assert found[twin]["ok"]
        # the camera is rounded to float32 on its way: about 1e-6 of a pixel's position in units of 1 px
        assert found[twin]["max_abs_error"] < 1e-4
        assert found[twin]["grad_cosine"] > 0.9999


def test_other_components_stay_as_they_are():
    assert with_backend("adam", "cuda") is COMPONENTS["adam"]


def test_gsplats_twins_are_timed_with_memory_of_their_device():
    component = with_backend("rasterizer", "cuda")
    twins = [twin for twin in component.twins if twin.name in NAMES]
    timer = Timer(quick=True, patience=Patience(0.0), backend="cuda", open_session=Here)
    rows = list(timer.case(component, Case(size=(60, 32, 24)), twins))
    assert [row["twin"] for row in rows] == list(NAMES)
    for row in rows:
        assert row["forward_ms"] > 0
        assert row["backward_ms"] > 0
        assert row["device_mb"] == 12.0


def test_large_cases_are_for_the_usual_twin_and_those_on_a_device():
    component = with_backend("rasterizer", "cuda")
    case = next(case for case in component.cases if case.growth)
    timed = [twin.name for twin in component.twins if takes_part(component, twin, case)]
    assert timed == [component.usual, *NAMES]


def test_without_a_gpu_the_command_says_what_is_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.delitem(sys.modules, "gsplat")
    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    assert main(["study", "speed", "--quick", "--backend", "cuda", "--out", str(tmp_path)]) == 3
    assert "backend 'cuda' cannot run here" in capsys.readouterr().err
