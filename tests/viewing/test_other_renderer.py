"""An exported .ply in another project's rasterizer looks as it does in ours (docs/view.md says how to repeat it).

splat-transform (PlayCanvas) from npm draws with WebGPU; Chromium's SwiftShader stands in for a graphics card.
"""

import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from helpers.tiny_scene import random_gaussians
from splatproof.cli import main
from splatproof.methods.contracts.reconstruction import Origin, save_model
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.metrics.pixel import psnr
from splatproof.reference.types.scene import camera_view
from splatproof.viewing.poses import looking

PACKAGE = "@playcanvas/splat-transform@2.7.1"
SHADER = Path("/usr/lib/chromium/vk_swiftshader_icd.json")
LOADER = SHADER.with_name("libvulkan.so.1")
EYE, FORWARD, UP = ((1.5, -0.8, -4.0), (-0.35, 0.2, 1.0), (0.1, -1.0, 0.0))
WIDTH, HEIGHT, FIELD = 640, 360, 40.0
"""At 160 x 120 their version 2.7.1 draws one Gaussian and no other."""
pytestmark = pytest.mark.slow


def vector(values: tuple[float, ...]) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The other project's program, installed from npm."""
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("no npm on the PATH; on Debian: apt-get install npm")
    if not SHADER.exists() or not LOADER.exists():
        pytest.skip(f"no {SHADER}, which draws without a graphics card; apt-get install chromium")
    folder = tmp_path_factory.mktemp("npm")
    made = subprocess.run(
        [npm, "install", "--no-audit", "--no-fund", "--prefix", str(folder), PACKAGE],
        check=False, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    if made.returncode:
        pytest.skip(f"npm does not install {PACKAGE}: {made.stderr.strip()[-200:]}")
    (folder / "lib").mkdir()
    (folder / "lib" / LOADER.name).symlink_to(
        LOADER
    )  # alone: Chromium's other libraries would hide ours
    return folder


def theirs(other: Path, ply: Path, out: Path, *more: str, turned: bool = True) -> torch.Tensor:
    """Their picture of a file: files of this kind stand on their heads there, so the camera does too."""
    turn = vector((-1, -1, 1) if turned else (1, 1, 1))
    places = {"camera": vector(EYE), "look-at": vector(EYE) + vector(FORWARD), "up": vector(UP)}
    options = [f"--{k}=" + ",".join(f"{x:.12g}" for x in v * turn) for k, v in places.items()]
    done = subprocess.run(
        ["node", str(other / "node_modules/.bin/splat-transform"), "-w", "-g", "0", str(ply), *more,
         *options, "--fov", str(FIELD), "--resolution", f"{WIDTH}x{HEIGHT}", str(out)],
        env=os.environ | {"VK_ICD_FILENAMES": str(SHADER), "LD_LIBRARY_PATH": str(other / "lib")},
        check=False, capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-500:] + done.stderr[-500:]
    image = cv2.imread(str(out))
    assert image is not None
    return torch.from_numpy(np.ascontiguousarray(image[..., ::-1])).float() / 255


def test_an_exported_file_looks_the_same_elsewhere(other: Path, tmp_path: Path):
    blobs = random_gaussians(5000, degree=3, seed=2)
    model = ExplicitModel(model=replace(blobs, log_scales=blobs.log_scales - 1.8))
    save_model(model, tmp_path / "model", Origin())
    ply = tmp_path / "model.ply"
    assert main(["export", str(tmp_path / "model"), "--ply", str(ply), "--quiet"]) == 0
    camera = looking(
        vector(EYE), vector(FORWARD), vector(UP), field=FIELD, width=WIDTH, height=HEIGHT, near=0.2
    )
    ours = model.render(camera_view(camera)).colour.clamp(0, 1)
    same = psnr(theirs(other, ply, tmp_path / "same.webp"), ours)
    print(f"PSNR of their picture against ours: {same:.2f} dB")
    assert same > 40
    # the controls: a wrong half turn, and colours without their view-dependent part, are seen
    assert psnr(theirs(other, ply, tmp_path / "turned.webp", turned=False), ours) < same - 10
    assert psnr(theirs(other, ply, tmp_path / "flat.webp", "-H", "0"), ours) < same - 5
