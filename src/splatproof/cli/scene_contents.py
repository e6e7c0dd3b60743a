"""What lies in a scene's folder, as a method would see it."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from splatproof.reference.types.scene import View

HAS: dict[str, Callable[["View"], object]] = {
    "masks": lambda view: view.load_mask,
    "sky_masks": lambda view: view.load_sky,
    "lidar_sweeps": lambda view: view.load_sweep,
    "true_depths": lambda view: view.load_depth,
    "masks_of_what_moves": lambda view: view.load_moving,
}
"""What a photo may have beside it."""


def contents(folder: Path) -> dict[str, object]:
    """Open a folder under the protocol "default" and count what is in it; no photo is decoded.

    Args:
        folder: The scene's folder, of any format that has an adapter.
    Returns: Facts by name, in the order in which they are printed; what the scene lacks is left out.
    Raises: DataError as `open_scene` does.
    """
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.metrics.protocol_files import load_protocol

    rules = load_protocol("default")
    scene = open_scene(folder, rules)
    views, points = scene.views, scene.points
    times = [view.time for view in views if view.time is not None]
    sizes = Counter(f"{view.camera.width}x{view.camera.height}" for view in views)
    found: dict[str, object] = {
        "name": scene.name,
        "path": str(folder),
        "format": scene.facts.get("adapter", ""),
        "photos": len(views),
        "photos_by_size": dict(sizes.most_common()),
        "protocol": rules.name,
        "held_out": [view.name for view in scene.test_views],
        "points": len(points),
        "photos_a_point": round(len(points.track_views) / max(len(points), 1), 1),
        "units": scene.units,
        "sensors": sorted({view.sensor for view in views if view.sensor}),
        "photos_with_times": len(times),
        "seconds": round(max(times) - min(times), 3) if times else 0,
    }
    found |= {
        f"photos_with_{what}": sum(of(view) is not None for view in views)
        for what, of in HAS.items()
    }
    found["left_out"] = [f"{name}: {reason}" for name, reason in scene.left_out]
    kept = ("photos", "points")
    return {name: value for name, value in found.items() if value or name in kept}
