"""Make the pictures of docs/worlds.md: python docs/tools/make_world_pictures.py [WORLD ...]

Ray-casts a few views of each world's small preset, seed 0, and writes docs/images/world_<name>.jpg.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import torch

from splatproof.datasets.procedural import worlds
from splatproof.datasets.procedural.plan import Plan, Shot
from splatproof.datasets.procedural.ray_images import Frame, take

FOLDER = Path(__file__).parents[1] / "images"
PICKS: dict[str, tuple[str, ...]] = {
    "courtyard": ("view_001.png", "view_008.png", "view_012.png", "view_016.png", "view_022.png"),
    "city": ("nadir_00010.png", "nadir_00017.png", "unseen/oblique_00002.png",
             "unseen/oblique_00003.png", "unseen/facade_00003.png"),
    "aerial-sparse": tuple(
        f"{kind}/train_04.png" for kind in
        ("houses", "church", "mountain", "stadium", "town", "factory", "park", "downtown")
    ),
    "tunnel": ("stop_0000_camera_0.png", "relit/stop_0000_camera_0_relit.png", "stop_0000_camera_1.png",
               "stop_0004_camera_3.png", "stop_0006_camera_0.png"),
    "street": ("frame_0005_left.png", "frame_0005_front.png", "frame_0005_right.png",
               "frame_0010_front.png", "lane_shift/frame_0010_front_+3.5m.png"),
}  # fmt: skip


def picture(plan: Plan, shot: Shot) -> Frame:
    """One view as it is when the world is made."""
    stage = plan.stage(shot)
    return take(
        stage.caster, stage.lighting, shot.camera, samples=plan.samples,
        seed=plan.seed * 1_000_003 + plan.shots.index(shot), exposure=stage.exposure,
        seeds=stage.object_seeds,
    )  # fmt: skip


def depth_colours(frame: Frame) -> np.ndarray:
    """Depth as a picture: near is bright; what is infinitely far is black."""
    inverse = np.where(np.isfinite(frame.depth), 1 / frame.depth, 0)
    seen = inverse > 0
    low, high = np.percentile(inverse[seen], [2, 98])
    shade = np.clip((inverse - low) / (high - low), 0, 1) * 235 + 20
    coloured = cv2.applyColorMap(np.where(seen, shade, 0).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return cv2.cvtColor(coloured, cv2.COLOR_BGR2RGB) * seen[..., None]


def main() -> None:
    """Write the sheets of the worlds named on the command line, or of all."""
    torch.set_num_threads(1)
    FOLDER.mkdir(exist_ok=True)
    for world in sys.argv[1:] or list(PICKS):
        plan = worlds.plan(world, "small", 0)
        shots = {f"{s.group}/{s.name}".removeprefix("/"): s for s in plan.shots}
        frames = [picture(plan, shots[name]) for name in PICKS[world]]
        tiles = [frame.colour for frame in frames]
        if len(tiles) % 2:
            tiles.append(depth_colours(frames[1]))
        columns = 4 if len(tiles) == 8 else 3
        rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
        sheet = cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)
        path = FOLDER / f"world_{world}.jpg"
        cv2.imwrite(str(path), sheet, [cv2.IMWRITE_JPEG_QUALITY, 88])
        print(path)


if __name__ == "__main__":
    main()
