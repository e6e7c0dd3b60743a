"""Pictures and scores of the held-out views."""

from dataclasses import replace
from pathlib import PurePosixPath
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from helpers.fake_methods import fake_scene, model_of
from splatproof.base.errors import DataError, UsageError
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.result import picture_name
from splatproof.suites.held_out import (
    TIMED_FRAMES,
    error_picture,
    render_milliseconds,
    score_views,
    to_8_bit,
)

PROTOCOL = load_protocol("default")
MODEL = model_of(0.3, "reference")


def test_bytes_are_rounded_half_up_and_clamped():
    image = torch.tensor([[[-1.0, 0.5 / 255, 0.4999 / 255], [1.0, 2.0, 254.5 / 255]]])
    assert to_8_bit(image).tolist() == [[[0, 1, 0], [255, 255, 255]]]


def test_error_picture_is_black_where_equal_or_not_scored_and_bright_where_not():
    truth = torch.full((16, 24, 3), 128 / 255)
    render = truth.clone()
    render[:, 12:] = torch.tensor([1.0, 0.0, 0.0])
    bright = error_picture("a", render, truth, PROTOCOL, None).astype(int).sum(axis=2)
    assert bright[:, -4:].min() > 200
    assert error_picture("a", truth, truth, PROTOCOL, None).max() <= 4  # magma starts at (0, 0, 4)
    mask = torch.zeros(16, 24, dtype=torch.bool)
    mask[:, :4] = True
    assert error_picture("a", render, truth, PROTOCOL, mask)[:, 12:].max() <= 4
    half = replace(PROTOCOL, region="right_half")
    left = error_picture("a", truth.flip(1), render.flip(1), half, None)
    assert left[:, :12].max() <= 4


def test_pictures_have_the_views_names_and_the_truths_size(tmp_path):
    scene = fake_scene("town", PROTOCOL)
    heard = []
    images = score_views(scene, MODEL, PROTOCOL, tmp_path, lambda *done: heard.append(done))
    assert heard == [(0, 2), (1, 2)]
    assert [image.name for image in images] == ["0.png", "3.png"]
    for kind in ("renders", "truth", "errors"):
        for image in images:
            picture = cv2.imread(str(tmp_path / kind / picture_name(image.name)))
            assert picture is not None
            assert picture.shape == (18, 24, 3)
    truth = cv2.imread(str(tmp_path / "truth" / "0.png"), cv2.IMREAD_UNCHANGED)
    assert truth is not None
    want = np.floor(scene.test_views[0].load().numpy() * 65535 + 0.5)
    assert np.array_equal(truth[..., ::-1], want)
    assert not (tmp_path / "masks").exists()


@pytest.mark.parametrize(
    ("drawn", "said"),
    [
        (
            lambda colour: SimpleNamespace(colour=(255 * colour).byte()),
            "torch.uint8 of 18 x 24 x 3",
        ),
        (
            lambda colour: SimpleNamespace(colour=colour.permute(2, 0, 1)),
            "torch.float32 of 3 x 18 x 24",
        ),
        (lambda colour: SimpleNamespace(colour=colour.numpy()), "a ndarray"),
        (lambda colour: colour, "a Tensor"),
    ],
)
def test_what_is_no_image_of_the_views_size_is_refused_by_name(tmp_path, drawn, said):
    def render(view, background):
        return drawn(MODEL.render(view, background).colour)

    model: Any = SimpleNamespace(render=render, kind="another's", primitives=1, store=render)
    with pytest.raises(
        UsageError, match=rf"0.png: .* kind \"another's\" rendered {said}, expected"
    ):
        score_views(fake_scene("town", PROTOCOL), model, PROTOCOL, tmp_path)


def test_masks_are_kept_where_a_view_has_one(tmp_path):
    mask = torch.ones(18, 24, dtype=torch.bool)
    mask[:5] = False
    scene = fake_scene("town", PROTOCOL)
    views = [
        replace(view, load_mask=mask.clone if i else None) for i, view in enumerate(scene.views)
    ]
    score_views(replace(scene, views=tuple(views)), MODEL, PROTOCOL, tmp_path)
    for name, want in (("0.png", torch.ones_like(mask)), ("3.png", mask)):
        stored = cv2.imread(str(tmp_path / "masks" / name), cv2.IMREAD_GRAYSCALE)
        assert stored is not None
        assert np.array_equal(stored, want.numpy() * 255)


def test_scenes_that_cannot_be_scored_leave_nothing(tmp_path):
    scene = fake_scene("town", PROTOCOL)
    with pytest.raises(DataError, match="no test view under protocol 'default'"):
        score_views(replace(scene, test=()), MODEL, PROTOCOL, tmp_path)
    views = list(scene.views)
    views[3] = replace(views[3], name=str(PurePosixPath(views[0].name).with_suffix(".tif")))
    with pytest.raises(DataError, match="two test views have the same name but for"):
        score_views(replace(scene, views=tuple(views)), MODEL, PROTOCOL, tmp_path)
    views[3] = replace(scene.views[3], load=lambda: torch.full((18, 24, 3), 2.0))
    with pytest.raises(DataError):
        score_views(replace(scene, views=tuple(views)), MODEL, PROTOCOL, tmp_path)
    assert not list(tmp_path.iterdir())


def test_views_of_several_folders_have_pictures_of_their_own(tmp_path):
    scene = fake_scene("town", PROTOCOL)
    views = [replace(view, name=f"camera_{i}/000.png") for i, view in enumerate(scene.views)]
    scores = score_views(replace(scene, views=tuple(views)), MODEL, PROTOCOL, tmp_path)
    found = {path.name for path in (tmp_path / "renders").iterdir()}
    assert found == {picture_name(score.name) for score in scores}
    assert found == {f"camera_{i}-000.png" for i in scene.test}


def test_what_moves_is_scored_apart_where_it_is_known(tmp_path):
    rules = replace(PROTOCOL, parts=("moving", "still"))
    scene = fake_scene("town", rules)
    moved = torch.zeros(18, 24, dtype=torch.bool)
    moved[3:9, 4:10] = True
    first = scene.test[0]
    masks = {"vehicles": moved, "people": torch.zeros_like(moved)}
    views = list(scene.views)
    views[first] = replace(views[first], load_moving=lambda: masks)
    known, unknown = score_views(replace(scene, views=tuple(views)), MODEL, rules, tmp_path)
    shares = {"moving": moved.double().mean(), "still": (~moved).double().mean()}
    mse = sum(share * 10 ** (-known.metrics[f"{p}_psnr"] / 10) for p, share in shares.items())
    assert float(mse) == pytest.approx(10 ** (-known.metrics["psnr"] / 10))
    assert np.isnan(unknown.metrics["moving_psnr"])
    plain = score_views(replace(scene, views=tuple(views)), MODEL, PROTOCOL, tmp_path / "plain")
    assert "moving_psnr" not in plain[0].metrics


@pytest.mark.parametrize("on_gpu", [True, False])
def test_a_frame_on_a_gpu_is_timed_until_it_is_drawn(monkeypatch, on_gpu):
    waits = []
    drawn = SimpleNamespace(colour=SimpleNamespace(is_cuda=on_gpu))
    monkeypatch.setattr(type(MODEL), "render", lambda *_: drawn)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: waits.append(None))
    views = list(fake_scene("town", PROTOCOL).test_views)
    assert render_milliseconds(views, MODEL, torch.zeros(3)) >= 0
    assert len(waits) == on_gpu * (1 + TIMED_FRAMES)
