"""What a backend draws of splats."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import camera, random_gaussians
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.models.decoded import gaussians_of
from splatproof.reference.rasterizer import spherical_harmonics
from splatproof.reference.types.splats import Splats, activated


def test_the_background_stands_behind_every_three_channels():
    splats = Splats(
        means=torch.zeros(1, 3), quaternions=torch.tensor([[1.0, 0, 0, 0]]),
        scales=torch.full((1, 3), 0.05), opacities=torch.tensor([0.5]),
        colours=torch.tensor([[0.1, 0.2, 0.3, 0.9, 0.8, 0.7]]),
    )  # fmt: skip
    background = torch.tensor([0.4, 0.5, 0.6])
    drawn = get_backend("cpu").draw(camera(2), splats, background=background).colour
    assert splats.colours is not None
    for part, colour in zip(drawn.split(3, dim=-1), splats.colours.split(3, dim=-1), strict=True):
        one = replace(splats, colours=colour)
        assert torch.equal(
            part, get_backend("cpu").draw(camera(2), one, background=background).colour
        )
    assert torch.equal(drawn[0, 0], background.repeat(2))


def mixed(lit: int, colours: int) -> Splats:
    """Ten splats: harmonics of the first `lit`, and colours."""
    g = random_gaussians(10, degree=1)
    return Splats(
        means=g.means, quaternions=g.quaternions, scales=g.scales, opacities=g.opacities,
        sh=g.sh[:lit], colours=g.sh[10 - colours :, 0].abs(),
    )  # fmt: skip


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_splats_with_harmonics_and_with_colours_are_drawn_and_baked_together(backend):
    splats, where = mixed(4, 6), camera(2)
    drawn = get_backend(backend).draw(where, splats, background=torch.tensor([0.1, 0.2, 0.3]))
    seen = spherical_harmonics.seen_colours(splats.means, where.centre, splats.sh, splats.colours)
    flat = replace(splats, sh=None, colours=seen)
    plain = get_backend(backend).draw(where, flat, background=torch.tensor([0.1, 0.2, 0.3]))
    torch.testing.assert_close(drawn.colour, plain.colour, atol=1e-6, rtol=0)
    back = get_backend(backend).draw(where, activated(gaussians_of(splats)))
    torch.testing.assert_close(
        back.colour, get_backend(backend).draw(where, splats).colour, atol=1e-5, rtol=0
    )


@pytest.mark.parametrize(("lit", "colours"), [(4, 5), (4, 10), (0, 9)])
def test_splats_that_lack_colours_or_have_two_are_refused(lit, colours):
    with pytest.raises(ValueError, match="10 splats"):
        mixed(lit, colours)
