"""Where a command finds the trained model that it is told, and what that model says of itself."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from splatproof.base.errors import DataError, UsageError

if TYPE_CHECKING:
    from splatproof.methods.contracts.reconstruction import Origin, Reconstruction
    from splatproof.reference.types.protocol import Protocol
    from splatproof.reference.types.scene import Scene


def scene_of(given: Path, origin: "Origin", scene: str | None) -> str:
    """The scene whose views are looked at: the one that is named, else the model's own.

    Args:
        given: The model as the user named it, for errors.
        origin: What the model says of itself.
        scene: Scene that the user named; None: none.
    Returns: Name of a registered scene, or a scene folder.
    Raises: UsageError if nobody says which, or the model's own is not where it was.
    """
    if scene is not None:
        return scene
    if not origin.scene:
        raise UsageError(
            f"{given}: does not say which scene it was trained on; name it with --scene, and the "
            "protocol with --protocol"
        )
    if Path(origin.scene).is_absolute() and not Path(origin.scene).is_dir():
        raise UsageError(
            f"{given}: was trained on {origin.scene}, which is no folder any more; say with --scene "
            "where the scene is now"
        )
    return origin.scene


def placed(model: "Reconstruction", scene: "Scene") -> "Reconstruction":
    """The model in a scene's frame, where it is from a file that says another shift than the scene.

    A model without a shift is in the scene's frame already: an .spz or a .sog, or a .ply that was written with
    --local.

    Args:
        model: What was loaded; only explicit Gaussians say a shift.
        scene: Whose views are looked at.
    """
    from splatproof.methods.models.explicit import ExplicitModel

    if not isinstance(model, ExplicitModel) or not bool(model.shift.any()):
        return model
    step = model.shift - scene.shift
    if not bool(step.any()):
        return model
    means = (model.model.means.double() + step).float()
    return replace(model, model=replace(model.model, means=means), shift=scene.shift)


def protocol_of(given: Path, origin: "Origin", protocol: str | None) -> "Protocol":
    """The protocol of the views: the one that is named, else the model's own, rule by rule.

    Args:
        given: The model as the user named it, for errors.
        origin: What the model says of itself.
        protocol: Name of a protocol or path of a .toml file; None: the model's own.
    Returns: The rules.
    Raises: UsageError if nobody says which; DataError if the model's own rules are damaged.
    """
    from splatproof.metrics.protocol_files import load_protocol, protocol_from_rules

    if protocol is not None:
        return load_protocol(protocol)
    if not origin.protocol:
        raise UsageError(
            f"{given}: does not say which protocol it was trained under; name it with --protocol, "
            "and the scene with --scene"
        )
    rules = dict(origin.protocol)
    try:
        return protocol_from_rules(str(rules.pop("name", "")), rules, f"{given}: its protocol")
    except UsageError as error:
        raise DataError(f"{error}; name a protocol with --protocol") from None
