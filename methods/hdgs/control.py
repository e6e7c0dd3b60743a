"""Density control: growing by gradient and density, growing in time, pruning of the faint and unvisited."""

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from splatproof.methods.contracts.density_strategy import Observation, Statistic
from splatproof.methods.contracts.parameters import Edit, Parameters
from splatproof.methods.hdgs.decode import placed
from splatproof.methods.hdgs.density import HdgsDensity
from splatproof.methods.hdgs.model import stored_anchors
from splatproof.methods.hdgs.networks import hierarchy
from splatproof.methods.hdgs.start import drawn_offsets
from splatproof.reference.anchors import control
from splatproof.reference.anchors.control import GrowthSettings
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings
from splatproof.reference.anchors.vibration import vibrate
from splatproof.reference.types.cells import unique_rows


class HdgsControl:
    """Grows anchors where their Gaussians are pulled at, prunes those that nobody sees."""

    needs: frozenset[Statistic] = frozenset({"signed"})

    def __init__(
        self,
        settings: HdgsDensity,
        parameters: Parameters,
        sizes: HierarchySettings,
        *,
        iterations: int,
        views: int,
        voxel: float,
        moments: tuple[float, float],
    ) -> None:
        """Start without statistics.

        Args:
            settings: Thresholds and steps of a 30,000 step run, shrunk to this one's.
            parameters: The model's; gradients by the peaks are read of them.
            sizes: Sizes of the hierarchy.
            iterations: Steps of the run.
            views: Training views.
            voxel: Edge of the finest voxels, at most one anchor in each, in the anchors' unit; those
                of growing are twice as wide.
            moments: First and last time of the training views, in the unit of the peaks.
        """
        self.settings = settings.shrunk(iterations)
        self.parameters, self.sizes = parameters, sizes
        self.views, self.voxel, self.moments = views, voxel, moments
        self.growth = GrowthSettings(
            gradient=settings.gradient, opacity=settings.opacity,
            density=settings.density if settings.growing == "adaptive" else torch.inf,
            temporal_gradient=settings.temporal_gradient,
            temporal_share=settings.temporal_share, unvisited=settings.unvisited,
        )  # fmt: skip
        self._clear(0, torch.device("cpu"))

    def watches(self, step: int) -> bool:
        """Whether the statistics of a step are needed."""
        return self.settings.start < step < self.settings.stop

    def observe(self, seen: Observation) -> None:
        """Add one view: gradients by slot; opacities, visits and gradients by peak time by anchor.

        Args:
            seen: With the opacities, slots and decoded rows of the splats.
        """
        assert seen.opacities is not None
        assert seen.slots is not None
        assert seen.decoded is not None
        if len(self.visits) != seen.count:
            self._clear(seen.count, seen.radii.device)
        drawn = seen.radii > 0
        slots = seen.slots[drawn]
        self.gradient.index_add_(0, slots, seen.gradient_norm("signed")[drawn])
        self.drawn.index_add_(0, slots, torch.ones_like(seen.radii[drawn]))
        self.opacity += seen.by_row(seen.opacities)
        visible = torch.zeros_like(self.visits, dtype=torch.bool)
        visible[seen.decoded] = True
        self.visits += visible
        self.unvisited = control.update_unvisited(self.unvisited, visible)
        by_time = self.parameters.rows["peaks"].grad
        if by_time is not None:
            self.temporal += by_time.abs()

    def adjusts(self, step: int) -> bool:
        """Whether a step ends with growing and pruning."""
        settings = self.settings
        since = step - settings.start
        return self.watches(step) and since % settings.interval == 0

    def edits(
        self, step: int, parameters: Parameters, generator: torch.Generator
    ) -> Iterator[Edit]:
        """Grow and prune, where their step has come.

        Args:
            step: From 1.
            parameters: The model's.
            generator: Draws offsets of new anchors, and which voxels grow in time.
        """
        if self.adjusts(step) and len(self.visits) == len(parameters):
            yield self.adjust(parameters, generator)

    @torch.no_grad()
    def adjust(self, parameters: Parameters, generator: torch.Generator) -> Edit:
        """Grow, prune by the statistics so far, and start them anew; the record of visits goes on.

        A new anchor takes all but centre, scale and offsets from the anchor whose Gaussian asked.

        Args:
            parameters: As for `edits`.
            generator: As for `edits`.

        Source: HDGS, Sec. 3.5.
        """
        (keep,) = torch.where(self.kept())
        anchors = stored_anchors(parameters, self.sizes.layers)
        networks = hierarchy(parameters.shared, self.sizes.layers)
        last = placed(anchors, networks, self.sizes, anchors.peaks)
        positions = (last.at[:, None] + last.away).flatten(0, 1)
        centres, sizes, parents = self.grown(anchors.centres, positions)
        late, peaks, sources = self.grown_in_time(
            parameters, torch.cat([anchors.centres, centres]), generator
        )
        made = len(centres) + len(late)
        origin = torch.cat([keep, parents, sources])
        values = {"centres": torch.cat([anchors.centres[keep], centres, late])}
        log_scales = parameters.rows["log_scales"].detach()[origin]
        log_scales[len(keep) : len(keep) + len(centres)] = sizes.log()[:, None]
        values["log_scales"] = log_scales
        times = parameters.rows["peaks"].detach()[origin]
        times[len(origin) - len(late) :] = peaks
        values["peaks"] = times
        for name, offsets in drawn_offsets(self.sizes, made, generator).items():
            old = parameters.rows[name].detach()
            values[name] = torch.cat([old[keep], offsets.to(old)])
        record = torch.cat([self.unvisited[keep], self.unvisited.new_zeros(made)])
        self._clear(len(origin), record.device)
        self.unvisited = record
        fresh = torch.arange(len(origin), device=origin.device) >= len(keep)
        return Edit(parents=origin, fresh=fresh, values=values)

    def kept(self) -> Bool[Tensor, " n"]:
        """Anchors that stay; the most opaque one in any case."""
        mean = self.opacity / (self.visits * self.sizes.gaussians)  # nan where never seen
        record = self.unvisited if self.settings.unvisited else torch.zeros_like(self.unvisited)
        keep = control.keep(mean, record, self.views, self.growth)
        keep[mean.nan_to_num(0).argmax()] = True
        return keep

    def grown(
        self, centres: Float[Tensor, "n 3"], positions: Float[Tensor, "s 3"]
    ) -> tuple[Float[Tensor, "m 3"], Float[Tensor, " m"], Int[Tensor, " m"]]:
        """Centres of new anchors, the edge of the cell that each is for, and whose Gaussian asked.

        Args:
            centres: Centres of the anchors so far.
            positions: Means of their Gaussians, each anchor at its peak, in the order of the slots.
        """
        settings, wide = self.settings, self.growth.fine * self.voxel
        counted = self.drawn >= max(1.0, settings.drawn_share * settings.interval)
        (slots,) = torch.where(counted)
        means = (self.gradient / self.drawn.clamp(min=1))[slots]
        places = positions[slots]
        statistics = control.voxel_statistics(places, means, wide)
        new = control.new_anchors(centres, places, statistics, wide, self.growth)
        if len(new) == 0:
            return new, new[:, 0], slots[:0]
        # Whole voxels have their anchor in the middle, parts of them a quarter off it.
        middle = ((new / wide) % 1 - 0.5).abs().amax(dim=1) < 0.125
        edges = torch.where(middle, wide, self.voxel).to(new)
        _, nearest = KDTree(places.cpu().numpy()).query(new.cpu().numpy())
        asked = slots[torch.from_numpy(nearest).to(slots)]
        return new, edges, asked // self.sizes.gaussians

    def grown_in_time(
        self, parameters: Parameters, taken: Float[Tensor, "n 3"], generator: torch.Generator
    ) -> tuple[Float[Tensor, "m 3"], Float[Tensor, " m"], Int[Tensor, " m"]]:
        """Centres and peaks of anchors that take over from others a life span earlier or later.

        One for each voxel drawn of those whose anchors' peaks are pulled at: the one pulled at most
        is copied to where it is a life span before or after its peak, unless an anchor stands there.

        Args:
            parameters: The model's.
            taken: Centres of all anchors, new ones included.
            generator: Draws voxels and directions.

        Source: HDGS, Sec. 3.5; what grows: ours.
        """
        rows = parameters.rows
        old = parameters.labels["centres"]
        none = old[:0], old[:0, 0], self.unvisited[:0]
        if not self.growth.temporal_gradient or not bool(self.temporal.any()):
            return none
        pulled = self.temporal / self.visits.clamp(min=1)
        statistics = control.voxel_statistics(old, pulled, self.growth.fine * self.voxel)
        chosen = control.temporal_growth(statistics.gradient.cpu(), self.growth, generator)
        order = pulled.argsort(stable=True)
        strongest = self.unvisited.new_full((len(chosen),), -1)
        for_cell = statistics.owner[order].cpu()
        strongest = strongest.cpu().scatter_reduce_(
            0, for_cell, torch.arange(len(order)), "amax"
        )  # place in the order: the largest pull of a cell
        parents = order[strongest[chosen].to(order)]
        sign = torch.randint(0, 2, (len(parents),), generator=generator) * 2 - 1
        times = rows["peaks"][parents] + sign.to(old) * rows["log_spans"][parents].exp()
        inside = (times >= self.moments[0]) & (times <= self.moments[1])
        parents, times = parents[inside], times[inside]
        velocities, peaks = rows["velocities"][parents], rows["peaks"][parents]
        # vibrate() takes one time for all: the peaks are counted from each one's own.
        places = vibrate(old[parents], velocities, peaks - times, 0.0, self.sizes.period)
        free = alone(places, taken, self.voxel)
        return places[free], times[free], parents[free]

    def _clear(self, count: int, device: torch.device) -> None:
        """Forget the statistics."""
        slots = count * self.sizes.gaussians
        self.gradient, self.drawn = (torch.zeros(slots, device=device) for _ in range(2))
        self.opacity, self.visits, self.temporal = (
            torch.zeros(count, device=device) for _ in range(3)
        )
        self.unvisited = torch.zeros(count, dtype=torch.int64, device=device)

    def state(self) -> dict[str, Tensor]:
        """The statistics as named tensors."""
        return {name: getattr(self, name) for name in STATISTICS}

    def restore(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` returned."""
        for name in STATISTICS:
            setattr(self, name, state[name].clone())


STATISTICS = ("gradient", "drawn", "opacity", "visits", "temporal", "unvisited")


def alone(
    places: Float[Tensor, "m 3"], taken: Float[Tensor, "n 3"], voxel: float
) -> Bool[Tensor, " m"]:
    """Which places are the first in a voxel in which no anchor stands.

    Args:
        places: Where anchors are wanted.
        taken: Where anchors stand.
        voxel: Edge of the voxels.
    """
    cells = (torch.cat([taken, places]) / voxel).floor().long()
    kinds, which = unique_rows(cells)
    number = torch.arange(len(cells), device=cells.device)
    first = torch.full((len(kinds),), len(cells), device=cells.device)
    first = first.scatter_reduce(0, which, number, "amin")
    return (first[which] == number)[len(taken) :]
