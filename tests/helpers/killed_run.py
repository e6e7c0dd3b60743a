"""A run that is broken off and continued, against one that is not."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from helpers.tiny_scene import tiny_scene
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import Settings


class Killed(Exception):
    """Stands for a kill between two steps."""


def assert_continues(settings: Settings, run: Run, step: int, folder: Path) -> None:
    """Broken off at a step and continued, training on the tiny scene gives the same bits."""

    def kill(now: int, total: int, values: dict[str, float]) -> None:
        if now == step:
            raise Killed

    whole = fit(tiny_scene(), settings, replace(run, folder=folder / "whole")).bake()
    cut = replace(run, folder=folder / "cut", checkpoint_seconds=0.0)
    with pytest.raises(Killed):
        fit(tiny_scene(), settings, replace(cut, report=kill))
    assert torch.equal(fit(tiny_scene(), settings, cut).bake().means, whole.means)
