"""Training of method dpgs on one model."""

from splatproof.methods.contracts.method import Method
from splatproof.methods.contracts.model import Model
from splatproof.methods.contracts.run import Run
from splatproof.methods.dpgs.refiners import refiner_of
from splatproof.methods.dpgs.settings import Dpgs
from splatproof.methods.dpgs.side_training import with_side_views
from splatproof.methods.dpgs.spirals import side_cameras
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import explicit, exposed
from splatproof.methods.threedgs import fit as threedgs
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.training.plan import Plan
from splatproof.methods.training.session import train
from splatproof.reference.types.scene import Scene


def fit(scene: Scene, settings: Dpgs, run: Run) -> ExplicitModel:
    """Train on scene.train_views, in the second half on side views too, and return the model.

    Args:
        scene: With sparse points, which bound what side views circle, and training views.
        settings: What is chosen about the method.
        run: Where checkpoints and side views go; what is there already is continued. Its record
            says how many side views there are and which share of their pixels lacks evidence.

    Raises: DataError for a scene that cannot be trained on; UsageError if the checkpoint belongs to
        another run; MissingError or DataError, before anything else, where a refiner lacks its library or weights;
        SplatproofError if the loss stops being finite.

    Source: DPGS, Sec. 3; on one model, so without its partition.
    """
    side, refiner = settings.side, refiner_of(settings.side)  # before minutes of matching photos

    def prepared() -> tuple[Model, Plan]:
        started = threedgs.started(scene, settings, run)
        model, plan = threedgs.prepare(started, settings, run)
        whole = exposed(model, settings.exposure, plan.views)
        cameras = side_cameras(started, side) if side.every else ()
        return whole, with_side_views(cameras, started, whole, plan, side, refiner, run)

    return explicit(train(run, prepared), scene, run.backend)


DPGS = Method(
    name="dpgs",
    settings=Dpgs,
    fit=fit,
    cost=cost,
    description="one model of 3dgs with points of matched photos at its start, trained in its second half on "
    "refined side views too (DPGS without its partition)",
)
