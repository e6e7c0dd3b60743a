"""Prior `oracle`: the true depth, where a scene has it. A bound on what a prior can do, never a method's."""

from collections.abc import Callable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.reference.types.scene import DepthPrior, Scene


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene.

    Args:
        scene: A scene whose training views know their true depth.
        weights: None; it has none.
        seed: Not used; it draws nothing.
    Raises: UsageError where a training view has no true depth.
    """
    require_truth(scene, "oracle")
    return lambda index: prior_of(true_depth(scene, index))


def require_truth(scene: Scene, kind: str) -> None:
    """Refuse a scene without true depth.

    Args:
        scene: Any scene, with its truth.
        kind: Name of the prior that asks for it.
    Raises: UsageError naming a view that has none and what does without.
    """
    blind = [view.name for view in scene.train_views if view.load_depth is None]
    if blind:
        raise UsageError(
            f"{scene.name}: {len(blind)} of {len(scene.train)} training views have no true depth "
            f"(e.g. {blind[0]}), which depth prior '{kind}' shows; made worlds have it, 'sweep' does "
            "without"
        )


def true_depth(scene: Scene, index: int) -> Float[Tensor, "h w"]:
    """True z-depth of a view that `require_truth` has let pass.

    Args:
        scene: The scene, with its truth.
        index: Index of the view in scene.views.
    """
    load = scene.views[index].load_depth
    assert load is not None
    return load()


def prior_of(depth: Float[Tensor, "h w"]) -> DepthPrior:
    """Disparity 1 / z; 0 where nothing was hit (z is inf), and unknown where z is no depth.

    Args:
        depth: z-depth in scene units.
    """
    valid = depth > 0  # false for nan too
    disparity = torch.where(valid, 1 / torch.where(valid, depth, 1), 0)
    return DepthPrior(disparity=disparity.float(), valid=valid)
