"""Side views among the views that a model is trained on."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.model import TRAINED, Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.refiners import Refiner
from splatproof.methods.dpgs.settings import SideSettings
from splatproof.methods.dpgs.side_views import SideOrder, SideViews, as_it_is
from splatproof.methods.models.exposure import ExposedModel
from splatproof.methods.priors.unet import domain
from splatproof.methods.priors.view_refiner import SHIPPED
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.run_keys import with_special
from splatproof.methods.training.schedules import shrink
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View


def with_side_views(
    cameras: Sequence[Camera],
    scene: Scene,
    model: Model,
    plan: Plan,
    side: SideSettings,
    refiner: Refiner,
    run: Run,
) -> Plan:
    """The plan with side views among its views, as often as the settings say.

    Args:
        cameras: Where side views are taken from; without one the plan stays as it is.
        scene: What is trained on; whether it is of a kind that our own refiner was trained on is told.
        model: What is trained, and draws its own side views.
        plan: Training on photos alone, in random epochs.
        side: How often side views come, and who refines them.
        refiner: That one, ready; the hash of its weights becomes part of the plan's key.
        run: Where rounds are kept, and who is told.
    """
    if side.every:
        run.on_fact("side views", f"{len(cameras)} on {side.spirals} spirals, {side.refiner}")
    if side.every and side.refiner == "own":
        run.on_fact("refiner", f"{domain(scene, SHIPPED)}; weights {refiner.weights}")
    if side.every and side.refiner == "sd-turbo":
        run.on_fact("refiner", f"weights {refiner.weights}")
    if not cameras:
        return plan

    def draw(view: View) -> RenderOutput:
        output = get_backend(run.backend).draw(
            view.camera, model.splats(view, TRAINED), mode=model.mode,
            background=torch.tensor(run.background).to(next(iter(model.parameters.rows.values()))),
        )  # fmt: skip
        return replace(output, colour=model.finish_image(view, output))

    def neutral(view: View, photo: Float[Tensor, "h w 3"]) -> Float[Tensor, "h w 3"]:
        if isinstance(model, ExposedModel):
            return model.exposures.undone(view, photo)
        return as_it_is(view, photo)

    def told(number: int, share: float) -> None:
        run.on_fact(f"side pixels trained on, round {number}", f"{share:.3f}")

    if refiner.weights:
        plan = replace(plan, key=with_special(plan.key, refiner.weights))
    name = hashlib.sha256(plan.key.encode()).hexdigest()[:16]
    folder = None if run.folder is None else run.folder / "checkpoint" / "side" / name
    made = SideViews(
        cameras, plan.views, draw, refiner.refine, folder, told, neutral, holes=side.holes
    )
    order = SideOrder(
        len(plan.views), len(cameras), steps=plan.steps, every=side.every,
        refresh=max(1, round(side.refresh * shrink(plan.steps))),
        views_per_step=plan.views_per_step,
    )  # fmt: skip
    return replace(plan, views=(*plan.views, *made.views(order.rounds)), order=order)
