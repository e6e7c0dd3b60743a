"""Depth of held-out views as pictures: near is bright, nothing is black."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import torch
from depth_lines import draw_depths, shaded
from strips import BAR

from helpers.tiny_scene import tiny_scene
from splatproof.metrics.protocol_files import load_protocol


def test_near_is_bright_and_nothing_is_black():
    depth = torch.tensor([[1.0, 2.0, 8.0, 0.0, torch.inf, torch.nan]])
    bright = shaded(depth, 1.0).astype(int).sum(axis=-1)[0]
    assert (np.diff(bright[:3]) < 0).all()
    assert (bright[3:] == bright[3]).all()
    assert bright[3] < bright[2]


def test_the_truth_stands_above_what_each_row_has(tmp_path, monkeypatch):
    scene = tiny_scene(points=4)
    height, width = scene.views[0].size
    truth = torch.full((height, width), 2.0)
    views = tuple(replace(view, load_depth=truth.clone) for view in scene.views)
    scene = replace(scene, views=views, test=(0, 1), train=())
    monkeypatch.setattr("depth_lines.open_scene", lambda name, protocol: scene)
    far = SimpleNamespace(render=lambda view: SimpleNamespace(depth=4 * truth))
    monkeypatch.setattr("depth_lines.load_reconstruction", lambda path: far)
    path = tmp_path / "depth.png"
    draw_depths(path, "any", load_protocol("tunnel"), {"a": tmp_path / "a"})
    assert not path.exists()
    (tmp_path / "a" / "model").mkdir(parents=True)
    draw_depths(path, "any", load_protocol("tunnel"), {"a": tmp_path / "a"})
    image = cv2.imread(str(path))
    assert image is not None
    assert image.shape == (2 * (BAR + height), 2 * width, 3)
    near, away = (
        image[(i + 1) * BAR + i * height + height // 2].astype(int).sum(axis=-1) for i in (0, 1)
    )
    assert near.min() > away.max()
