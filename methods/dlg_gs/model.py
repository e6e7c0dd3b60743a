"""Anchors whose Gaussians' colours adapt to the light of a view."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.anchors import model as anchors
from splatproof.methods.anchors.model import NETWORKS, AnchorModel
from splatproof.methods.anchors.networks import network
from splatproof.methods.anchors.start import centres_of
from splatproof.methods.contracts.model import Moment, Schedule
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.dlg_gs.attention import attention_among
from splatproof.methods.dlg_gs.gates import attention_inputs, gated_projections
from splatproof.methods.dlg_gs.light import factors
from splatproof.methods.dlg_gs.neighbours import Neighbours, neighbours
from splatproof.methods.kernels import colour_head as native
from splatproof.methods.models.adapting import chosen_code
from splatproof.reference.anchors import attention
from splatproof.reference.anchors.lighting_appearance import mix_colours
from splatproof.reference.types import mlp
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

HEAD = "head"
"""Name of the colour head among the networks."""
GATES = ("anchor_kernel", "feature_kernel", "value")
"""Weights of the attention where an anchor sees none but itself."""
MIXING = ("query", "key")
"""Weights that it has besides where anchors see one another."""
INPUTS = 28
"""Numbers of the attention's inputs: 24 of the Fourier code, direction, distance."""
SLACK = 0.2
"""Share of the radius by which the kept lists reach farther where anchors move: they hold until one
has moved by half of it, and what they hold beyond the radius is left out in every step."""


@dataclass(frozen=True, kw_only=True)
class Lighting:
    """What lighting-adaptive colours need beside the tensors."""

    views: tuple[str, ...]
    """Names of the training views, in the order of the factors."""
    low: tuple[float, float, float]
    """Corner of the scene's box with the smallest coordinates, scene units."""
    high: tuple[float, float, float]
    """The opposite corner."""
    radius: float
    """How far an anchor sees others, scene units."""
    extent: float
    """Unit in which networks read distances, in scene units."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LitSplats(Splats):
    """Splats with adapted and original colours, for a render of the adapted ones alone.

    As a part of both they would have a gradient of six channels, half of them zeros.
    """

    adapted: Float[Tensor, "n 3"]
    """The first three channels of `colours`."""


class DlgModel(AnchorModel):
    """An AnchorModel whose splats have two colours while it trains: adapted c~ and original c.

    Once trained it shows c~ alone. A view's light is the code that its appearance is, or that of the
    training view which its appearance names; without an appearance its own if it was trained on, else
    the neutral one, the mean over the training views. More shared tensors: those of the colour head
    and of the attention, and what factors are made of.
    """

    def __init__(
        self,
        parameters: Parameters,
        schedules: Mapping[str, Schedule],
        *,
        with_distance: bool,
        lighting: Lighting,
    ) -> None:
        """Take the tensors.

        Args:
            parameters: As `start.started` makes them, with those of the lighting.
            schedules: Rate of each trained tensor.
            with_distance: Whether the decoding networks also read the distance to the camera.
            lighting: Where and among whom colours adapt.
        """
        super().__init__(parameters, schedules, with_distance=with_distance)
        self.lighting = lighting
        self._kept: tuple[Tensor, Tensor, Neighbours] | None = None

    def splats(self, view: View, moment: Moment) -> Splats:
        """What the anchors in view decode to, in the light of the view.

        Args:
            view: Its camera, name and appearance count.
            moment: While it trains, the original colours follow the adapted ones as channels 4 to 6.
        """
        splats = super().splats(view, moment)
        original, seen, rows = splats.colours, splats.decoded, splats.rows
        assert original is not None
        assert seen is not None
        assert rows is not None
        place = torch.empty(len(self.parameters), dtype=torch.int64, device=seen.device)
        place[seen] = torch.arange(len(seen), device=seen.device)
        adapted = adapted_colours(
            network(HEAD, self.parameters.shared), original, self.factor(view),
            self.attended(view.camera, seen), place.index_select(0, rows),
        )  # fmt: skip
        if not moment.trains:
            return replace(splats, colours=adapted)
        both = torch.cat([adapted, original], dim=1)
        return LitSplats(**vars(splats) | {"colours": both, "adapted": adapted})

    def factor(self, view: View) -> Float[Tensor, " e"]:
        """eps_s that a view is shown in, see `chosen_code`.

        Args:
            view: Its name and appearance count.
        """
        every = factors(self.parameters.shared)
        return chosen_code(view, self.lighting.views, every, every.mean(dim=0))

    def neutral_code(self, view: View) -> Float[Tensor, " e"]:
        """The mean factor of the training views.

        Args:
            view: Not looked at.
        """
        del view
        return factors(self.parameters.shared).mean(dim=0)

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w 3"]:
        """The image in the view's light.

        Args:
            view: Not looked at.
            output: With its colours as the first three channels.
        """
        del view
        colour = output.colour
        return (
            colour[..., :3] if colour.shape[2] > 3 else colour
        )  # a part costs a picture of zeros to derive

    @property
    def unbaked(self) -> tuple[str, ...]:
        """Nothing: the light is in the splats' colours."""
        return ()

    def attended(self, camera: Camera, seen: Int[Tensor, " v"]) -> Float[Tensor, "v 28"]:
        """f_out of the anchors in view: gated inputs, mixed with those of neighbours in view.

        Where they stand is read, not trained: light does not pull at anchors through its code.

        Args:
            camera: From where they are seen.
            seen: Their rows.
        """
        every = centres_of(self.parameters).detach()
        if not len(seen):
            return every.new_zeros(0, INPUTS)
        centres = every[seen]
        weights = self.attention_weights()
        inputs = self.attention_inputs(camera, centres)
        if not self.mixes:
            return attention.pooled_gates(inputs, weights) @ weights.value
        # Lists of what stands still are exact.
        radius = self.lighting.radius if self.moves else math.inf
        projected = gated_projections(inputs, weights)
        return attention_among(*projected, seen, self._neighbours(every), every, radius)

    def attention_inputs(
        self, camera: Camera, centres: Float[Tensor, "v 3"]
    ) -> Float[Tensor, "v 28"]:
        """x_attn: Fourier code of where an anchor stands, direction to it, distance in extents.

        Args:
            camera: From where it is seen.
            centres: Where it stands.
        """
        low, high = (centres.new_tensor(each) for each in (self.lighting.low, self.lighting.high))
        return attention_inputs(centres, low, high, camera.centre, self.lighting.extent)

    def attention_weights(self) -> attention.AttentionWeights:
        """Gates and projections; without query and key where anchors see none but themselves."""
        shared = self.parameters.shared
        value = shared["attention.value"]
        query, key = (
            shared[f"attention.{name}"] if self.mixes else value.new_zeros(len(value), 0)
            for name in MIXING
        )
        return attention.AttentionWeights(
            anchor_kernel=shared["attention.anchor_kernel"],
            feature_kernel=shared["attention.feature_kernel"], query=query, key=key, value=value,
        )  # fmt: skip

    @property
    def mixes(self) -> bool:
        """Whether anchors see one another."""
        return f"attention.{MIXING[0]}" in self.parameters.shared

    @property
    def moves(self) -> bool:
        """Whether anchors move."""
        return "centres" in self.parameters.rows

    def _neighbours(self, centres: Float[Tensor, "n 3"]) -> Neighbours:
        """Lists of all anchors, made again when anchors came, went or moved too far."""
        slack = SLACK * self.lighting.radius if self.moves else 0.0
        if self._kept is not None:
            kept, then, lists = self._kept
            # `kept` holds on to its memory, so what lies there now is what it was.
            same = kept.data_ptr() == centres.data_ptr() and len(kept) == len(centres)
            if same and (not self.moves or _farthest(centres, then) <= slack / 2):
                return lists
        lists = neighbours(centres, self.lighting.radius + slack)
        self._kept = (centres, centres.clone() if self.moves else centres, lists)
        return lists

    def facts(self) -> dict[str, Any]:
        """What `restored` needs beside the tensors."""
        return super().facts() | {"lighting": asdict(self.lighting)}


def _farthest(centres: Tensor, then: Tensor) -> float:
    """How far the anchor that moved most has moved; 0 without any."""
    if not len(centres):
        return 0.0
    square = (centres - then).square_() @ centres.new_ones(3)  # sooner than sums of so short rows
    return math.sqrt(float(square.amax()))


def adapted_colours(
    head: mlp.Mlp,
    colours: Float[Tensor, "m 3"],
    factor: Float[Tensor, " e"],
    attended: Float[Tensor, "n v"],
    owner: Int[Tensor, " m"],
) -> Float[Tensor, "m 3"]:
    """c~ of the reference's `adapt_colours`, which it differs from by rounding only.

    What the first layer makes of factor and anchor is computed once an anchor.

    Args:
        head: Three layers; 4 outputs: alpha 3, beta 1 for all channels.
        colours: Colours c of the Gaussians, in [0, 1].
        factor: eps_s of the view.
        attended: f_out of each anchor in view.
        owner: Anchor that each Gaussian was decoded from, ascending.

    Source: DLG-GS, Eqs. 12 and 13.
    """
    first, *others = head.weights
    of_colour, of_factor, of_anchor = first.split([3, len(factor), attended.shape[1]])
    of_each = torch.addmm(factor @ of_factor + head.biases[0], attended, of_anchor)
    if native.applies(colours, of_each, head):
        return native.adapt(colours, of_each, owner, head)
    hidden = torch.relu(colours @ of_colour + of_each.index_select(0, owner))
    rest = mlp.Mlp(weights=tuple(others), biases=head.biases[1:])
    out = torch.sigmoid(mlp.evaluate(rest, hidden))
    return mix_colours(colours, out[:, :3], out[:, 3:])


def restored(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> AnchorModel:
    """The model that was stored; it is not trained on.

    Args:
        facts: What `facts` of the model said; without "lighting" its colours do not adapt.
        tensors: As `Parameters.state` names them.

    Raises: KeyError, TypeError or ValueError if something is missing or does not fit.
    """
    if "lighting" not in facts:
        return anchors.restored(facts, tensors)
    parameters = Parameters.of(tensors)
    for name in (*NETWORKS, HEAD):
        network(name, parameters.shared)
    told = facts["lighting"]
    lighting = Lighting(
        views=tuple(told["views"]), low=tuple(told["low"]), high=tuple(told["high"]),
        radius=float(told["radius"]), extent=float(told["extent"]),
    )  # fmt: skip
    return DlgModel(parameters, {}, with_distance=bool(facts["with_distance"]), lighting=lighting)
