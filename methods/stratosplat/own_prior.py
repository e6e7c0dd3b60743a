"""Our own network as what photos are completed from: with which weights, and whether it knows such scenes."""

from splatproof.base.files import sha256
from splatproof.methods.priors.network import COMPLETION
from splatproof.methods.priors.unet import domain
from splatproof.methods.stratosplat.settings import StratoSplat
from splatproof.reference.types.scene import Scene

COMPLETER = "completion_weights_sha256"
"""The fact of a record that names the weights of the network that completes depths."""


def weights_sha256(settings: StratoSplat) -> str:
    """Hash of the network's weights, in hexadecimal; empty where none completes depths.

    Args:
        settings: What is chosen about the method.

    Raises: DataError where the file is missing.
    """
    return sha256(COMPLETION) if settings.completion.prior == "own" else ""


def completion_words(settings: StratoSplat, scene: Scene) -> str:
    """What a record says of the network: whether it knows such scenes, and its weights; empty where there is none.

    Args:
        settings: What is chosen about the method.
        scene: Whose photos are completed.

    Raises: As `weights_sha256`.
    """
    weights = weights_sha256(settings)
    return f"{domain(scene, COMPLETION)}; weights {weights}" if weights else ""


def completion_facts(settings: object) -> dict[str, str]:
    """The hash of the weights that a method's depths are completed with, as a fact of the record.

    Args:
        settings: Any method's.
    Returns: Nothing where depths are not completed, or by no network.
    Raises: As `weights_sha256`.
    """
    found = weights_sha256(settings) if isinstance(settings, StratoSplat) else ""
    return {COMPLETER: found} if found else {}
