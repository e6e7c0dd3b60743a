"""Training of method dpgs on one model."""

import hashlib
from dataclasses import replace
from pathlib import Path

import torch

from splatproof.base.files import sha256, tree_sha256
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.method import Method
from splatproof.methods.contracts.model import TRAINED, Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.settings import Dpgs
from splatproof.methods.dpgs.side_views import SideOrder, SideViews, refiner_of
from splatproof.methods.dpgs.spirals import side_cameras
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.priors.unet import domain
from splatproof.methods.priors.view_refiner import SHIPPED
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.schedules import shrink
from splatproof.methods.training.session import train
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View


def fit(scene: Scene, settings: Dpgs, run: Run) -> ExplicitModel:
    """Train on scene.train_views, in the second half on side views too, and return the model.

    Args:
        scene: With sparse points, which bound what side views circle, and training views.
        settings: What is chosen about the method.
        run: Where checkpoints and side views go; what is there already is continued. Its record
            says how many side views there are and which share of their pixels lacks evidence.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; SplatproofError if the loss stops being finite.

    Source: DPGS, Sec. 3; on one model, so without its partition.
    """

    def prepared() -> tuple[Model, Plan]:
        started = threedgs.started(scene, settings, run)
        model, plan = threedgs.prepare(started, settings, run)
        whole = exposed(model, settings.exposure, plan.views)
        return whole, with_side_views(started, whole, plan, settings, run)

    return explicit(train(run, prepared), scene, run.backend)


def with_side_views(scene: Scene, model: Model, plan: Plan, settings: Dpgs, run: Run) -> Plan:
    """The plan with side views among its views, as often as the settings say.

    Args:
        scene: The scene as training starts from it.
        model: What is trained, and draws its own side views.
        plan: Training on photos alone.
        settings: All of the method; `side` counts.
        run: Where rounds are kept, and who is told.
    """
    side = settings.side
    cameras = side_cameras(scene, side) if side.every else ()
    if side.every:
        run.on_fact("side views", f"{len(cameras)} on {side.spirals} spirals, {side.refiner}")
    if side.every and side.refiner == "own":
        run.on_fact("refiner", f"{domain(scene, SHIPPED)}; weights {sha256(SHIPPED)}")
    if side.every and side.refiner == "sd-turbo":
        refiner_of(side)  # what is missing is missed before training, not half-way
        run.on_fact("refiner", f"weights {tree_sha256(Path(side.weights))}")
    if not cameras:
        return plan

    def draw(view: View) -> RenderOutput:
        output = get_backend(run.backend).draw(
            view.camera, model.splats(view, TRAINED), mode=model.mode,
            background=torch.tensor(run.background).to(next(iter(model.parameters.rows.values()))),
        )  # fmt: skip
        return replace(output, colour=model.finish_image(view, output))

    def told(number: int, share: float) -> None:
        run.on_fact(f"side pixels trained on, round {number}", f"{share:.3f}")

    name = hashlib.sha256(plan.key.encode()).hexdigest()[:16]
    folder = None if run.folder is None else run.folder / "checkpoint" / "side" / name
    made = SideViews(cameras, plan.views, draw, side, folder, told)
    order = SideOrder(
        len(plan.views), len(cameras), steps=plan.steps, every=side.every,
        refresh=max(1, round(side.refresh * shrink(plan.steps))),
        views_per_step=plan.views_per_step,
    )  # fmt: skip
    return replace(plan, views=(*plan.views, *made.views(order.rounds)), order=order)


DPGS = Method(
    name="dpgs",
    settings=Dpgs,
    fit=fit,
    cost=cost,
    description="one model of 3dgs with points of matched photos at its start, trained in its second half on "
    "refined side views too (DPGS without its partition)",
)
