"""What training dlg-gs takes, before anything has started: time and memory."""

from splatproof.methods.contracts.method import Cost
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.methods.scaffold.cost import cost as scaffold_cost
from splatproof.reference.types.scene import Scene


def cost(settings: Settings, scene: Scene) -> Cost:
    """What method dlg-gs takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    return scaffold_cost(settings, scene)
