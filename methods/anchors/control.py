"""Density control of anchors: growing on grids of three levels, and pruning of what stays transparent."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Int
from torch import Tensor

from splatproof.methods.anchors.start import centres_of
from splatproof.methods.contracts.density_strategy import Observation, Statistic
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.training.schedules import require, shrink, shrunk_interval
from splatproof.reference.anchors import scaffold

FINER = 4
"""Cells of one level along the edge of a cell of the level above."""


@dataclass(frozen=True, kw_only=True)
class AnchorDensity:
    """Growing and pruning. Steps are those of a 30,000 iteration run; shorter runs shrink them."""

    start: int = 500
    """No statistics up to this step."""
    adjust_start: int = 1500
    """No growing and pruning up to this step."""
    stop: int = 15_000
    """No statistics, growing and pruning from this step on."""
    interval: int = 100
    """Steps between adjustments. Shrinks to no less than `least_interval`, unless `fewest` asks for more
    adjustments."""
    least_interval: int = 100
    """Fewest steps between adjustments in a short run: statistics need several views."""
    fewest: int = 0
    """Fewest adjustments of a short run, whatever `least_interval` says; 0: as many as come."""
    gradient: float = 2e-4
    """Mean norm of the loss's gradient by the 2D position, in units of half the image, from which a
    Gaussian asks for an anchor at the coarsest level; it doubles with each level."""
    levels: int = 3
    """Levels of the grid, each 4 times finer than the one before; 0: anchors never grow."""
    coarsest: int = 16
    """Edge of a cell of the coarsest level, in voxels; at least 4^(levels - 1)."""
    drawn_share: float = 0.4
    """Share of an interval's steps that a Gaussian must have been drawn in before it may ask."""
    visited_share: float = 0.8
    """Share of an interval's steps that an anchor must have been in view in before it is judged."""
    least_opacity: float = 0.005
    """Anchors whose Gaussians' summed opacity is below this on average are removed; 0: none are."""
    largest_size: float = 0.2
    """Largest base scale of an anchor after an adjustment, in extents (the release: 1.05 scene units,
    whatever the unit)."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        for name in (
            "start",
            "adjust_start",
            "stop",
            "fewest",
            "gradient",
            "levels",
            "least_opacity",
        ):
            value = getattr(self, name)
            require(value >= 0, f"density.{name}", value, ">= 0")
        for name in ("interval", "least_interval"):
            value = getattr(self, name)
            require(value >= 1, f"density.{name}", value, ">= 1")
        for name in ("drawn_share", "visited_share"):
            value = getattr(self, name)
            require(0 <= value <= 1, f"density.{name}", value, "0 to 1")
        require(self.largest_size > 0, "density.largest_size", self.largest_size, "> 0")
        least = FINER ** max(0, self.levels - 1)
        require(self.coarsest >= least, "density.coarsest", self.coarsest, f">= {least}")


class AnchorControl:
    """Grows anchors where their Gaussians are pulled at, prunes those that nobody sees."""

    needs: frozenset[Statistic] = frozenset({"signed"})

    def __init__(
        self, settings: AnchorDensity, *, iterations: int, voxel: float, extent: float, k: int
    ) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            iterations: Steps of the run.
            voxel: Edge of a voxel in scene units.
            extent: Size of the scene in scene units.
            k: Gaussians an anchor.
        """
        factor = shrink(iterations)
        begin, stop = round(settings.adjust_start * factor), round(settings.stop * factor)
        self.settings = replace(
            settings,
            start=round(settings.start * factor),
            adjust_start=begin,
            stop=stop,
            interval=shrunk_interval(
                settings.interval,
                settings.least_interval,
                settings.fewest,
                start=begin,
                stop=stop,
                iterations=iterations,
            ),
        )
        self.voxel, self.extent, self.k = voxel, extent, k
        self.gradient = self.drawn = self.opacity = self.visits = torch.zeros(0)

    def watches(self, step: int) -> bool:
        """Whether the statistics of a step are needed."""
        return self.settings.start < step < self.settings.stop

    def observe(self, seen: Observation) -> None:
        """Add one view: gradients by slot, opacities and visits by anchor.

        Args:
            seen: With the opacities and slots of the splats.
        """
        assert seen.opacities is not None
        assert seen.slots is not None
        if len(self.visits) != seen.count:
            self._clear(seen.count, seen.radii.device)
        drawn = seen.radii > 0
        # adding 0 for the others is far cheaper than picking those that were drawn
        norms = seen.gradient_norm("signed").where(drawn, 0)
        self.gradient.index_add_(0, seen.slots, norms)
        self.drawn.index_add_(0, seen.slots, drawn.to(norms))
        self.opacity += seen.by_row(seen.opacities)
        if seen.decoded is None:
            self.visits += 1
        else:
            self.visits[seen.decoded] += 1

    def adjusts(self, step: int) -> bool:
        """Whether a step ends with growing and pruning."""
        settings = self.settings
        return settings.adjust_start < step < settings.stop and step % settings.interval == 0

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Grow and prune, where their step has come.

        Args:
            step: From 1.
            parameters: Rows offsets, features and log_scales; labels levels and, unless they move and
                are rows, centres.
            generator: Decides which of the Gaussians that ask are heard.
        """
        if self.adjusts(step):
            yield self.adjust(parameters, generator)

    @torch.no_grad()
    def adjust(self, parameters: Parameters, generator: torch.Generator) -> Edit:
        """Grow, prune by the statistics so far, and forget those that were enough to judge by.

        Args:
            parameters: As for `edits`.
            generator: As for `edits`.

        Source: Lu et al. 2024, "Scaffold-GS", Sec. 3.3 and its release. Each level grows whether
            or not the one before did (the release goes on only once something has grown).
        """
        settings, count = self.settings, len(parameters)
        if len(self.visits) != count:  # no view was observed since
            self._clear(count, centres_of(parameters).device)
        anchors, levels = self.grown(parameters, generator)
        added = len(anchors.centres) - count
        enough = self.drawn > settings.drawn_share * settings.interval
        self.gradient, self.drawn = (
            torch.cat([values.where(~enough, 0), values.new_zeros(added * self.k)])
            for values in (self.gradient, self.drawn)
        )
        keep = self.kept(added)
        judged = self.visits > settings.visited_share * settings.interval
        self.opacity, self.visits = (
            torch.cat([values.where(~judged, 0), values.new_zeros(added)])[keep]
            for values in (self.opacity, self.visits)
        )
        self.gradient, self.drawn = (
            values.reshape(-1, self.k)[keep].flatten() for values in (self.gradient, self.drawn)
        )
        log_scales = anchors.log_scales[keep]
        log_scales[:, 3:].clamp_(max=math.log(settings.largest_size * self.extent))
        return Edit(
            parents=keep.where(keep < count, 0),  # a new anchor takes nothing from its parent
            fresh=keep >= count,
            values={
                "centres": anchors.centres[keep], "levels": levels[keep],
                "offsets": anchors.offsets[keep], "features": anchors.features[keep],
                "log_scales": log_scales,
            },
        )  # fmt: skip

    def grown(
        self, parameters: Parameters, generator: torch.Generator
    ) -> tuple[scaffold.Anchors, Int[Tensor, " m"]]:
        """The anchors with those that their Gaussians ask for, and the level that each was made at.

        Args:
            parameters: As for `edits`.
            generator: As for `edits`.
        """
        settings, levels = self.settings, parameters.labels["levels"]
        rows = {name: value.detach() for name, value in parameters.rows.items()}
        anchors = scaffold.Anchors(**{"centres": centres_of(parameters)} | rows)
        reach = anchors.log_scales[:, None, :3].exp()
        positions = (anchors.centres[:, None] + anchors.offsets * reach).flatten(0, 1)
        least = int(settings.drawn_share * settings.interval)
        for level in range(settings.levels):
            draw = torch.rand(len(positions), generator=generator).to(positions)
            wanted = scaffold.candidates(
                self.gradient, self.drawn.long(), level, settings.gradient, least, draw
            )
            cell = self.voxel * (settings.coarsest // FINER**level)
            anchors = scaffold.grow(anchors, positions, wanted, cell)
            made = len(anchors.centres) - len(levels)
            levels = torch.cat([levels, levels.new_full((made,), level)])
        return anchors, levels

    def kept(self, added: int) -> Int[Tensor, " m"]:
        """Rows that stay, the new ones among them; the most opaque one in any case.

        Args:
            added: Number of new anchors, behind the old ones.
        """
        settings = self.settings
        keep = scaffold.keep_visible(
            self.opacity, self.visits.long(), threshold=settings.least_opacity,
            least=int(settings.visited_share * settings.interval),
        )  # fmt: skip
        if not keep.any() and not added:
            keep[(self.opacity / self.visits).argmax()] = True
        return torch.where(torch.cat([keep, keep.new_ones(added)]))[0]

    def _clear(self, count: int, device: torch.device) -> None:
        """Forget the statistics."""
        self.gradient, self.drawn = (torch.zeros(count * self.k, device=device) for _ in range(2))
        self.opacity, self.visits = (torch.zeros(count, device=device) for _ in range(2))

    def state(self) -> dict[str, Tensor]:
        """The statistics as named tensors."""
        return {
            "gradient": self.gradient, "drawn": self.drawn, "opacity": self.opacity,
            "visits": self.visits,
        }  # fmt: skip

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned."""
        self.gradient, self.drawn, self.opacity, self.visits = (
            state[name].clone() for name in ("gradient", "drawn", "opacity", "visits")
        )
