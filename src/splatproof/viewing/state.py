"""What the page knows of a stage: names, cameras and choices, as plain data."""

from typing import Any

from splatproof.reference.types.scene import View
from splatproof.viewing.modes import MODES
from splatproof.viewing.poses import level, typical_field
from splatproof.viewing.stage import Shown, Stage


def state_of(stage: Stage) -> dict[str, Any]:
    """Everything but pictures, JSON-ready.

    Args:
        stage: What is shown.
    """
    scene, place = stage.scene, stage.place
    views = () if scene is None else scene.views
    trained = set() if scene is None else set(scene.train)
    start = next(iter(stage.training), views[0] if views else None)
    return {
        "models": [_model(stage, shown) for shown in stage.models],
        "modes": [
            {"name": name, "label": mode.label, "legend": mode.legend}
            for name, mode in MODES.items()
        ],
        "scene": None if scene is None else scene.name,
        "views": [_view(view, i in trained) for i, view in enumerate(views)],
        "place": {"centre": place.centre.tolist(), "radius": place.radius, "up": place.up.tolist(),
                  "across": level(place.up).tolist()},
        "fov": typical_field(stage.training),
        "start": None if start is None else views.index(start),
        "times": stage.times,
        "lights": [view.name for view in stage.training]
        if any(shown.adapts for shown in stage.models)
        else [],
    }  # fmt: skip


def _model(stage: Stage, shown: Shown) -> dict[str, Any]:
    return {
        "name": shown.name, "kind": shown.model.kind, "primitives": shown.model.primitives,
        "step": shown.step, "steps": shown.steps,
        "missing": {name: mode.missing(stage, shown) for name, mode in MODES.items()},
    }  # fmt: skip


def _view(view: View, trains: bool) -> dict[str, Any]:
    camera = view.camera
    return {
        "name": view.name, "trains": trains, "time": view.time,
        "centre": camera.centre.tolist(), "rotation": camera.rotation.tolist(),
        "width": camera.width, "height": camera.height,
        "focal": [float(camera.K[0, 0]), float(camera.K[1, 1])],
    }  # fmt: skip
