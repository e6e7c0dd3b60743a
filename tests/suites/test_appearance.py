"""A protocol's appearance is carried out: nearest, half, exposure; the scored half stays unseen."""

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import tiny_scene
from splatproof.base.errors import SplatproofError, UsageError
from splatproof.methods.contracts.reconstruction import Stored
from splatproof.metrics.protocol_files import load_protocol
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View
from splatproof.suites import appearance
from splatproof.suites.held_out import score_views

RULES = replace(load_protocol("default"), metrics=("psnr",))
HALF = replace(RULES, appearance="half", region="right_half")
GAIN = 0.5


@dataclass(frozen=True, eq=False)
class Lit:
    """Shows the true photos in another light: darker, unless it is told the right gain."""

    scene: Scene
    seen: list
    kind: str = "lit"
    primitives: int = 1

    def render(self, view: View, background: Tensor | None = None) -> RenderOutput:
        with pytest.raises(SplatproofError, match="not for training"):
            view.load()
        photo = next(other for other in self.scene.views if other.name == view.name).load()
        gain = view.appearance if isinstance(view.appearance, Tensor) else GAIN
        self.seen.append(view)
        flat = torch.zeros(photo.shape[:2])
        return RenderOutput(colour=photo * gain, alpha=flat, depth=flat, radii=torch.zeros(1))

    def store(self, folder) -> Stored:
        raise AssertionError("nothing is saved here")


class Fitting(Lit):
    """Fits its gain to what it is given."""

    def fit_appearance(
        self, view: View, image: Tensor, columns: slice, mask: Tensor | None = None
    ) -> Tensor:
        assert image.shape[1] == columns.stop - columns.start
        counts = torch.ones(image.shape[:2], dtype=torch.bool) if mask is None else mask
        photo = next(other for other in self.scene.views if other.name == view.name).load()
        return (image[counts].sum() / photo[:, columns][counts].sum()).reshape(1)


def dim(scene: Scene) -> Scene:
    """The scene with photos of values that a gain can neither clip nor hide."""

    def shaded(view: View) -> View:
        photo = (0.2 + 0.4 * view.load()).contiguous()
        return replace(view, load=lambda: photo)

    return replace(scene, views=tuple(shaded(view) for view in scene.views))


SCENE = dim(tiny_scene())


def psnr(model: Lit, rules, folder) -> float:
    images = score_views(SCENE, model, rules, folder)
    return images[0].metrics["psnr"]


def test_without_appearance_the_other_light_costs(tmp_path):
    right = replace(RULES, region="right_half")
    assert psnr(Lit(SCENE, []), right, tmp_path) < 20


def test_half_lets_a_model_that_can_fit_its_light_to_the_left_half(tmp_path):
    assert psnr(Fitting(SCENE, []), HALF, tmp_path) > 45
    assert psnr(Lit(SCENE, []), HALF, tmp_path) < 20  # this one cannot
    assert "none to fit" in appearance.told(Lit(SCENE, []), HALF, SCENE)
    assert appearance.told(Fitting(SCENE, []), HALF, SCENE) == "half"


def test_the_nearest_views_light_needs_sensors_and_says_where_they_lack():
    def told(*sensors: str) -> str:
        names = [sensors[index % len(sensors)] for index in range(len(SCENE.views))]
        views = (replace(v, sensor=name) for v, name in zip(SCENE.views, names, strict=True))
        scene = replace(SCENE, views=tuple(views), test=(0,), train=(1, 2))
        return appearance.told(Lit(SCENE, []), replace(RULES, appearance="nearest"), scene)

    assert told("left") == "nearest"
    assert told("").startswith("nearest: no view names its sensor (views.json does)")
    assert "appearance = none does without" in told("")
    assert told("left", "right", "front") == (
        "nearest: no training view is of sensor 'left': those of all sensors count"
    )


def test_exposure_is_fitted_for_any_model(tmp_path):
    rules = replace(HALF, appearance="exposure")
    assert psnr(Lit(SCENE, []), rules, tmp_path) > 40


@pytest.mark.parametrize("mode", ["half", "exposure"])
def test_nothing_of_the_scored_half_is_looked_at(mode, tmp_path):
    """Another right half of the truth leaves what is shown as it is."""
    rules = replace(HALF, appearance=mode)

    def shown(scene: Scene) -> Tensor:
        model = Fitting(SCENE, [])
        view = scene.test_views[0]
        asked = appearance.shown(view, scene.train_views, model, rules)
        return appearance.exposed(view, model.render(asked).colour, rules)

    def spoilt(view: View) -> View:
        photo = view.load().clone()
        photo[:, (photo.shape[1] + 1) // 2 :] = 0.9
        return replace(view, load=lambda: photo)

    other = replace(SCENE, views=tuple(spoilt(view) for view in SCENE.views))
    assert torch.equal(shown(SCENE), shown(other))
    left = replace(HALF, appearance="oracle", region="full")
    asked = appearance.shown(other.test_views[0], other.train_views, Fitting(SCENE, []), left)
    assert isinstance(asked.appearance, Tensor)
    assert float(asked.appearance) != pytest.approx(1.0, abs=1e-3)  # the oracle does look


@pytest.mark.parametrize("mode", ["half", "oracle", "exposure"])
def test_nothing_masked_is_looked_at(mode):
    """Brighter where the mask says that a photo holds nothing: no matter, unless masks do not count."""
    mask = torch.ones(SCENE.test_views[0].size, dtype=torch.bool)
    mask[3:9, 2:8] = mask[3:9, 15:20] = False
    view = replace(SCENE.test_views[0], load_mask=lambda: mask)
    bright = view.load().where(mask[..., None], torch.tensor(0.9))

    def shown(view: View, masked: bool = True) -> Tensor:
        rules = replace(HALF, appearance=mode, masked=masked)
        model = Fitting(SCENE, [])
        asked = appearance.shown(view, SCENE.train_views, model, rules)
        return appearance.exposed(view, model.render(asked).colour, rules)

    spoilt = replace(view, load=lambda: bright)
    assert torch.equal(shown(view), shown(spoilt))
    assert not torch.equal(shown(view, masked=False), shown(spoilt, masked=False))


def test_nearest_names_a_training_view_for_the_model():
    rules = replace(RULES, appearance="nearest")
    asked = appearance.shown(SCENE.test_views[0], SCENE.train_views, Lit(SCENE, []), rules)
    assert asked.appearance == "1.png"  # cameras stand in a row


@pytest.mark.parametrize("mode", ["half", "exposure"])
def test_a_protocol_that_would_score_what_was_looked_at_is_refused(mode, tmp_path):
    path = tmp_path / "leaks.toml"
    path.write_text(f'source = "ours"\nappearance = "{mode}"\n')
    with pytest.raises(UsageError, match="left half"):
        load_protocol(str(path))
