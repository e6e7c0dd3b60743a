"""The strip of consecutive moments: which views it shows, and what of them."""

from dataclasses import replace

import cv2
import numpy as np
import torch
from moment_lines import BESIDE, WIDTH, draw_moments, moments
from strips import BAR, crops, tile_of

from helpers.tiny_scene import tiny_scene
from splatproof.metrics.protocol_files import load_protocol
from splatproof.suites.held_out import to_8_bit


def drive(moving: dict[int, int]):
    """Twelve moments of two cameras, every fourth held out; by moment, how wide what moves is."""
    scene = tiny_scene(points=4)
    first, views = scene.views[0], []
    for sensor in ("front", "left"):
        for moment in range(12):
            mask = torch.zeros(first.size, dtype=torch.bool)
            mask[:4, : moving.get(moment, 0)] = True
            load = lambda mask=mask: {"vehicles": mask}
            name = f"{sensor}_{moment:02d}.png"
            time = moment / 10
            views.append(replace(first, name=name, sensor=sensor, time=time, load_moving=load))
    held = tuple(i for i, view in enumerate(views) if int(view.name[-6:-4]) % 4 == 0)
    rest = tuple(i for i in range(len(views)) if i not in held)
    return replace(scene, views=tuple(views), test=held, train=rest)


def test_the_held_out_moment_with_most_that_moves_is_in_the_middle():
    found = moments(drive({4: 2, 8: 5, 6: 9}), "left")
    assert [view.name for view in found] == [f"left_{i:02d}.png" for i in (6, 7, 8, 9, 10)]
    # the first has no two moments before it
    assert moments(drive({0: 9, 4: 1}), "front")[BESIDE].name == "front_04.png"


def test_a_row_without_a_model_draws_nothing(tmp_path):
    path = tmp_path / "strip.jpg"
    draw_moments(path, "street", load_protocol("street"), {"pvg": tmp_path / "pvg"}, "left")
    assert not path.exists()


def test_photos_stand_above_what_each_row_made(tmp_path, monkeypatch):
    scene = drive({8: 5})
    monkeypatch.setattr("moment_lines.open_scene", lambda name, protocol: scene)
    (tmp_path / "a" / "model").mkdir(parents=True)
    levels = {"a": 0.25, "b": 0.75}
    (tmp_path / "b" / "model").mkdir(parents=True)
    monkeypatch.setattr("moment_lines.load_reconstruction", lambda path: levels[path.parent.name])
    monkeypatch.setattr(
        "moment_lines.drawn",
        lambda view, training, model, rules: torch.full((*view.size, 3), model),
    )
    path = tmp_path / "strip.png"
    folders = {row: tmp_path / row for row in levels}
    draw_moments(path, "any", load_protocol("street"), folders, "front")
    image = cv2.imread(str(path))
    assert image is not None
    assert image.shape[1] == (2 * BESIDE + 1) * WIDTH
    tile = (image.shape[0] - 3 * BAR) // 3
    middles = [image[BAR + i * (tile + BAR) + tile // 2] for i in range(3)]
    np.testing.assert_array_equal(middles[1], 64)
    np.testing.assert_array_equal(middles[2], 191)
    crop = crops([scene.views[8]])[0]  # all views have one photo
    photo = tile_of(to_8_bit(scene.views[8].load())[..., ::-1], crop, WIDTH)
    np.testing.assert_array_equal(middles[0], np.tile(photo[tile // 2], (2 * BESIDE + 1, 1)))
    assert len(np.unique(middles[0])) > 1
