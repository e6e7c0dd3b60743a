"""Two fields of Gaussians in one model, each trained on its own: what CoR-GS compares."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain

import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.contracts.model import Moment
from splatproof.methods.models.gaussian_model import GaussianModel, assemble
from splatproof.methods.training.terms import Frame, Term, photometric_loss
from splatproof.methods.training.view_order import Shuffled
from splatproof.reference.sparse_views.pseudo_views import between
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

FIELD = "field"
"""Label of rows: 0 or 1, the field that a Gaussian belongs to."""
SECOND = "second field of "
"""What the names of views begin with that the second field is trained on."""
Draw = Callable[[Camera, Splats], RenderOutput]


def twice(start: Gaussians) -> tuple[Gaussians, Int[Tensor, " m"]]:
    """The rows of two equal fields, and which field each belongs to.

    Args:
        start: One field.
    """
    both = {name: torch.cat([value, value]) for name, value in vars(start).items()}
    return Gaussians(**both), torch.arange(2).repeat_interleave(len(start))


def in_both(views: tuple[View, ...]) -> tuple[View, ...]:
    """The views for the first field, then the same ones for the second.

    Args:
        views: Training views.
    """
    return (*views, *(replace(view, name=SECOND + view.name) for view in views))


class Paired:
    """Random epochs of views, each shown to the first field and then to the second."""

    def __init__(self, count: int) -> None:
        """Start before the first epoch.

        Args:
            count: Number of views of one field.
        """
        self.count, self.first = count, Shuffled(count)
        self.pending: int | None = None

    def next(self, generator: torch.Generator) -> int:
        """Index of the next view among those of `in_both`.

        Args:
            generator: Source of every draw.
        """
        if self.pending is None:
            self.pending = self.first.next(generator)
            return self.pending
        index, self.pending = self.pending + self.count, None
        return index

    def coming(self) -> Iterator[int]:
        """The first field's views of this epoch, after what the second one is still owed."""
        owed = () if self.pending is None else (self.pending + self.count,)
        return chain(owed, self.first.coming())

    def state(self) -> list[int]:
        """What is left of this epoch; a step ends with both fields trained."""
        assert self.pending is None
        return self.first.state()

    def restore(self, state: list[int], drawn: int) -> None:
        """Take over what was left of an epoch.

        Args:
            state: What `state` returned then.
            drawn: Not looked at.
        """
        self.first.restore(state, drawn)


class TwinFields(GaussianModel):
    """Gaussians of two fields: a view shows the one that its name asks for, the first by default."""

    def rows_of(self, field: int) -> Int[Tensor, " n"]:
        """Rows of a field, ascending.

        Args:
            field: 0 or 1.
        """
        return torch.where(self.parameters.labels[FIELD] == field)[0]

    def splats(self, view: View, moment: Moment) -> Splats:
        """The Gaussians of one field, activated.

        Args:
            view: Its name begins with SECOND where the second field is asked for.
            moment: As for a GaussianModel.
        """
        whole = super().splats(view, moment)
        rows = self.rows_of(field_of(view))
        picked = {name: value[rows] for name, value in vars(whole).items() if value is not None}
        return replace(whole, **picked, rows=rows)

    def gaussians(self) -> Gaussians:
        """The first field as it is now, which is the result, on the CPU, without gradients."""
        rows = self.rows_of(0)
        values = {name: v.detach()[rows].cpu() for name, v in self.parameters.rows.items()}
        return assemble(values, self.degree)


def field_of(view: View) -> int:
    """The field that a view shows."""
    return int(view.name.startswith(SECOND))


def of_other_field(view: View) -> View:
    """The same view, of the other field."""
    name = view.name.removeprefix(SECOND) if field_of(view) else SECOND + view.name
    return replace(view, name=name)


def agreement_term(
    cameras: tuple[Camera, ...], draw: Draw, *, weight: float, steps: range, dssim: float
) -> Term:
    """Photometric loss of a field against the other's render at a camera between training cameras.

    Two cameras and the share between them are drawn anew for each frame, the cameras with replacement: of n
    training cameras one pseudo view in n is one of them itself. The other field's render is a constant. (The
    release computes a ramp over its first 500 steps and does not use it.)

    Args:
        cameras: Training cameras.
        draw: Renders splats over the run's background.
        weight: Factor on the term.
        steps: Steps that have the term.
        dssim: Weight of 1 - SSIM, as in the loss of photos.

    Source: Zhang et al. 2024, "CoR-GS", Sec. 4.3, Eq. 6.
    """

    def loss(frame: Frame) -> Float[Tensor, ""]:
        moment = frame.moment
        if moment.step not in steps:
            return frame.image.new_zeros(())
        chosen = torch.randint(len(cameras), (2,), generator=moment.generator).tolist()
        share = float(torch.rand((), generator=moment.generator))
        first, second = (cameras[index] for index in chosen)
        camera = between(first, second, share)
        own = replace(frame.view.without_truth(), camera=camera)
        with torch.no_grad():
            wanted = draw(camera, frame.model.splats(of_other_field(own), moment)).colour
        mine = draw(camera, frame.model.splats(own, moment)).colour
        return photometric_loss(mine, wanted, dssim=dssim)

    return Term(name="co-regularisation", loss=loss, weight=weight)
