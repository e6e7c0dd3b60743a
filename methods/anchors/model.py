"""A model of voxel anchors: those in view are decoded by networks into k Gaussians each."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor

from splatproof.methods.anchors.decoding import decode_some
from splatproof.methods.anchors.networks import network
from splatproof.methods.anchors.start import centres_of
from splatproof.methods.contracts.model import Model, Moment, Schedule
from splatproof.methods.contracts.parameters import Parameters
from splatproof.reference.anchors import scaffold
from splatproof.reference.partition.frustum import frustum
from splatproof.reference.types.camera import Camera, transform_points
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

NETWORKS = ("opacity", "shape", "colour")
BANK = "bank"
"""Name of the network that blends features by where they are seen from, where there is one."""


REACH = 3.0
"""Standard deviations of the offsets' scale within which an anchor may show something."""


class AnchorModel(Model):
    """Anchors whose offsets, features, scales and networks are trained; most stay where they are.

    Rows: offsets, features, log_scales. Labels: centres (a row where they move), and levels, at which
    level of growing an anchor was made (-1: from a point). Shared: the networks.
    """

    def __init__(
        self, parameters: Parameters, schedules: Mapping[str, Schedule], *, with_distance: bool
    ) -> None:
        """Take the tensors.

        Args:
            parameters: As `start.started` makes them.
            schedules: Rate of each trained tensor.
            with_distance: Whether the networks also read the distance to the camera.
        """
        super().__init__(parameters, schedules)
        self.with_distance = with_distance

    def anchors(self, index: Int[Tensor, " v"] | None = None) -> scaffold.Anchors:
        """The stored anchors.

        Args:
            index: Rows of those that are wanted; None: all.
        """
        parts = {"centres": centres_of(self.parameters), **self.parameters.rows}
        if index is not None:
            parts = {name: value.index_select(0, index) for name, value in parts.items()}
        return scaffold.Anchors(**parts)

    @torch.no_grad()
    def in_view(self, camera: Camera) -> Int[Tensor, " v"]:
        """Rows of the anchors that an image may show something of.

        Those in front of the near plane whose ball of 3 times the offsets' largest scale meets the
        pyramid that the image opens.

        Args:
            camera: Camera of the image.

        Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.2; its release takes the ellipse's 3 standard
            deviations on the image, which lie within the ball.
        """
        radius = REACH * self.parameters.rows["log_scales"][:, :3].amax(dim=1).exp()
        local = transform_points(camera, centres_of(self.parameters))
        sides = torch.from_numpy(frustum(camera)[1:, :3])  # all pass through the camera
        inwards = torch.nn.functional.normalize(sides, dim=1).T.to(local)
        inside = (local @ inwards).amin(dim=1)
        return torch.where((local[:, 2] > camera.near) & (inside > -radius))[0]

    def splats(self, view: View, moment: Moment) -> Splats:
        """What the anchors in view decode to; none is decoded that cannot be seen.

        Args:
            view: Its camera counts.
            moment: Not looked at.
        """
        del moment
        seen = self.in_view(view.camera)
        shared, centre = self.parameters.shared, view.camera.centre
        features = None
        if f"{BANK}.weight0" in shared:
            anchors = self.anchors(seen)
            code = scaffold.view_code(anchors.centres, centre)
            features = scaffold.blend_bank(anchors.features, network(BANK, shared), *code)
        decoder = scaffold.Decoder(**{name: network(name, shared) for name in NETWORKS})
        return decode_some(
            self.anchors(), decoder, centre, seen, with_distance=self.with_distance,
            features=features,
        )  # fmt: skip

    def facts(self) -> dict[str, Any]:
        """What `restored` needs beside the tensors."""
        return {"with_distance": self.with_distance}


def restored(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> AnchorModel:
    """The model that was stored; it is not trained on.

    Args:
        facts: What `AnchorModel.facts` said.
        tensors: As `Parameters.state` names them.

    Raises: KeyError or ValueError if something is missing or does not fit.
    """
    parameters = Parameters.of(tensors)
    for name in NETWORKS:
        network(name, parameters.shared)
    return AnchorModel(parameters, {}, with_distance=bool(facts["with_distance"]))
