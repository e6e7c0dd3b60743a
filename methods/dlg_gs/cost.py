"""What training dlg-gs takes, before anything has started: time and memory."""

from dataclasses import replace

from splatproof.methods.contracts.method import Cost
from splatproof.methods.dlg_gs.settings import Settings
from splatproof.methods.scaffold.cost import cost as scaffold_cost
from splatproof.reference.types.scene import Scene

COLOURS, ATTENTION, DROPOUT, DEPTH = 0.5, 0.4, 0.45, 0.65
"""What a step takes more, in steps of scaffold-gs: gates, colour head and three more channels; pairs of
anchors; the render without dropped Gaussians; each depth term. Measured on tunnel at 224 px, 600 steps."""


def cost(settings: Settings, scene: Scene) -> Cost:
    """What method dlg-gs takes on a scene.

    Args:
        settings: What is chosen about the method.
        scene: Opened under the protocol; no image is read.
    """
    plain = scaffold_cost(settings, scene)
    steps = 1.0
    if settings.dlaam != "off":
        steps += COLOURS + (ATTENTION if settings.dlaam == "full" else 0)
    if settings.dropout:
        steps += DROPOUT
    steps += DEPTH * {"off": 0, "ec": 1, "mc": 1, "both": 2}[settings.vdjc]
    return replace(plain, cpu_seconds=steps * plain.cpu_seconds)
