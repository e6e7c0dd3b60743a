"""The native layered memory, drawn into another view, in float64.

It agrees with splatproof.reference.layered_memory.guide_depth up to rounding, which decides only where a square's border
meets the centre of a pixel. A column squeezes at most 2^20 squares into the image.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatproof import _ext
from splatproof.methods.kernels.rasterizer import native_camera
from splatproof.methods.kernels.threads import use_threads
from splatproof.reference.layered_memory.guide_depth import APART, STEEPEST
from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.types.camera import Camera


def render(
    memory: LayeredDepth, camera: Camera
) -> tuple[Float[Tensor, "h w"], Bool[Tensor, "h w"]]:
    """Guide depth and visibility mask of the memory in another view. The same bits for any number of threads.

    Args:
        memory: The layers to be drawn.
        camera: Camera of the view that they are drawn in; its image has the result's size.

    Returns: z-depth in scene units (0 where nothing was drawn) and where something was drawn.

    Raises: ValueError unless the memory is float64 on the CPU, finite, with depths above 0 and sorted, and the
        cameras are finite.

    Source: as of its reference; neighbours by fingers that move along the sorted layers, squares of columns
        only where they may touch the image: ours.
    """
    held = (memory.depths, memory.positions)
    if any(t.dtype != torch.float64 or t.device.type != "cpu" for t in held):
        raise ValueError("expected torch.float64 on the CPU")
    pixels, depths, positions = (t.detach().contiguous() for t in (memory.pixels, *held))
    K, pose, width, height, _ = native_camera(memory.camera)
    reach = 1 + STEEPEST * APART / float(K[0, 0])
    layers = _ext.Layers(pixels, depths, positions, K, pose, width, height, reach)
    depth = torch.empty(camera.height, camera.width, dtype=torch.float64)
    use_threads()
    _ext.draw_layers(layers, *native_camera(camera), depth)
    seen = depth.isfinite()
    return torch.where(seen, depth, 0), seen
