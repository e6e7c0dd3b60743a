"""What a backend draws of splats."""

import torch

from helpers.tiny_scene import camera
from splatproof.methods.contracts.backends import get_backend
from splatproof.reference.types.splats import Splats


def test_the_background_stands_behind_every_three_channels():
    splats = Splats(
        means=torch.zeros(1, 3), quaternions=torch.tensor([[1.0, 0, 0, 0]]),
        scales=torch.full((1, 3), 0.05), opacities=torch.tensor([0.5]),
        colours=torch.tensor([[0.1, 0.2, 0.3, 0.9, 0.8, 0.7]]),
    )  # fmt: skip
    background = torch.tensor([0.4, 0.5, 0.6])
    drawn = get_backend("cpu").draw(camera(2), splats, background=background).colour
    for part, colour in zip(drawn.split(3, dim=-1), splats.colours.split(3, dim=-1), strict=True):  # type: ignore[union-attr]
        one = Splats(**{**vars(splats), "colours": colour})
        assert torch.equal(
            part, get_backend("cpu").draw(camera(2), one, background=background).colour
        )
    assert torch.equal(drawn[0, 0], background.repeat(2))
