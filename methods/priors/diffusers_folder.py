"""Pipelines of the diffusers library, from a local folder. Nothing is fetched."""

import importlib
from pathlib import Path
from typing import Any

from splatproof.base.errors import DataError, MissingError


def pipeline(folder: Path, name: str, what: str, instead: str) -> Any:
    """A pipeline with the weights of a folder, silent, on the processor.

    Args:
        folder: As `save_pretrained` of the library wrote it: model_index.json and a folder a part.
        name: Name of its class.
        what: Who asks for it, for errors.
        instead: What does without, for errors.
    Raises: MissingError without the library; DataError where the folder is not such a pipeline's.
    """
    try:
        library = importlib.import_module("diffusers")
        kind = getattr(library, name)  # the library finds out here whether transformers is there
    except (ImportError, RuntimeError):
        raise MissingError(
            f"{what} needs the packages diffusers and transformers: install splatproof[priors], or take "
            f"{instead}, which needs none"
        ) from None
    importlib.import_module("diffusers.utils.logging").disable_progress_bar()
    importlib.import_module("transformers.utils.logging").disable_progress_bar()
    # a checker of what pictures show would black out renders that it does not understand
    unchecked = {"safety_checker": None} if name.startswith("StableDiffusion") else {}
    try:
        made = kind.from_pretrained(
            folder, local_files_only=True, low_cpu_mem_usage=False, **unchecked
        )
    except Exception as error:  # noqa: BLE001 (what the library raises differs with its version)
        said = " ".join(str(error).split())[:200]
        raise DataError(
            f"{folder}: not a folder of a {name} of diffusers ({said}); expected model_index.json and a "
            "folder for each of its parts, as the library's save_pretrained writes them"
        ) from None
    made.set_progress_bar_config(disable=True)
    return made
