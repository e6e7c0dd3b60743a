"""What a model may know of a test image's light: a protocol's `appearance`, carried out."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.reconstruction import Adapts, Reconstruction
from splatproof.metrics.colour_fit import fit_colours
from splatproof.reference.types.nearest_view import nearest_view
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.scene import Scene, View


def shown(view: View, training: Sequence[View], model: Reconstruction, protocol: Protocol) -> View:
    """The view that a model is asked to render for a scored one: without its image, with its light.

    none, exposure: no appearance. nearest: that of the nearest training view. half, oracle: a code
    that the model fits to the image's left half or to all of it, where the model can (`Adapts`);
    masked pixels are not looked at, unless `masked` is off.

    Args:
        view: The view that is scored.
        training: Views that the model was trained on.
        model: The model that is scored.
        protocol: The rules; `appearance` says what may be used, `masked` whether masks count.
    """
    asked = view.without_truth()
    if protocol.appearance == "nearest":
        return replace(asked, appearance=nearest_view(view, training).name)
    if protocol.appearance in ("half", "oracle") and isinstance(model, Adapts):
        columns = usable_columns(view.camera.width, protocol)
        mask = view.load_mask()[:, columns] if protocol.masked and view.load_mask else None
        code = model.fit_appearance(asked, view.load()[:, columns], columns, mask)
        return replace(asked, appearance=code)
    return asked


def exposed(
    view: View, render: Float[Tensor, "h w 3"], protocol: Protocol
) -> Float[Tensor, "h w 3"]:
    """A render under protocols that fit exposure: an affine map of its colours, fitted on the left half.

    Args:
        view: The scored view; its left half is looked at.
        render: What the model shows of it.
        protocol: The rules; all but appearance = "exposure" leave the render alone.
    """
    if protocol.appearance != "exposure":
        return render
    left = torch.zeros(view.size, dtype=torch.bool)
    left[:, usable_columns(view.camera.width, protocol)] = True
    if protocol.masked and view.load_mask is not None:
        left &= view.load_mask()
    return fit_colours(render.clamp(0, 1), view.load(), left, "cc_affine")


def usable_columns(width: int, protocol: Protocol) -> slice:
    """Columns of a test image that its appearance may be fitted on: the left half, or all as an oracle.

    On odd widths the middle column belongs to neither half.

    Args:
        width: Width of the image, in pixels.
        protocol: The rules, of which `appearance` counts.
    """
    return slice(0, width if protocol.appearance == "oracle" else width // 2)


def told(model: Reconstruction, protocol: Protocol, scene: Scene) -> str:
    """What a record says of the appearance of its test views, and what a scene lacks for the rule.

    Args:
        model: What was scored.
        protocol: The rules.
        scene: What it was scored on; sensors count.
    """
    rule = protocol.appearance
    if rule == "nearest" and (lacking := _without_sensor(scene)):
        return f"{rule}: {lacking}"
    if rule in ("half", "oracle") and not isinstance(model, Adapts):
        return f"{rule}: this kind of model has none to fit"
    return rule


def _without_sensor(scene: Scene) -> str:
    """Why sensors cannot say which training view has a test view's light; empty where they can."""
    trained = {view.sensor for view in scene.train_views}
    if trained == {""}:
        return (
            "no view names its sensor (views.json does), so views of all cameras count as of one; "
            "a protocol with appearance = none does without"
        )
    others = sorted({view.sensor for view in scene.test_views} - trained)
    if not others:
        return ""
    return (
        f"no training view is of sensor {', '.join(map(repr, others))}: those of all sensors count"
    )
