"""Small runs give the bytes that they gave before the trainer became one for all models.

The hashes were first written down from the code before that change. They were written down again when
the reference came to invert covariances by their exact determinant (it draws the scene's photos, which
changed in their last bits), when the kernels came to sum in another order (each time all were the old
ones with the part of before), and when a processor came by on which MKL rounds in another way, with the
old code too: now MKL works as it does on every processor. They hold for the portable kernels and torch's
default instructions, in a process of its own, with the pinned torch: another one may round differently.
"""

import pytest
import torch

from helpers import small_runs

TORCH = "2.13.0"
PHOTOS = "5fe5d2b5f527f5770096d58907e9b60e824ce7f9b9c299e758795573d1f520d1"
"""Of what the runs are trained on. Where it is another, the machine rounds in its own way."""
BEFORE = {
    "3dgs plain cpu": "157ba1323ae11524bad04e4399b596ee3b2b7380c213141206088c120169acb0",
    "3dgs degree 3 cpu": "48a14fab46b313b30a1ca3904ef5a3d4182df0110afc685a09c7bc566f175b26",
    "3dgs several views cpu": "625f0c298309fba537aa09511e69605f924b5873eeeccff5d14ee83b902272dd",
    "3dgs plain reference": "f9a52830a07fd613df03393a8409595e097ebd927568bb4ad21a1137cc4887a6",
    "3dgs degree 3 reference": "3c1aac89389fcf413b8cf649f6c7abd6a5af41249e083e27f73bc2d50ff9f299",
    "3dgs several views reference": "1468397e0bdbea1ccc71a5d7f9fd21aeba73ad7f5b509bc978ba5fc65298fdae",
    "odbp+stitch": "2e8f21c239fea73657c49378c48fdc8901ff2eb5750af12bfe6c52b468a5eaf2",
    "citygaussian": "99b3be4d32f28dc0f6d99f9e1cb3c72933d3d432f78fbfcd6da8f3433cd227c8",
    "stitchgs": "8081aee78d65844dd760902994d978593430a04c7eef5dd9309208a1f086482c",
    "dpgs-partition": "43addca11f7221b0e7447a3a44f819a29f325465e43aade196355699ff624a3c",
    "odbp+stitch sgd": "a31f0b3b52191d400b3a0be85e51fe69b64f8c9babd33e61323ab9af1eafbb95",
}


@pytest.fixture(scope="module")
def now() -> dict[str, str]:
    """Hashes of all runs, made with kernels, torch and MKL at their lowest level."""
    found = small_runs.hashes()
    if found[small_runs.PHOTOS] != PHOTOS:
        pytest.skip("torch and MKL draw other photos on this machine, so other models follow")
    return found


@pytest.mark.skipif(
    torch.__version__.split("+")[0] != TORCH, reason=f"the hashes were made with torch {TORCH}"
)
@pytest.mark.parametrize("run", BEFORE)
def test_the_model_is_the_same_to_the_bit(now, run):
    assert now[run] == BEFORE[run]


def test_another_seed_gives_another_hash():
    same, other = (small_runs.threedgs("plain", "cpu", seed) for seed in (3, 4))
    assert same == small_runs.threedgs("plain", "cpu", 3)
    assert same != other
