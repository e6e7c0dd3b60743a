"""Pose noise: as large as it says, on training views only."""

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import UsageError
from splatproof.datasets.pose_noise import LEVELS, disturbed


@pytest.mark.parametrize("level", LEVELS)
def test_noise_is_as_large_as_the_level_says(level):
    scene = tiny_scene()
    angles, shifts = [], []
    centres = torch.stack([view.camera.centre for view in scene.views])
    extent = float((centres.amax(dim=0) - centres.amin(dim=0)).norm())
    for seed in range(60):
        noisy = disturbed(scene, level, seed)
        for index in range(len(scene.views)):
            old, new = scene.views[index].camera, noisy.views[index].camera
            if index in scene.test:
                assert new is old
                continue
            turn = new.rotation @ old.rotation.T
            assert torch.allclose(turn @ turn.T, torch.eye(3).double(), atol=1e-12)
            angles.append(float(torch.acos(((turn.trace() - 1) / 2).clamp(-1, 1))))
            shifts.append(new.centre - old.centre)
    degrees, share = LEVELS[level]
    measured = torch.rad2deg(torch.tensor(angles).pow(2).mean().sqrt())
    assert float(measured) == pytest.approx(degrees, rel=0.25)
    assert float(torch.stack(shifts).std()) == pytest.approx(share * extent, rel=0.25)


def test_the_same_seed_disturbs_alike_and_the_scene_says_so():
    scene = tiny_scene()
    a, b = disturbed(scene, "L2", 4), disturbed(scene, "L2", 4)
    index = scene.train[0]
    assert torch.equal(a.views[index].camera.world_to_camera, b.views[index].camera.world_to_camera)
    assert a.facts["pose_noise"] == "L2"


def test_an_unknown_level():
    with pytest.raises(UsageError, match="L1, L2, L3"):
        disturbed(tiny_scene(), "L4", 0)
