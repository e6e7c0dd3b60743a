"""Worlds have the same pixels whichever processor's way of multiplying matrices a library takes."""

import os
import subprocess
import sys

import pytest

SCRIPT = '''
import hashlib, sys
from dataclasses import replace
from splatproof.datasets.procedural import aerial, ray_images, worlds
def smaller(camera):
    """The same view in a ninth of the pixels."""
    scale = camera.K.new_tensor([[1 / 3], [1 / 3], [1]])
    width, height = camera.width // 3, camera.height // 3
    return replace(camera, K=camera.K * scale, width=width, height=height)
*seen, built = sys.argv[1:]
for world in seen:
    plan = worlds.plan(world, "small", 0)
    shot = plan.shots[0]
    stage = plan.stage(shot)
    frame = ray_images.take(stage.caster, stage.lighting, smaller(shot.camera), samples=2, seed=3,
                            exposure=stage.exposure, seeds=stage.object_seeds)
    print(world, hashlib.sha256(frame.colour.tobytes()).hexdigest(), flush=True)
scene = aerial.SCENES[built](0)
for part in (scene.vertices, scene.normals, scene.coords):
    print(built, hashlib.sha256(part.tobytes()).hexdigest(), flush=True)
'''
PLAIN = {"MKL_CBWR": "COMPATIBLE", "OPENBLAS_CORETYPE": "Haswell"}
FUSED = {"MKL_CBWR": "AVX2", "OPENBLAS_CORETYPE": "Haswell"}
"""What the libraries take on another processor: without and with fused multiplications, and without AVX-512."""


ALL = ("tunnel", "street", "courtyard", "church")
"""Worlds whose pixels are taken, and an aerial scene of which the triangles are."""
FEW = ("tunnel", "courtyard", "factory")
"""Those that are built in the least seconds."""


# each mode is a start of python with all imports
@pytest.mark.parametrize(
    ("modes", "what"),
    [
        (({}, PLAIN), FEW),
        pytest.param(({}, PLAIN), ALL, marks=pytest.mark.slow),
        pytest.param((PLAIN, FUSED), ALL, marks=pytest.mark.slow),
    ],
    ids=("few plain", "plain", "fused"),
)
def test_pixels_do_not_depend_on_the_libraries_kernels(modes, what):
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, *what],
            env=os.environ | mode | {"OMP_NUM_THREADS": "1"},
            stdout=subprocess.PIPE,
            text=True,
        )
        for mode in modes
    ]
    shown = [run.communicate()[0].split() for run in runs]
    assert [run.returncode for run in runs] == [0, 0]
    assert shown[0] == shown[1]
    assert len(shown[0]) == 2 * (len(what) - 1 + 3)
