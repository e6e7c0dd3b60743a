"""Who matches photos before a training, with which weights."""

from pathlib import Path

from splatproof.base.files import sha256, tree_sha256
from splatproof.methods.priors.own_matcher import SHIPPED
from splatproof.methods.priors.unet import domain
from splatproof.reference.supervision.dense_initialisation import DenseSettings
from splatproof.reference.types.scene import Scene

MATCHER = "matcher_weights_sha256"
"""The fact of a record that names the weights of a matcher."""


def weights_sha256(dense: DenseSettings) -> str:
    """Hash of the matcher's weights, in hexadecimal; empty where it has none.

    Args:
        dense: Who matches.

    Raises: DataError where the file of ours is missing.
    """
    if dense.matcher == "own":
        return sha256(SHIPPED)
    return tree_sha256(Path(dense.weights)) if dense.matcher == "roma" else ""


def matcher_words(dense: DenseSettings, scene: Scene) -> str:
    """What a record says of the matcher's weights, of ours whether they know such scenes; empty where it has none.

    Args:
        dense: Who matches.
        scene: Whose photos are matched.

    Raises: As `weights_sha256`.
    """
    weights = weights_sha256(dense)
    if not weights:
        return ""
    known = f"{domain(scene, SHIPPED)}; " if dense.matcher == "own" else ""
    return f"{known}weights {weights}"


def matcher_facts(settings: object) -> dict[str, str]:
    """The hash of the weights that a method's photos are matched with, as a fact of the record.

    Args:
        settings: Any method's; those that match photos say so as `dense_cell` and `dense`.
    Returns: Nothing where no photos are matched, or the matcher has no weights.
    Raises: As `weights_sha256`.
    """
    dense = getattr(settings, "dense", None)
    if not isinstance(dense, DenseSettings) or not getattr(settings, "dense_cell", 0):
        return {}
    found = weights_sha256(dense)
    return {MATCHER: found} if found else {}
