"""What pictures show of a model."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from splatproof.base.errors import UsageError
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.reference.types.scene import camera_view
from splatproof.viewing.asked import read_asked
from splatproof.viewing.frames import Wishes, frame_of, picture_of
from splatproof.viewing.modes import RIM, WALL, block_colours
from splatproof.viewing.stage import Shown, Stage

FREE = {
    "eye": "0.3,-0.2,-3.6", "forward": "0,0,1", "up": "0,-1,0", "fov": "34", "width": "48",
    "height": "36",
}  # fmt: skip


def drawn(stage: Stage, **told: str):
    return picture_of(stage, read_asked(stage, FREE | told))


def share_of(picture: torch.Tensor, colour: tuple[float, ...]) -> float:
    return float(((picture - torch.tensor(colour)).abs() < 2e-3).all(dim=2).double().mean())


def test_a_photos_own_camera_gives_the_photo(stage: Stage):
    asked = read_asked(stage, {"photo": "2", "width": "24"})
    picture, told = picture_of(stage, asked)
    assert stage.scene
    assert torch.allclose(picture, stage.scene.views[2].load(), atol=1e-5)
    assert float(told["psnr"].split()[0]) > 90
    wrong = picture_of(stage, read_asked(stage, {"photo": "2", "width": "24", "model": "1"}))[1]
    assert float(wrong["psnr"].split()[0]) < 20


def test_a_frame_is_the_picture(stage: Stage):
    frame = frame_of(stage, read_asked(stage, FREE | {"quality": "95"}))
    image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    exact = (drawn(stage)[0] * 255).numpy()
    assert np.abs(image[..., ::-1] - exact).mean() < 3
    assert np.abs(image - exact).mean() > 6  # the control: red and blue are not swapped


def test_the_split_shows_each_model_on_its_side(stage: Stage):
    left, right = drawn(stage)[0], drawn(stage, model="1")[0]
    both = drawn(stage, model="0", other="1", split="0.25")[0]
    assert torch.allclose(both[:, :12], left[:, :12], atol=1e-5)
    assert torch.allclose(both[:, 12:], right[:, 12:], atol=1e-5)
    assert not torch.allclose(left, right, atol=0.05)
    assert torch.equal(drawn(stage, other="1", split="1")[0], left)
    assert torch.equal(drawn(stage, other="1", split="0")[0], right)


def test_the_error_is_none_for_the_truth_and_seen_for_a_wrong_model(stage: Stage):
    told = drawn(stage, mode="error", photo="2", width="24")[1]
    assert told["photo"] == "2.png"
    assert float(told["mean error"]) < 1e-4
    assert float(told["compared"].rstrip("%")) > 20
    wrong = drawn(stage, mode="error", photo="2", width="24", model="1")[1]
    assert float(wrong["mean error"]) > 0.1
    beside = drawn(stage, mode="error")[1]  # from another camera: carried over by depth
    assert (
        0
        < float(beside["mean error"])
        < 0.5 * float(drawn(stage, mode="error", model="1")[1]["mean error"])
    )


def test_what_is_behind_the_cameras_is_unseen(stage: Stage):
    assert (
        _pink(stage) < 0.1
    )  # 0.044: blobs overlap, and depth is the mean of what one sees through
    stage.models = (replace(stage.models[0], model=_doubled(stage)), *stage.models[1:])
    assert _pink(stage, eye="0,0,-4.2", forward="0,0,-1") > 0.99
    told = drawn(stage, mode="unseen", eye="0,0,-4.2", forward="0,0,-1")[1]
    assert float(told["unseen"].split("%")[0]) > 99  # the sky there is on no photo either


def _pink(stage: Stage, **told: str) -> float:
    """Share that is marked unseen of what the model covers."""
    colour, marked = drawn(stage, **told)[0], drawn(stage, mode="unseen", **told)[0]
    camera = read_asked(stage, FREE | told).camera
    covered = stage.models[0].model.render(camera_view(camera)).alpha >= 0.5
    assert int(covered.sum()) > 100
    return float(((marked - colour).abs().amax(dim=2) > 1e-3)[covered].double().mean())


def _doubled(stage: Stage):
    """The model, and a copy of it behind all cameras."""
    model = stage.models[0].model
    assert isinstance(model, ExplicitModel)
    parts = {name: torch.cat([value, value]) for name, value in vars(model.model).items()}
    parts["means"][len(model.model) :, 2] -= 8.4
    return replace(model, model=replace(model.model, **parts))


def test_depth_is_nearer_in_red(stage: Stage):
    picture, told = drawn(stage, mode="depth")
    near = drawn(stage, mode="depth", eye="0.3,-0.2,-1.4")[0]
    lit = lambda image: image[image.sum(dim=2) > 0.3].mean(dim=0)
    assert lit(near)[0] > lit(picture)[0]
    assert "log scale" in told["depth"]


def test_blocks_have_colours_of_their_own(stage: Stage):
    picture = drawn(stage, model="2", mode="blocks", eye="0,0,-4")[0]
    one, other = block_colours(2)
    reds, blues = (((picture - c * picture.amax(2, True)).abs().sum(2) < 0.1) for c in (one, other))
    columns = lambda mask: float(torch.where(mask & (picture.sum(2) > 0.2))[1].double().mean())
    assert columns(reds) < 24 < columns(blues)  # block 0 is at x < 0


def test_seams_lie_between_the_blocks(stage: Stage):
    picture, told = drawn(stage, model="2", mode="seams", eye="0,0,-4")
    wall = (picture - torch.tensor(WALL)).abs().amax(dim=2) < 1e-6
    assert bool(wall.any())
    where = torch.where(wall)[1].double()
    assert 18 < float(where.mean()) < 30
    assert float(told["seam pixels"].rstrip("%")) > 1
    rim = picture[..., 0] - picture[..., 2] > 0.5
    assert bool(rim.any())
    assert RIM[0] > RIM[2]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"mode": "blocks"}, "not trained in blocks"),
        ({"mode": "dept"}, "did you mean"),
        ({"eye": "1,2"}, "eye is '1,2'"),
        ({"forward": "0,1,0"}, "two directions"),
        ({"fov": "nan"}, "fov is 'nan'"),
        ({"width": "0"}, "width is 0, expected 1"),
        ({"width": "12.5"}, "whole number"),
        ({"height": "99999"}, "height is 99999"),
        ({"model": "3"}, "model is 3"),
        ({"photo": "6"}, "photo is 6"),
        ({"light": "0.png"}, "not the name of a training view"),
        ({"split": "1.5"}, "split is 1.5"),
        ({"colour": "red"}, "unknown field 'colour'"),
    ],
)
def test_a_strange_wish_is_refused_by_name(stage: Stage, told: dict[str, str], words: str):
    with pytest.raises(UsageError, match=words):
        drawn(stage, **told)


def test_without_a_scene_photos_are_missing_and_the_rest_works(stage: Stage):
    alone = Stage(stage.models[:1], None)
    assert drawn(alone)[0].shape == (36, 48, 3)
    with pytest.raises(UsageError, match="--scene"):
        drawn(alone, mode="error")


def test_light_is_that_of_the_photo_that_is_named(stage: Stage, lit):
    stage.models = (Shown(name="lit", model=lit),)
    neutral, bright = drawn(stage)[0], drawn(stage, light="1.png")[0]
    inside = (bright < 1) & (neutral > 0.02)
    gain = (bright / neutral)[inside]
    assert float(gain.median()) == pytest.approx(float(np.exp(1 - 1 / 5)), rel=1e-3)


def test_only_the_newest_wish_of_a_page_counts():
    wishes = Wishes()
    for page, turn in (("a", 1), ("a", 3), ("b", 1), ("a", 2)):
        wishes.add(page, turn)
    assert [wishes.is_old("a", turn) for turn in (1, 2, 3)] == [True, True, False]
    assert not wishes.is_old("b", 1)
    assert not wishes.is_old("nobody", 0)
