"""Cameras of a file, as a model is seen from them: in its frame, and near enough to show small things."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from splatproof.base.errors import UsageError
from splatproof.cli import output

if TYPE_CHECKING:
    from splatproof.methods.contracts.reconstruction import Reconstruction
    from splatproof.reference.types.scene import View


def for_model(
    views: "Mapping[str, View]", model: "Reconstruction", source: Path
) -> "dict[str, View]":
    """The views with cameras that fit the model.

    Where the model's frame is shifted (UTM, say) and the cameras stand nearer to that shift than to 0, they are of the
    scene's original frame, and are moved into the model's; a line says so. Near planes are those of `NEAR`, or of small
    scenes a share of how far the model's Gaussians are spread.

    Args:
        views: Views that nobody took, by name, at least one.
        model: What is looked at.
        source: The file that they are from, for the line.
    """
    import torch

    from splatproof.datasets.added_views import moved_view

    shift = getattr(model, "shift", None)
    if shift is not None and bool(shift.any()):
        centres = torch.stack([view.camera.centre for view in views.values()])
        if (centres - shift).norm(dim=1).median() < centres.norm(dim=1).median():
            output.log(
                f"{source}: cameras of the scene's original frame, moved by {(-shift).tolist()} into the model's"
            )
            views = {name: moved_view(view, shift) for name, view in views.items()}
    near = _near(model, next(iter(views.values())))
    return {
        name: replace(view, camera=replace(view.camera, near=near)) for name, view in views.items()
    }


def _near(model: "Reconstruction", view: "View") -> float:
    """Near plane in scene units; the usual one where a model has no Gaussians of its own."""
    from splatproof.methods.contracts.reconstruction import Bakes
    from splatproof.reference.types.camera import NEAR
    from splatproof.viewing.poses import NEAREST, place_of_points

    if isinstance(model, Bakes):
        with suppress(UsageError):  # one that moves, and no time is said
            means = model.bake(view).means
            if len(means):
                return min(NEAR, NEAREST * place_of_points(means).radius)
    return NEAR
