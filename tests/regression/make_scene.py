"""Writes courtyard96/: thumbnails of the courtyard, committed because a machine that ray-casts them again may
round a few pixels otherwise, and other pixels cannot be compared.

    python tests/regression/make_scene.py
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from splatproof.base.files import write_text
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.scene_file import SceneFile, write_scene_file
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.scene import Scene

FOLDER = Path(__file__).parent / "courtyard96"
WIDTH = 96
"""Pixels: 28 views then take 0.4 MB."""
EVERY = 3
"""One in so many sparse points is kept: few enough that density control has work to do."""


def write_scene(scene: Scene, folder: Path) -> None:
    """A scene as photos and a COLMAP model in text without tracks.

    Args:
        scene: What is written, in metres; its views are pinhole cameras.
        folder: Photos go to photos/, the model to sparse/0.
    """
    cameras, images, points = ([f"# {kind}"] for kind in ("cameras", "images", "points"))
    (folder / "photos").mkdir(parents=True, exist_ok=True)
    for number, view in enumerate(scene.views, start=1):
        camera = view.camera
        pixels = np.floor(view.load().numpy() * 255 + 0.5).astype(np.uint8)
        cv2.imwrite(
            str(folder / "photos" / view.name), pixels[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9]
        )
        (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
        cameras.append(
            f"{number} PINHOLE {camera.width} {camera.height} {fx!r} {fy!r} {cx!r} {cy!r}"
        )
        pose = camera.world_to_camera.numpy()
        turn, move = quaternion(pose[:3, :3]), pose[:3, 3]
        numbers = " ".join(repr(float(x)) for x in (*turn, *move))
        images += [f"{number} {numbers} {number} {view.name}", ""]
    for number in range(0, len(scene.points.positions), EVERY):
        place = " ".join(f"{x:.5f}" for x in scene.points.positions[number].tolist())
        colour = " ".join(map(str, scene.points.colours[number].tolist()))
        points.append(f"{number + 1} {place} {colour} 0")
    model = folder / "sparse" / "0"
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        write_text(model / f"{name}.txt", "\n".join(lines) + "\n")
    facts = {"made_of": f"courtyard at {WIDTH} px, one of {EVERY} sparse points"}
    up = (float(scene.up[0]), float(scene.up[1]), float(scene.up[2]))
    write_scene_file(folder, SceneFile(units="metres", up=up, facts=facts))


def quaternion(turn: np.ndarray) -> np.ndarray:
    """Rotation matrix as (w, x, y, z), w >= 0.

    Args:
        turn: 3 x 3, orthogonal, determinant 1.
    """
    x, y, z, w = Rotation.from_matrix(turn).as_quat()
    found = np.array([w, x, y, z])
    return found if w >= 0 else -found


if __name__ == "__main__":
    write_scene(open_scene("courtyard", replace(load_protocol("quick"), width=WIDTH)), FOLDER)
