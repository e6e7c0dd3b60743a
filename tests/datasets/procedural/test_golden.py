"""The truth of seed 0 is the same on every machine, up to the rounding of floats."""

import numpy as np
import pytest

from splatproof.datasets.procedural import courtyard, street, tunnel
from splatproof.datasets.procedural import ray_images as frames

GOLDEN = {
    "courtyard": [34.25373, 0.36343, -0.01316, 0.6807, 5.62943],
    "street": [17.63454, -0.2149, 0.0454, 0.52081, 14.65185],
    "tunnel": [6.22759, -0.21522, -0.03058, 0.08596, 2.4337],
}


def numbers(plan):
    """Mean depth, mean normal and mean object id of the first view."""
    shot = plan.shots[0]
    depth, normal, objects = frames.truth(plan.stage(shot).caster, shot.camera)
    seen = np.isfinite(depth)
    return [
        float(depth[seen].mean()),
        *map(float, normal[seen].mean(axis=0)),
        float(objects.mean()),
    ]


@pytest.mark.parametrize("module", [courtyard, street, tunnel], ids=lambda m: m.__name__[-9:])
def test_truth_is_as_it_was(module):
    found = numbers(module.plan(0, module.PRESETS["small"]))
    # a ray that grazes an edge may fall to either side: a few pixels of 40,000
    assert found == pytest.approx(GOLDEN[module.__name__.rsplit(".", 1)[1]], rel=2e-4, abs=2e-4)
