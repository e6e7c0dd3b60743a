"""The scene as a case's training gets it: what the case's axes put between the data and the method."""

from collections.abc import Callable, Mapping

from splatproof.datasets.pose_noise import disturbed
from splatproof.methods.contracts.run import keep_to_oneself
from splatproof.methods.priors.attach import with_priors
from splatproof.methods.training.initialise import require_sight
from splatproof.reference.types.scene import Scene
from splatproof.suites.scene_data import FILES
from splatproof.suites.suite_files import Case


def training_scene(
    scene: Scene,
    case: Case,
    data: Mapping[str, str],
    report: Callable[[int, int], None] = lambda done, total: None,
    say: Callable[[str], None] = keep_to_oneself,
) -> Scene:
    """The scene under the case's pose noise, with its depth prior on the training views.

    Truth is still in it: `Scene.for_training` takes that away, and leaves the prior.

    Args:
        scene: The scene as it was opened.
        case: Says noise, prior and seed.
        data: Facts of the scene's files, by which priors are known again.
        report: Told (views that have their prior, views in all).
        say: Told one line about what is odd.
    Raises: DataError where no training photo shows any of its points; UsageError where the scene lacks
        what the prior is made of; MissingError without its weights.
    """
    require_sight(scene)
    noisy = disturbed(scene, case.pose_noise, case.seed)
    return with_priors(noisy, case.depth_prior, case.seed, data.get(FILES, ""), report, say)
