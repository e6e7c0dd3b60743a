"""Who refines the side views of a run, with which weights: read before anything that takes long."""

from dataclasses import dataclass
from pathlib import Path

from splatproof.base.files import sha256, tree_sha256
from splatproof.methods.dpgs.settings import SideSettings
from splatproof.methods.priors.sd_turbo import SdTurboRefiner
from splatproof.methods.priors.view_refiner import SHIPPED, OwnRefiner, load_refiner
from splatproof.reference.supervision.side_views import ViewRefiner, warp_and_fill

REFINER = "refiner_weights_sha256"
"""The fact of a record that names the weights of a refiner."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Refiner:
    """A refiner that is ready, and what it is."""

    refine: ViewRefiner | None = None
    """What makes a target of a side view's render; None: the target is the render itself."""
    weights: str = ""
    """SHA-256 of its weights in hexadecimal; empty where it has none."""


def refiner_of(side: SideSettings) -> Refiner:
    """The refiner that settings ask for, its weights read and hashed.

    Args:
        side: Who refines; own has the weights that come with the package. Without side views nothing is read.

    Raises: MissingError or DataError where sd-turbo lacks its library or weights.
    """
    return Refiner(refine=read_refiner(side), weights=weights_sha256(side))


def read_refiner(side: SideSettings) -> ViewRefiner | None:
    """As `refiner_of`, without the hash, which takes seconds where weights have gigabytes.

    Args:
        side: Who refines.

    Raises: As `refiner_of`.
    """
    if not side.every or side.refiner == "none":
        return None
    if side.refiner == "sd-turbo":
        return SdTurboRefiner(Path(side.weights), reference=side.reference)
    return OwnRefiner(load_refiner()) if side.refiner == "own" else warp_and_fill


def weights_sha256(side: SideSettings) -> str:
    """Hash of the refiner's weights; empty where it has none, or there are no side views.

    Args:
        side: Who refines.

    Raises: DataError where there are none by that name.
    """
    if not side.every or side.refiner not in ("own", "sd-turbo"):
        return ""
    path = Path(side.weights) if side.refiner == "sd-turbo" else SHIPPED
    return tree_sha256(path) if path.is_dir() else sha256(path)


def refiner_facts(settings: object) -> dict[str, str]:
    """The hash of the weights that a method's side views are refined with, as a fact of the record.

    Args:
        settings: Any method's; those that have side views have them as `side`.
    Returns: Nothing where there are no side views or their refiner has no weights.
    Raises: As `weights_sha256`.
    """
    side = getattr(settings, "side", None)
    found = weights_sha256(side) if isinstance(side, SideSettings) else ""
    return {REFINER: found} if found else {}
