"""What is looked at: models, the scene they show, and what pictures of them share."""

from dataclasses import dataclass, field, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.datasets.image_cache import ImageCache, TensorCache
from splatproof.methods.contracts.reconstruction import Adapts, Bakes, Reconstruction
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import Scene, View, camera_view
from splatproof.viewing.poses import Place, place_of_points, place_of_scene, resized

DEPTH_WIDTH = 192
"""Width in pixels of the depth maps that say what training photos see."""
DEPTH_BYTES, PHOTO_BYTES = 256 * 2**20, 512 * 2**20
"""Bytes of such depth maps, and of photos, that are kept in memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """One model, and what pictures of it keep from one frame to the next."""

    name: str
    """What it is called on the page."""
    model: Reconstruction
    step: int | None = None
    """Step of the training that it is a snapshot of; None: it is finished."""
    steps: int | None = None
    """Steps of that training."""
    depths: TensorCache = field(default_factory=lambda: TensorCache(DEPTH_BYTES))
    """What the model says training photos see, and bounds of it."""

    @property
    def moves(self) -> bool:
        """Whether it may look different at another time."""
        return not isinstance(self.model, ExplicitModel)

    @property
    def adapts(self) -> bool:
        """Whether it can show the light of each training photo."""
        return isinstance(self.model, Adapts)


class Stage:
    """Models side by side, and the scene around them. Models may be replaced while it is shown."""

    def __init__(
        self,
        models: tuple[Shown, ...],
        scene: Scene | None,
        background: Float[Tensor, "3"] | None = None,
    ) -> None:
        """Find out where there is something to look at.

        Args:
            models: At least one.
            scene: Whose photos are shown; None: there are none.
            background: Colour behind everything; None is black.
        Raises: UsageError for a model that can only be seen with a scene, which is missing.
        """
        self.models, self.scene, self.background = models, scene, background
        self.place: Place = self._place()
        self.photos = ImageCache(PHOTO_BYTES)

    def _place(self) -> Place:
        if self.scene is not None:
            return place_of_scene(self.scene)
        first = self.models[0]
        if not isinstance(first.model, Bakes) or first.moves:
            raise UsageError(
                f"{first.name}: a model of kind {first.model.kind!r} is decoded for the cameras of a "
                "scene; name it with --scene"
            )
        return place_of_points(first.model.bake().means)

    @property
    def training(self) -> tuple[View, ...]:
        """Views whose photos the models were trained on."""
        return () if self.scene is None else self.scene.train_views

    @property
    def times(self) -> tuple[float, float] | None:
        """First and last moment of the scene in seconds; None: it stands still, or no model moves."""
        views = () if self.scene is None else self.scene.views
        known = sorted({view.time for view in views if view.time is not None})
        if len(known) < 2 or not any(one.moves for one in self.models):
            return None
        return known[0], known[-1]

    def seen_views(self, shown: Shown) -> tuple[View, ...]:
        """Training views, small, with the depth that a model itself gives them.

        Args:
            shown: The model that is asked.
        """
        return tuple(self._small(shown, view) for view in self.training)

    def _small(self, shown: Shown, view: View) -> View:
        camera = resized(view.camera, min(DEPTH_WIDTH, view.camera.width))
        asked = replace(view.without_truth(), camera=camera)
        load = partial(shown.depths.get, (view.name, "depth"), partial(model_depth, shown, asked))
        return replace(asked, load_depth=load)


def model_depth(shown: Shown, view: View) -> Float[Tensor, "h w"]:
    """z-depth that a model gives a view in scene units; inf where less than half is covered.

    Args:
        shown: The model.
        view: What is looked at.
    """
    return solid_depth(shown.model.render(view))


def solid_depth(output: RenderOutput) -> Float[Tensor, "h w"]:
    """z-depth of a picture in scene units; inf where less than half of a pixel is covered.

    Args:
        output: What a model shows.
    """
    return torch.where(output.alpha >= 0.5, output.depth, torch.inf)


def asked_view(
    stage: Stage,
    shown: Shown,
    camera: Camera,
    *,
    like: View | None = None,
    time: float | None = None,
    appearance: str | None = None,
) -> View:
    """The view that a model is asked for.

    Args:
        stage: What is shown.
        shown: The model.
        camera: Where it is looked at from.
        like: View of the scene whose name, time and sensor count; None: the camera is nobody's, and
            time and sensor are those of the scene's first view.
        time: Seconds since the scene's first view; None: that of `like`.
        appearance: Name of the training view whose light is shown, where the model knows of light;
            None: that of `like` where the model was trained on it, else the neutral one.
    """
    views = () if stage.scene is None else stage.scene.views
    base = like or (views[0] if views else camera_view(camera))
    return replace(
        base.without_truth(), name="free camera" if like is None else like.name, camera=camera,
        time=base.time if time is None else time,
        appearance=appearance if shown.adapts else None,
    )  # fmt: skip
