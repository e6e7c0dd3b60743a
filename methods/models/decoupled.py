"""Each training photo's appearance as a network tells it, learnt beside any model and dropped after training."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.model import Model, Moment
from splatproof.methods.training.schedules import log_linear
from splatproof.methods.training.terms import Frame, Photometric, Term, photometric_loss
from splatproof.reference.supervision.decoupled_appearance import (
    EMBEDDING,
    SPREAD,
    colour_map,
    drawn_network,
)
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

RATE = 1e-3
"""Adam's rate of the network and of the embeddings (the release that reproduces the paper)."""
NETWORK, PHOTOS = "appearance.", "photo_embeddings"
"""What the names of the network's tensors begin with, and the name of the photos' embeddings."""


class DecoupledModel(Model):
    """Any model, and beside it what a network says that each photo did to its colours.

    What it shows is what the model inside shows: the network is read by `appearance_loss` alone.
    """

    def __init__(self, base: Model, photos: Sequence[str], seed: int) -> None:
        """Start without any change of colour.

        Args:
            base: The model; its parameters get the network and an embedding for each photo.
            photos: Names of the training photos.
            seed: Seed of network and embeddings.
        """
        generator = torch.Generator().manual_seed(seed)
        embeddings = SPREAD * torch.randn(len(photos), EMBEDDING, generator=generator)
        network = {NETWORK + name: value for name, value in drawn_network(generator).items()}
        added = network | {PHOTOS: embeddings}
        base.parameters.shared.update(added)
        rates = {name: log_linear(RATE, RATE) for name in added}
        super().__init__(base.parameters, base.schedules | rates)
        self.base, self.photos, self.mode = base, tuple(photos), base.mode

    def splats(self, view: View, moment: Moment) -> Splats:
        """What the model inside shows.

        Args:
            view: What is looked at.
            moment: Step of training, or TRAINED.
        """
        return self.base.splats(view, moment)

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w c"]:
        """The image of the model inside.

        Args:
            view: What was rendered.
            output: What was rasterized.
        """
        return self.base.finish_image(view, output)

    @property
    def unbaked(self) -> tuple[str, ...]:
        """What the model inside adds; factors are of training alone."""
        return self.base.unbaked

    def factors(self, view: View, image: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        """What a photo did to the colours of its render; 1 for a view that is no training photo.

        Args:
            view: Its name tells.
            image: Its render.
        """
        if view.name not in self.photos:
            return torch.ones_like(image)
        shared = self.parameters.shared
        network = {
            name.removeprefix(NETWORK): value
            for name, value in shared.items()
            if name.startswith(NETWORK)
        }
        return colour_map(network, image, shared[PHOTOS][self.photos.index(view.name)])

    def facts(self) -> dict[str, Any]:
        """What the model inside needs beside the tensors."""
        return self.base.facts()


def appearance_loss(term: Photometric) -> Term:
    """In place of the photometric term: colours in the photo's appearance, structure of the render itself.

    Args:
        term: What it stands for: its weights and its name are kept.

    Source: Lin et al. 2024, "VastGaussian", Eq. 5.
    """

    def loss(frame: Frame) -> Float[Tensor, ""]:
        assert isinstance(frame.model, DecoupledModel)
        shown = frame.image * frame.model.factors(frame.view, frame.image)
        colours = photometric_loss(shown, frame.truth, dssim=0.0, mask=frame.mask)
        structure = photometric_loss(frame.image, frame.truth, dssim=1.0, mask=frame.mask)
        return (1 - term.dssim) * colours + term.dssim * structure

    return Term(name=term.name, loss=loss, weight=term.weight)
