"""Light of lamps alone: inverse square, a cosine lobe, shadows. Nothing else shines."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from splatproof.datasets.procedural.noise import inner
from splatproof.datasets.procedural.tracing import START, Caster

LOBE = 2.0
"""Exponent of the cosine by which a lamp's light falls off from its axis."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lamps:
    """Point lamps with an axis each."""

    caster: Caster
    positions: Float[np.ndarray, "k 3"]
    axes: Float[np.ndarray, "k 3"]
    """Unit vectors."""
    power: float
    """Irradiance over pi of a lamp at 1 metre on its axis."""

    def background(self, directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Darkness."""
        return torch.zeros_like(directions)

    def light(
        self,
        points: Float[np.ndarray, "n 3"],
        face_normals: Float[np.ndarray, "n 3"],
        normals: Float[Tensor, "n 3"],
    ) -> Float[Tensor, "n 3"]:
        """Irradiance over pi: sum_k P cos(axis)^m max(0, n.l) / d^2 over lamps that are seen.

        Args:
            points: Places on surfaces in metres.
            face_normals: Unit normals of the triangles there, towards the viewer.
            normals: Unit shading normals there, towards the viewer.
        """
        total = torch.zeros(len(points))
        starts = points + face_normals * START * 5
        for position, axis in zip(self.positions, self.axes, strict=True):
            ways = torch.from_numpy(position - points)
            distance = ways.norm(dim=1)
            ways = functional.normalize(ways, dim=1)
            lobe = (-inner(ways, torch.from_numpy(axis))).clamp(min=0) ** LOBE
            cosine = (ways.float() * normals).sum(dim=1).clamp(min=0)
            strength = self.power * lobe.float() * cosine / distance.float() ** 2
            wanted = np.flatnonzero((strength > 1e-4).numpy())
            shadowed = self.caster.blocked(
                starts[wanted], ways.numpy()[wanted], distance.numpy()[wanted] - START * 10
            )
            strength[torch.from_numpy(wanted[shadowed])] = 0
            total += strength
        return total[:, None] * torch.tensor([1.0, 0.97, 0.93])  # 5000 K
