"""Models with an appearance code: which one a view has, and its fit to some columns of an image."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.contracts.reconstruction import Adapts, Stored
from splatproof.methods.models.adapting import chosen_code
from splatproof.methods.models.decoded import AdaptingModel, DecodedModel, loader
from splatproof.methods.models.gaussian_model import GaussianModel
from splatproof.methods.training.schedules import Rates
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View

SCENE = tiny_scene()
VIEW = SCENE.views[0]
LEFT, RIGHT = slice(0, 12), slice(12, 24)
PHOTOS = ("1.png", "2.png")
CODES = torch.tensor([[0.3, -0.2, 0.1], [-0.5, 0.4, 0.2]])
PLANTED = torch.tensor([-0.6, 0.25, 0.4])


class Tinted(GaussianModel):
    """Gaussians in light whose colour is the code's; right of the middle the code works backwards."""

    def __init__(self) -> None:
        super().__init__(random_gaussians(40), Rates(), extent=1.0)

    def neutral_code(self, view: View) -> Tensor:
        return torch.zeros(3)

    def finish_image(self, view: View, output: RenderOutput) -> Tensor:
        code = chosen_code(view, PHOTOS, CODES, self.neutral_code(view))
        sign = torch.ones(view.camera.width)
        sign[view.camera.width // 2 :] = -1
        return 0.5 * output.colour * (sign[:, None] * code).exp()


def tinted() -> DecodedModel:
    return DecodedModel.of("tinted", Tinted(), SCENE, "cpu")


def fitted(model: DecodedModel, image: Tensor, columns: slice, view: View = VIEW) -> Tensor:
    assert isinstance(model, Adapts)
    return model.fit_appearance(view.without_truth(), image[:, columns], columns)


def planted(model: DecodedModel) -> Tensor:
    return model.render(replace(VIEW, appearance=PLANTED)).colour


@pytest.mark.parametrize("columns", [LEFT, RIGHT, slice(3, 21)])
def test_a_planted_code_is_found_again_from_any_columns(columns):
    model = tinted()
    found = fitted(model, planted(model), columns)
    # the last rate that is tried is 1/64 of 0.05
    torch.testing.assert_close(found, PLANTED, atol=2e-3, rtol=0)


@pytest.mark.parametrize("columns", [LEFT, RIGHT])
def test_pixels_of_other_columns_do_not_matter(columns):
    model = tinted()
    image = planted(model)
    poisoned = torch.full_like(image, torch.nan)
    poisoned[:, columns] = image[:, columns]
    assert torch.equal(fitted(model, image, columns), fitted(model, poisoned, columns))


@pytest.mark.parametrize("columns", [LEFT, slice(3, 21)])
def test_masked_pixels_do_not_move_the_code(columns):
    model = tinted()
    assert isinstance(model, Adapts)
    mask = torch.ones(VIEW.size, dtype=torch.bool)
    mask[8:] = False  # more than half: the least absolute difference bears less
    white = planted(model).where(mask[..., None], torch.tensor(1.0))
    left = white[:, columns], columns
    found = model.fit_appearance(VIEW.without_truth(), *left, mask[:, columns])
    torch.testing.assert_close(found, PLANTED, atol=2e-3, rtol=0)
    whole = model.fit_appearance(VIEW.without_truth(), *left)
    assert float((whole - PLANTED).abs().max()) > 0.1


def test_a_view_of_which_no_pixel_counts_keeps_the_neutral_code():
    model = tinted()
    assert isinstance(model, Adapts)
    none = torch.zeros(VIEW.size, dtype=torch.bool)[:, LEFT]
    found = model.fit_appearance(VIEW.without_truth(), VIEW.load()[:, LEFT], LEFT, none)
    assert torch.equal(found, torch.zeros(3))


def test_a_fit_is_the_same_to_the_bit_and_leaves_the_parameters_alone():
    model = tinted()
    for value in model.model.parameters.trained.values():
        value.requires_grad_()  # as training leaves them
    before = {name: value.clone() for name, value in model.model.parameters.state().items()}
    image = planted(model)
    codes = [fitted(model, image, LEFT) for _ in range(2)]
    assert torch.equal(*codes)
    assert not codes[0].requires_grad
    after = model.model.parameters
    assert all(torch.equal(before[name], value) for name, value in after.state().items())
    assert all(value.grad is None for value in after.trained.values())


def test_a_fit_starts_at_the_neutral_code():
    model = tinted()
    neutral = model.render(replace(VIEW, name="elsewhere")).colour
    assert float(fitted(model, neutral, LEFT).abs().max()) == 0


def test_a_view_that_shows_nothing_keeps_the_neutral_code():
    away = replace(VIEW.camera, world_to_camera=VIEW.camera.world_to_camera.clone())
    away.world_to_camera[2, 3] = -100.0
    found = fitted(tinted(), VIEW.load(), LEFT, replace(VIEW, camera=away))
    assert torch.equal(found, torch.zeros(3))


def test_a_view_has_its_own_code_the_named_one_the_given_one_or_the_neutral_one():
    def code(name: str, appearance: str | Tensor | None) -> Tensor:
        view = replace(VIEW, name=name, appearance=appearance)
        return chosen_code(view, PHOTOS, CODES, torch.zeros(3))

    assert torch.equal(code("2.png", None), CODES[1])
    assert torch.equal(code("7.png", None), torch.zeros(3))
    assert torch.equal(code("7.png", "1.png"), CODES[0])
    assert torch.equal(code("2.png", "1.png"), CODES[0])
    assert torch.equal(code("2.png", PLANTED), PLANTED)
    with pytest.raises(UsageError, match=r"appearance '3.png' .*did you mean"):
        code("7.png", "3.png")
    with pytest.raises(UsageError, match=r"shape \(2,\), expected \(3,\)"):
        code("7.png", torch.zeros(2))


def test_only_a_model_with_a_code_adapts_loaded_or_not(tmp_path):
    plain = GaussianModel(random_gaussians(5), Rates(), extent=1.0)
    assert not isinstance(DecodedModel.of("plain", plain, SCENE, "cpu"), Adapts)
    stored: Stored = tinted().store(tmp_path)
    loaded = loader("tinted", lambda facts, tensors: Tinted())(tmp_path, stored, "cpu")
    assert isinstance(loaded, AdaptingModel)
    assert torch.equal(planted(loaded), planted(tinted()))
