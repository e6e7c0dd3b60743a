"""Prior `depth-anything:PATH`: a monocular network of the transformers library, from a local folder."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from splatproof.base.errors import DataError, MissingError
from splatproof.reference.types.scene import DepthPrior, Scene


def prepare(scene: Scene, weights: Path | None, seed: int) -> Callable[[int], DepthPrior]:
    """How to make the prior of a view, by its index in the scene. Nothing is fetched.

    The network must predict disparity up to scale and zero, as Depth Anything, DPT and MiDaS do;
    where its configuration says that it predicts metres, disparity is one over that.

    Args:
        scene: Any scene.
        weights: Folder with config.json, preprocessor_config.json and model.safetensors.
        seed: Not used; it draws nothing.
    Raises: MissingError without the library; DataError where the folder is not such a model's.
    """
    assert weights is not None
    process, network = _loaded(weights)
    metres = getattr(network.config, "depth_estimation_type", "relative") == "metric"

    def make(index: int) -> DepthPrior:
        view = scene.views[index]
        pixels = (view.load() * 255).round().byte().numpy()
        with torch.inference_mode():
            said = network(**process(images=pixels, return_tensors="pt")).predicted_depth[:, None]
            said = torch.nn.functional.interpolate(
                said.float(), view.size, mode="bicubic", align_corners=False
            )[0, 0]
        disparity = 1 / said.clamp(min=1e-3) if metres else said
        return DepthPrior(disparity=disparity.clone(), valid=disparity.isfinite())

    return make


def _loaded(folder: Path) -> tuple[Any, Any]:
    """The network and what prepares its images."""
    try:
        library = importlib.import_module("transformers")
    except ImportError:
        raise MissingError(
            "depth prior 'depth-anything' needs the package transformers: install splatproof[priors], "
            "or take 'sweep', which needs none"
        ) from None
    try:
        process = library.AutoImageProcessor.from_pretrained(folder, local_files_only=True)
        network = library.AutoModelForDepthEstimation.from_pretrained(folder, local_files_only=True)
    except Exception as error:  # noqa: BLE001 (what the library raises differs with its version)
        said = " ".join(str(error).split())[:200]
        raise DataError(
            f"{folder}: not a folder of a depth network of transformers ({said}); expected "
            "config.json, preprocessor_config.json and model.safetensors"
        ) from None
    return process, network.eval()
