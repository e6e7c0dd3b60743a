"""Models of methods beside 3dgs are the same to the bit where another process renders them."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.base.tensor_files import read_tensors
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method

RENDER = """
import sys
from pathlib import Path
sys.path.append("tests")
from helpers.tiny_scene import tiny_scene
from splatproof.base.tensor_files import write_tensors
from splatproof.methods.loading import load_reconstruction
model = load_reconstruction(Path(sys.argv[1]))
output = model.render(tiny_scene().views[0])
write_tensors(Path(sys.argv[2]), {"colour": output.colour, "alpha": output.alpha})
"""


@pytest.mark.parametrize("name", ["absgs", "mip-splatting"])
def test_saved_and_rendered_in_another_process(name, tmp_path):
    method = get_method(name)
    model = method.fit(tiny_scene(), method.settings(iterations=15), Run(threads=1, seed=3))
    save_model(model, tmp_path / "model", Origin())
    subprocess.run(
        [sys.executable, "-c", RENDER, str(tmp_path / "model"), str(tmp_path / "image")],
        check=True, cwd=Path(__file__).parents[3],
    )  # fmt: skip
    found, want = read_tensors(tmp_path / "image")[0], model.render(tiny_scene().views[0])
    assert torch.equal(found["colour"], want.colour)
    assert torch.equal(found["alpha"], want.alpha)
    assert float(want.colour.std()) > 0.01
