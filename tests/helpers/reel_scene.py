"""A small world in the example package's own format: blobs, half of which drift as time passes."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from helpers.tiny_scene import camera, random_gaussians
from splatproof.datasets.photos import write_png
from splatproof.reference.rasterizer.rasterize import rasterize
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians

PLACES, TIMES, BLOBS = 6, 4, 40
SPEED = 0.25
"""Scene units a second along y, of every other blob."""


def world(time: float) -> Gaussians:
    """The blobs at a time in seconds."""
    blobs = random_gaussians(BLOBS, seed=5)
    moved = blobs.means.clone()
    moved[::2, 1] += SPEED * time
    return replace(blobs, means=moved)


def photo(where: Camera, time: float) -> torch.Tensor:
    """What a camera sees of the world at a time."""
    now = world(time)
    shown = rasterize(where, now.means, now.quaternions, now.scales, now.opacities, sh=now.sh)
    return shown.colour.clamp(0, 1)


def write_reel(folder: Path) -> None:
    """Photos of 48 x 36 pixels from 6 places at 4 times half a second apart, reel.csv, points.csv."""
    folder.mkdir(parents=True)
    lines = []
    for index in range(PLACES * TIMES):
        where, time = camera(index % PLACES, width=48, height=36), 0.5 * (index // PLACES)
        pixels = (photo(where, time) * 255).round().to(torch.uint8).numpy()
        write_png(folder / f"{index:02}.png", pixels)
        pose = torch.linalg.inv(where.world_to_camera)[:3].flatten().tolist()
        lines.append([f"{index:02}.png", 48, 36, float(where.K[0, 0]), *pose, time])
    with (folder / "reel.csv").open("w", newline="") as file:
        csv.writer(file).writerows(lines)
    np.savetxt(folder / "points.csv", world(0.0).means.double().numpy(), delimiter=",")
