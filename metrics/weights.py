"""Weights of learned metrics on disk. Nothing is ever downloaded."""

import functools
import os
import re
from pathlib import Path

import torch

from splatproof.base.errors import DataError, MissingError
from splatproof.base.files import sha256

WEIGHTS = {
    "vgg": "https://download.pytorch.org/models/vgg16-397923af.pth",
    "alex": "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
}
"""Network -> where its weights come from; a file's name ends in 8 digits of its sha256."""
VARIABLE = "SPLATPROOF_WEIGHTS"
"""Names a folder with the files of WEIGHTS; torch's own hub folder is looked at too."""


def weights_folders() -> tuple[Path, ...]:
    """Where weights are looked for: $SPLATPROOF_WEIGHTS, then torch's hub (TORCH_HOME)."""
    own = os.environ.get(VARIABLE, "")
    hub = Path(torch.hub.get_dir()) / "checkpoints"
    return (Path(own), hub) if own else (hub,)


def find_weights(network: str) -> Path:
    """The file of a network of WEIGHTS.

    Raises: MissingError naming where it was looked for and where it comes from.
    """
    url = WEIGHTS[network]
    name = url.rsplit("/", 1)[1]
    for folder in weights_folders():
        if (folder / name).is_file():
            return folder / name
    looked = " or ".join(map(str, weights_folders()))
    raise MissingError(
        f"weights {name} are not in {looked}; download {url} to there, or set {VARIABLE} to the "
        "folder that has them"
    )


@functools.cache
def weights_sha256(path: Path) -> str:
    """Sha256 of a file of weights, which must begin as the file's name says.

    Raises: DataError where it is another.
    """
    found = sha256(path)
    promised = re.findall(r"-([0-9a-f]{8})\.pth$", path.name)[0]
    if not found.startswith(promised):
        raise DataError(
            f"{path}: sha256 is {found[:8]}..., expected {promised}...; download it again"
        )
    return found
