"""Models of methods beside 3dgs are the same to the bit where another process renders them."""

import numpy as np
import pytest

from helpers.other_process import shown_elsewhere
from helpers.tiny_scene import tiny_scene
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.contracts.run import Run
from splatproof.methods.registry import get_method


@pytest.mark.parametrize("name", ["absgs", "mip-splatting"])
def test_saved_and_rendered_in_another_process(name, tmp_path):
    method = get_method(name)
    model = method.fit(tiny_scene(), method.settings(iterations=15), Run(threads=1, seed=3))
    save_model(model, tmp_path / "model", Origin())
    found = shown_elsewhere(tmp_path / "model", tiny_scene, 0)
    want = model.render(tiny_scene().views[0])
    assert np.array_equal(found["colour"], want.colour)
    assert np.array_equal(found["alpha"], want.alpha)
    assert float(want.colour.std()) > 0.01
