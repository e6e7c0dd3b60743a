"""The kinds of depth priors by name, and what a suite or a user writes to choose one."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from splatproof.base.errors import MissingError, UsageError
from splatproof.base.files import sha256, tree_sha256
from splatproof.base.names import unknown
from splatproof.methods.priors import (
    depth_anything,
    lidar,
    marigold,
    network,
    noisy,
    oracle,
    sweep,
    unet,
)
from splatproof.reference.types.result import NO_PRIOR
from splatproof.reference.types.scene import DepthPrior, Scene

WEIGHTS = "depth_prior_weights_sha256"
"""The fact of a record that names the weights a prior was made with."""
Prepare = Callable[[Scene, Path | None, int], Callable[[int], DepthPrior]]
"""prepare(scene, weights, seed): how to make the prior of the view of an index in scene.views."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One way to come by depth priors."""

    description: str
    prepare: Prepare
    truth: bool = False
    """Whether it may see the scene's truth; all others get what a method gets."""
    weights: bool = False
    """Whether it needs a path to weights."""
    draws: bool = False
    """Whether it depends on the seed."""
    shipped: Path | None = None
    """Weights that come with this package, where it needs no path."""
    domain: Callable[[Scene, Path], str] | None = None
    """domain(scene, weights): whether it was trained on such scenes, as the record says it."""
    silent: str = ""
    """Why it may say nothing of a view, for the line that names such views; "": no reason is given."""


KINDS = {
    "oracle": Kind(description="the true depth of a made world", prepare=oracle.prepare, truth=True),
    "oracle+noise": Kind(
        description="the true depth, warped, blurred and disturbed as networks do",
        prepare=noisy.prepare, truth=True, draws=True,
    ),
    "lidar": Kind(description="the view's LiDAR sweep, completed", prepare=lidar.prepare),
    "sweep": Kind(description="matching with neighbouring photos", prepare=sweep.prepare),
    "own": Kind(
        description="our own small network, from photo and sparse points, weights shipped",
        prepare=network.prepare, shipped=network.SHIPPED, domain=unet.domain,
    ),
    "network": Kind(
        description="our own small network with weights of another training",
        prepare=network.prepare, weights=True, domain=unet.domain,
    ),
    "depth-anything": Kind(
        description="a monocular network of transformers, from a local folder",
        prepare=depth_anything.prepare, weights=True,
    ),
    "marigold": Kind(
        description="a diffusion model of depth of diffusers, from a local folder, in the scale of SfM points",
        prepare=marigold.prepare, weights=True, draws=True, silent=marigold.SILENT,
    ),
}  # fmt: skip
"""All kinds."""


def resolved(prior: str, folder: Path, where: str) -> str:
    """A depth prior as a case holds it, its path absolute.

    Args:
        prior: "none", KIND or KIND:PATH.
        folder: What a relative path starts from.
        where: Option or key that it comes from, for the error.
    Raises: UsageError for an unknown kind, and for a path that is missing or of no use.
    """
    if prior == NO_PRIOR:
        return prior
    name, colon, path = prior.partition(":")
    if name not in KINDS:
        raise unknown(where, name, [NO_PRIOR, *KINDS])
    if KINDS[name].weights != bool(path):
        raise UsageError(
            f"{where}: {prior!r}, but {name!r} needs the path of its weights; write {name}:PATH"
            if KINDS[name].weights
            else f"{where}: {prior!r}, but {name!r} takes no weights; write {name}"
        )
    return f"{name}:{(folder / path).resolve()}" if colon else name


def parts(prior: str) -> tuple[str, Path | None]:
    """Kind and weights of a prior that `resolved` made; it is not "none"."""
    name, colon, path = prior.partition(":")
    return name, Path(path) if colon else KINDS[name].shipped


def weights_facts(prior: str) -> dict[str, str]:
    """The hash of the prior's weights as a fact of the record; nothing where it has none.

    Args:
        prior: "none", or what `resolved` made.
    Raises: MissingError where the path does not exist.
    """
    path = None if prior == NO_PRIOR else parts(prior)[1]
    if path is None:
        return {}
    if path.is_dir():
        return {WEIGHTS: tree_sha256(path)}
    if not path.is_file():
        name = parts(prior)[0]
        remedy = "give the path of a file that is here"
        if not KINDS[name].weights:
            remedy = "they come with this package: install splatproof again"
        raise MissingError(
            f"{path}: no such weights, which depth prior {name!r} is made with; {remedy}, or take "
            "'sweep', which needs none"
        )
    return {WEIGHTS: sha256(path)}
