"""The training loop: it learns, repeats itself, and continues after a kill bit for bit."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import DataError, SplatproofError, UsageError
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.loading import load_reconstruction
from splatproof.methods.models.explicit import FIELDS, ExplicitModel
from splatproof.methods.threedgs.fit import fit, prepare
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.density import Density
from splatproof.methods.training.loop import Trainer
from splatproof.reference.types.scene import Scene

SHORT = Settings(
    iterations=60,
    sh_degree=1,
    density=Density(start=0, interval=10, least_interval=10, stop=25_000, reset_interval=10_000),
)
"""60 steps with densifications at 10, 20, ... and opacity resets at 20 and 40."""
ON_REFERENCE = Run(backend="reference", threads=1)
ON_KERNELS = replace(ON_REFERENCE, backend="cpu")
"""Where the loop is what is looked at: a step takes a twentieth of the reference's time."""


def arrays(model):
    return {name: getattr(model.bake(), name) for name in FIELDS}


def same(one, other) -> bool:
    return all(torch.equal(arrays(one)[name], arrays(other)[name]) for name in FIELDS)


class Killed(Exception):
    """Stands for a kill between two steps."""


def killed_at(step: int):
    def report(now: int, total: int, values: dict[str, float]) -> None:
        if now == step:
            raise Killed

    return report


@pytest.fixture(scope="module")
def straight() -> Callable[[str], ExplicitModel]:
    """The model of an undisturbed run on a backend."""
    return cache(lambda backend: fit(tiny_scene(), SHORT, replace(ON_REFERENCE, backend=backend)))


def test_the_loss_falls():
    losses = []
    run = replace(ON_KERNELS, report=lambda step, total, values: losses.append(values["loss"]))
    fit(tiny_scene(), replace(SHORT, iterations=100, density=Density()), run)
    assert losses[-1] < 0.6 * losses[0]


def test_same_seed_same_model_and_another_seed_another(straight):
    assert same(straight("reference"), fit(tiny_scene(), SHORT, ON_REFERENCE))
    assert not same(straight("cpu"), fit(tiny_scene(), SHORT, replace(ON_KERNELS, seed=1)))


def test_density_changes_while_training():
    counts = []
    run = replace(ON_KERNELS, report=lambda step, total, values: counts.append(values["gaussians"]))
    fit(tiny_scene(), SHORT, run)
    assert len(set(counts)) > 1


@pytest.mark.parametrize("backend", ["reference", "cpu"])
@pytest.mark.parametrize(
    "step", [20, *(pytest.param(n, marks=pytest.mark.slow) for n in (10, 30, 50))]
)
def test_continuation_is_bit_equal(tmp_path, step, backend, straight):
    run = replace(ON_REFERENCE, backend=backend, folder=tmp_path, checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_scene(), SHORT, replace(run, report=killed_at(step)))
    assert same(straight(backend), fit(tiny_scene(), SHORT, run))


def test_processor_seconds_add_up_over_attempts(tmp_path):
    run = replace(ON_REFERENCE, backend="cpu", folder=tmp_path, checkpoint_seconds=0.0)
    first = Trainer(*prepare(tiny_scene(), SHORT, run), replace(run, report=killed_at(30)))
    with pytest.raises(Killed):
        first.train()
    second = Trainer(*prepare(tiny_scene(), SHORT, run), run)
    second.resume()
    before = second.cpu_seconds
    assert 0 < before <= first.cpu_seconds
    second.train()
    assert second.cpu_seconds > before


def test_native_bits_do_not_depend_on_threads():
    one, two = (
        fit(tiny_scene(), SHORT, replace(ON_REFERENCE, backend="cpu", threads=threads))
        for threads in (1, 2)
    )
    assert same(one, two)


def test_the_native_step_trains_as_autograd_does():
    run = replace(ON_REFERENCE, backend="cpu")
    losses = []
    for native in (True, False):
        model, plan = prepare(tiny_scene(), SHORT, run)
        trainer = Trainer(model, replace(plan, native=native), run)
        assert trainer.path == ("kernels" if native else "autograd")
        losses.append([trainer.advance()["loss"] for _ in range(9)])
    # later the models part: Adam follows the sign of gradients that are rounded zeros
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)


def test_a_finished_run_is_not_repeated(tmp_path):
    run = replace(ON_KERNELS, folder=tmp_path)
    first = fit(tiny_scene(), SHORT, run)
    assert same(first, fit(tiny_scene(), SHORT, replace(run, report=killed_at(60))))


def test_continuation_after_sigkill_is_bit_equal(tmp_path, straight):
    code = (
        "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path\n"
        "from dataclasses import replace\n"
        "from helpers.tiny_scene import tiny_scene\n"
        "from methods.training import test_loop as t\n"
        "run = replace(t.ON_REFERENCE, folder=Path(sys.argv[1]), checkpoint_seconds=0.0)\n"
        "t.fit(tiny_scene(), t.SHORT, run)\n"
    )
    tests = str(Path(__file__).parents[2])
    process = subprocess.Popen([sys.executable, "-P", "-c", code, str(tmp_path), tests])
    checkpoint = tmp_path / "checkpoint" / "training.safetensors"
    while not checkpoint.exists() and process.poll() is None:
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    steps = []
    run = replace(ON_REFERENCE, folder=tmp_path, report=lambda *a: steps.append(a[0]))
    assert same(straight("reference"), fit(tiny_scene(), SHORT, run))
    assert steps[-1] == 60


@pytest.mark.parametrize("change", [{"seed": 7}, {"background": (1.0, 1.0, 1.0)}])
def test_checkpoint_of_another_run_is_refused(tmp_path, change):
    run = replace(ON_REFERENCE, folder=tmp_path)
    fit(tiny_scene(), replace(SHORT, iterations=2), run)
    with pytest.raises(UsageError, match=f"differs: {next(iter(change))} .* before, .* now"):
        fit(tiny_scene(), replace(SHORT, iterations=2), replace(run, **change))
    with pytest.raises(UsageError, match="differs: settings.iterations 2 before, 3 now"):
        fit(tiny_scene(), replace(SHORT, iterations=3), run)


def test_damaged_checkpoint_is_named(tmp_path):
    run = replace(ON_REFERENCE, folder=tmp_path)
    fit(tiny_scene(), replace(SHORT, iterations=2), run)
    checkpoint = tmp_path / "checkpoint" / "training.safetensors"
    checkpoint.write_bytes(checkpoint.read_bytes()[:-100])
    with pytest.raises(DataError, match="training.safetensors: not a whole"):
        fit(tiny_scene(), replace(SHORT, iterations=2), run)


def garbled(scene: Scene) -> Scene:
    """The scene with noise in the left third of each photo."""

    def spoil(view):
        photo = view.load().clone()
        photo[:, :8] = torch.rand(18, 8, 3, generator=torch.Generator().manual_seed(5))
        return replace(view, load=lambda: photo)

    return replace(scene, views=tuple(spoil(view) for view in scene.views))


def test_masked_pixels_teach_nothing():
    mask = torch.ones(18, 24, dtype=torch.bool)
    mask[:, :8] = False
    short = replace(SHORT, iterations=10)
    clean = fit(tiny_scene(mask=mask), short, ON_KERNELS)
    assert same(clean, fit(garbled(tiny_scene(mask=mask)), short, ON_KERNELS))
    assert not same(
        fit(tiny_scene(), short, ON_KERNELS), fit(garbled(tiny_scene()), short, ON_KERNELS)
    )


def test_a_loss_that_is_not_finite_stops_with_the_view():
    scene = tiny_scene(views=2)
    bad = replace(scene.views[1], load=lambda: torch.full((18, 24, 3), torch.nan))
    with pytest.raises(SplatproofError, match=r"step 1, view 1.png: the loss is nan"):
        fit(replace(scene, views=(scene.views[0], bad)), SHORT, ON_REFERENCE)


def test_stages_are_timed_and_the_model_can_be_loaded(tmp_path):
    stages = {}
    run = replace(ON_REFERENCE, on_stage=stages.__setitem__)
    model = fit(tiny_scene(), replace(SHORT, iterations=3), run)
    assert set(stages) == {"init", "train"}
    assert stages["train"] > 0
    save_model(model, tmp_path, Origin(method="3dgs"))
    assert load_reconstruction(tmp_path, backend="reference").primitives == model.primitives
