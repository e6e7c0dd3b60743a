"""The rows that can be trained here, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from splatproof.base.names import unknown
from splatproof.methods.city import settings as city
from splatproof.methods.city.pipeline import fit as fit_city
from splatproof.methods.models.explicit import Reconstruction
from splatproof.methods.run import Run
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training import loop as training
from splatproof.reference.types.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Method:
    """One row of a leaderboard."""

    name: str
    settings: type
    """Frozen dataclass with a default for every field; all have `iterations`."""
    fit: Callable[[Scene, Any, Run], Reconstruction]
    """fit(scene, settings, run): train on scene.train_views only."""
    description: str
    """One line."""


def _city(name: str, settings: type, description: str) -> Method:
    return Method(
        name=name, settings=settings, fit=partial(fit_city, method=name), description=description
    )


METHODS: dict[str, Method] = {
    "3dgs": Method(
        name="3dgs",
        settings=Settings,
        fit=training.fit,
        description="3D Gaussian Splatting (Kerbl et al. 2023): SfM points, adaptive density "
        "control, opacity reset, SH warm-up, L1 + 0.2 D-SSIM",
    ),
    **{
        row.name: row
        for row in (
            _city(
                "citygaussian",
                city.CityGaussian,
                "blocks of a uniform grid in contracted space, each fine-tuned from a coarse model; "
                "hard merge (Liu et al. 2024)",
            ),
            _city(
                "vastgaussian",
                city.VastGaussian,
                "camera-balanced grid, views by the visibility of a cell's airspace; hard merge "
                "(Lin et al. 2024), without its appearance network",
            ),
            _city(
                "blockgaussian",
                city.BlockGaussian,
                "rectangles halved by point density, what their views see beyond trained but not "
                "densified; hard merge (Wu et al. 2025), without depth and pseudo views",
            ),
            _city(
                "dpgs-partition",
                city.DpgsPartition,
                "blocks of equal rendering load (ODBP), frozen ghosts around each; hard merge",
            ),
            _city(
                "stitchgs",
                city.StitchGS,
                "density split, balanced sampling, stochastic stitching, global refinement, "
                "compression; each can be switched off",
            ),
            _city(
                "odbp+stitch",
                city.OdbpStitch,
                "ODBP and ghosts of DPGS, sampling, stitching, refinement and compression of StitchGS",
            ),
        )
    },
}


def get_method(name: str) -> Method:
    """The method of that name.

    Raises: UsageError, with the nearest name, if there is none.
    """
    if name not in METHODS:
        raise unknown("method", name, METHODS)
    return METHODS[name]
