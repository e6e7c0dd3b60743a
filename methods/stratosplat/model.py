"""Explicit Gaussians with parameters of their own, and virtual ones that a field gives each view."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from splatproof.methods.contracts.model import Moment, Schedule
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.models.gaussian_model import GaussianModel, assemble
from splatproof.methods.stratosplat.settings import Planes
from splatproof.methods.stratosplat.virtual import NETWORK, Stack, ViewSites, asked, view_sites
from splatproof.methods.training.schedules import Rates, log_linear
from splatproof.reference.layered_memory import multi_plane
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

KEPT_VIEWS = 32
"""Views whose sites are kept: they do not change while the field is trained."""
LAST = 0.1
"""The field's rates at the last step, as a share of those at the first."""


class HybridModel(GaussianModel):
    """Explicit and virtual Gaussians, composited together in one depth order.

    Virtual ones belong to no row (-1): density control does not see them, and their places, where rays
    meet planes, take no gradient. They move only through the field.

    Source: StratoSplat, Sec. 3.3.
    """

    def __init__(
        self,
        start: Gaussians,
        rates: Rates,
        *,
        extent: float,
        stack: Stack,
        planes: Planes,
        field: Mapping[str, Tensor],
        mode: Mode = "classic",
        sh_every: float = 0.0,
        dropout: float = 0.0,
    ) -> None:
        """Start from some Gaussians and a field.

        Args:
            start: Explicit Gaussians.
            rates: Their learning rates.
            extent: Size of the scene in scene units.
            stack: Planes and the field's box.
            planes: Kind of the field, and how rays and opacities are made.
            field: Its tensors, as `virtual.drawn_field` names them; at least one.
            mode: How all of it is rasterized.
            sh_every: Steps until one more band of harmonics is drawn; 0: all from the start.
            dropout: Share of explicit Gaussians hidden at the last step.
        """
        super().__init__(start, rates, extent=extent, mode=mode, sh_every=sh_every, dropout=dropout)
        self.parameters = Parameters(self.parameters.rows, shared=field)
        self.schedules |= field_schedules(field, planes.rate)
        self.stack, self.planes = stack, planes
        self._sites: dict[tuple, ViewSites] = {}

    def sites(self, camera: Camera) -> ViewSites:
        """Where a view has virtual Gaussians, kept for the views that were asked for last.

        Args:
            camera: The view's camera.
        """
        key = (camera.K.numpy().tobytes(), camera.world_to_camera.numpy().tobytes(), camera.width,
               camera.height, camera.near)  # fmt: skip
        found = self._sites.pop(key, None) or view_sites(self.stack, camera, self.planes)
        self._sites[key] = found
        if len(self._sites) > KEPT_VIEWS:
            del self._sites[next(iter(self._sites))]
        return found

    def virtual(self, camera: Camera) -> Splats:
        """The virtual Gaussians of a view.

        Args:
            camera: The view's camera.
        """
        found = self.sites(camera)
        return multi_plane.decoded(asked(self.parameters.shared, found), found.sites)

    def splats(self, view: View, moment: Moment) -> Splats:
        """Explicit Gaussians with their harmonics, and the virtual ones with their colours after them.

        Args:
            view: Its camera counts.
            moment: As for explicit Gaussians alone.
        """
        explicit, virtual = super().splats(view, moment), self.virtual(view.camera)
        rows = torch.arange(len(explicit))
        assert virtual.rows is not None
        return Splats(
            means=torch.cat([explicit.means, virtual.means]),
            quaternions=torch.cat([explicit.quaternions, virtual.quaternions]),
            scales=torch.cat([explicit.scales, virtual.scales]),
            opacities=torch.cat([explicit.opacities, virtual.opacities]),
            sh=explicit.sh,
            colours=virtual.colours,
            rows=torch.cat([rows, virtual.rows]),
        )

    def facts(self) -> dict[str, Any]:
        """What `restored` needs beside the tensors."""
        planes = self.planes
        return {
            "stack": self.stack.facts(), "mode": self.mode, "field": planes.field,
            "bias": planes.bias, "stride": planes.stride,
        }  # fmt: skip

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the kept sites, for snapshots."""
        return self.__dict__ | {"_sites": {}}


def field_schedules(field: Mapping[str, Tensor], rate: float) -> dict[str, Schedule]:
    """Rate of each tensor of the field, falling log-linearly to a tenth.

    Args:
        field: Its tensors by name.
        rate: Rate of grids and tables at the first step; 0 freezes the field.
    """
    rates = {name: rate / 5 if name in NETWORK else rate for name in field if rate}
    return {name: log_linear(first, LAST * first) for name, first in rates.items()}


def restored(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> HybridModel:
    """The model that was stored; it is not trained on.

    Args:
        facts: What `HybridModel.facts` said.
        tensors: As `Parameters.state` names them.

    Raises: KeyError, TypeError or ValueError if something is missing or does not fit.
    """
    stack = Stack.read(facts["stack"])
    if facts["mode"] not in ("classic", "antialiased"):
        raise ValueError(f"mode is {facts['mode']!r}")
    parameters = Parameters.of(tensors)
    rest = parameters.rows["sh_rest"].shape[1]
    planes = Planes(
        field=facts["field"], bias=bool(facts["bias"]), stride=int(facts["stride"]),
        count=len(stack.planes.offsets),
    )  # fmt: skip
    return HybridModel(
        assemble(parameters.rows, {0: 0, 3: 1, 8: 2, 15: 3}[rest]), Rates(), extent=1.0, stack=stack,
        planes=planes, field=parameters.shared, mode=facts["mode"],
    )  # fmt: skip
