"""What `import splatproof` offers: documented, typed, cheap to import, the command line's own roads."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import splatproof as sp
from helpers.tiny_scene import camera, random_gaussians
from splatproof import metrics
from splatproof.base.plugin_files import plugin_files
from splatproof.metrics.registry import BUILT_IN
from splatproof.reference.rasterizer.rasterize import rasterize as reference

ROOT = Path(__file__).parents[2]
FUNCTIONS = ("open_scene", "rasterize", "fit", "load", "results_frame", "use_plugin")


def stub_names(path: Path) -> set[str]:
    """Names that a stub offers."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname for alias in node.names if alias.asname}
    return found


@pytest.mark.parametrize("package", ["splatproof", "splatproof.metrics"])
def test_type_checkers_see_what_is_there(package):
    module = importlib.import_module(package)
    stub = Path(module.__file__ or "").with_suffix(".pyi")
    names = set(dir(module)) - {"__version__"}
    assert stub_names(stub) == names
    assert all(getattr(module, name) is not None for name in names)
    with pytest.raises(AttributeError, match="psrn"):
        module.psrn  # noqa: B018


def test_importing_it_loads_nothing_heavy():
    program = (
        "import sys, splatproof, splatproof.metrics\n"
        "print(sorted({'torch', 'mlflow', 'numpy', 'pandas', 'pycolmap'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_says_what_it_takes_gives_raises_and_where_it_is_from(name):
    text = inspect.getdoc(getattr(sp, name)) or ""
    for section in ("Args:", "Returns:", "Raises:", "Source:"):
        assert re.search(rf"^{section}", text, re.MULTILINE), section


def test_every_metric_can_be_called_by_its_exact_name():
    for name, metric in BUILT_IN.items():
        assert getattr(sp.metrics, name) is metric.function
        assert name in dir(metrics)
    grey = torch.full((12, 12, 3), 0.5)
    assert sp.metrics.psnr(grey, grey + 0.1) == pytest.approx(20, abs=1e-4)
    assert sp.metrics.flip(grey, grey) == 0


def test_rasterize_draws_with_the_backend_that_is_named():
    model, where = random_gaussians(20, seed=3), camera(0, width=24, height=16)
    means, turns = model.means.float(), model.quaternions.float()
    given = (means, turns, model.scales.float(), model.opacities.float())
    sh = model.sh.float()
    want = reference(where, *given, sh=sh).colour
    for backend in ("cpu", "reference"):
        drawn = sp.rasterize(where, *given, sh=sh, backend=backend).colour
        assert torch.allclose(drawn, want, atol=1e-4)
    with pytest.raises(sp.UsageError, match="did you mean 'cpu'"):
        sp.rasterize(where, *given, sh=sh, backend="cpus")
    with pytest.raises(ValueError, match="give colours, sh or both"):
        sp.rasterize(where, *given)


def test_errors_are_those_of_the_command_line(tmp_path):
    with pytest.raises(sp.UsageError, match="protocol .*unknown 'defalt', did you mean 'default'"):
        sp.open_scene(tmp_path, protocol="defalt")
    with pytest.raises(sp.DataError, match="no scene found here"):
        sp.open_scene(str(tmp_path))
    with pytest.raises(sp.DataError, match=r"model\.json: no such file"):
        sp.load(str(tmp_path))
    with pytest.raises(sp.DataError, match="no finished case"):
        sp.results_frame(str(tmp_path))
    loaded = plugin_files()
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(sp.UsageError, match="no Method, Metric or Adapter at its top level"):
        sp.use_plugin(tmp_path / "empty.py")
    (tmp_path / "taken.py").write_text(
        "from dataclasses import replace\nfrom splatproof.metrics.registry import BUILT_IN\n"
        "mine = replace(BUILT_IN['psnr'])\n"
    )
    with pytest.raises(sp.UsageError, match="its Metric is called 'psnr', and that name is taken"):
        sp.use_plugin(tmp_path / "taken.py")
    assert plugin_files() == loaded  # what was refused stands in nobody's way


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"method": "3dg"}, "unknown '3dg', did you mean '3dgs'"),
        ({"settings": {"iteration": 3}}, "settings of 3dgs.*iteration.*did you mean 'iterations'"),
        ({"settings": 3}, "found a int, expected names and values or a"),
        ({"seed": -1}, "seed -1: expected a whole number from 0"),
        ({"pose_noise": "L4"}, "pose_noise: unknown 'L4'"),
        ({"scene": "courtyrd"}, "did you mean 'courtyard'"),
        ({"width": 0}, "expected pixels, 1 or more"),
    ],
)
def test_what_fit_cannot_do_is_refused_before_anything_is_written(tmp_path, given, said):
    asked = {"method": "3dgs", "scene": "courtyard", "out": str(tmp_path / "out")} | given
    with pytest.raises(sp.UsageError, match=said):
        sp.fit(**asked)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def ten_lines(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder that the README's Python made, and what it printed; run as a script of its own."""
    folder = tmp_path_factory.mktemp("ten_lines")
    text = (ROOT / "README.md").read_text()
    (block,) = [code for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL)]
    shorter = block.replace('"iterations": 300', '"iterations": 60')
    assert shorter != block
    (folder / "ten_lines.py").write_text(shorter)
    done = subprocess.run(
        [sys.executable, "ten_lines.py"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


def test_the_readmes_ten_lines_run_once_and_print_scores(ten_lines):
    folder, printed = ten_lines
    frame = sp.results_frame(folder / "first_model")
    assert len(frame) == 4
    assert min(frame["psnr"].tolist()) > 12
    for name in frame["image"].tolist():
        assert name in printed
    # a worker that ran the script again would have printed twice
    assert printed.count("my first model") == 1


def test_a_finished_fit_is_kept_and_refused_under_other_settings(ten_lines):
    folder, _ = ten_lines
    out = str(folder / "first_model")
    with pytest.raises(sp.UsageError, match="other settings or protocol rules"):
        sp.fit("3dgs", "courtyard", out=out, width=96, settings={"iterations": 2})
