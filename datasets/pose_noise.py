"""Camera poses with errors of the size that aerial positioning has, for training views only."""

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from splatproof.base.errors import UsageError
from splatproof.reference.types.result import TRUE_POSES
from splatproof.reference.types.scene import Scene

LEVELS = {TRUE_POSES: (0.0, 0.0), "L1": (0.5, 0.001), "L2": (1.0, 0.002), "L3": (2.0, 0.005)}
"""Name of each level; standard deviation of the rotation in degrees and, on each axis, of the
position as a share of the scene's extent."""


def disturbed(scene: Scene, level: str, seed: int) -> Scene:
    """The scene with noise on the poses of its training views; test views and points stay true.

    Each camera is turned by a normal angle about a random axis through its centre, and its centre
    is shifted by a normal length on each axis. The extent is the diagonal of the box around all
    camera centres. Sparse points stay as they are, also those that a protocol has triangulated: the
    paper disturbs what follows them, completion and training (column "All" of its table). All that
    a method makes of the photos itself, dense points for example, is made under the noise.

    Args:
        scene: Any scene.
        level: Key of LEVELS; "none" returns the scene itself.
        seed: Seed of the noise, >= 0. The same seed disturbs a scene in the same way, and the levels
            of one seed differ in size alone.

    Returns: The scene; its facts name the level and the seed.
    Raises: UsageError for a level that there is not.
    Source: noise levels of "StratoSplat", Table 6; the distribution (normal) is ours.
    """
    if level not in LEVELS:
        raise UsageError(f"{level}: no such pose noise; there are {', '.join(LEVELS)}")
    if level == TRUE_POSES:
        return scene
    degrees, share = LEVELS[level]
    rng = np.random.Generator(np.random.PCG64(seed))
    centres = torch.stack([view.camera.centre for view in scene.views])
    extent = float((centres.amax(dim=0) - centres.amin(dim=0)).norm())
    views = list(scene.views)
    for index in scene.train:
        camera = views[index].camera
        axis = rng.standard_normal(3)
        axis *= np.radians(rng.normal(0, degrees)) / np.linalg.norm(axis)
        turn = torch.from_numpy(Rotation.from_rotvec(axis).as_matrix())
        rotation = turn @ camera.rotation
        centre = camera.centre + torch.from_numpy(rng.normal(0, share * extent, 3))
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
        views[index] = replace(views[index], camera=replace(camera, world_to_camera=pose))
    facts = scene.facts | {"pose_noise": level, "pose_noise_seed": str(seed)}
    return replace(scene, views=tuple(views), facts=facts)
