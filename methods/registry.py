"""The methods that can be trained here, by name: our own and those of installed packages."""

from functools import partial

from splatproof.base.names import unknown
from splatproof.base.plugins import with_plugins
from splatproof.methods.auto.method import AUTO
from splatproof.methods.city import settings as city
from splatproof.methods.city.cost import city_cost
from splatproof.methods.city.pipeline import fit as fit_city
from splatproof.methods.contracts.method import Method
from splatproof.methods.dlg_gs.method import DLG_GS
from splatproof.methods.dpgs.fit import DPGS
from splatproof.methods.hdgs.method import HDGS
from splatproof.methods.pvg.method import PVG
from splatproof.methods.scaffold.method import SCAFFOLD_GS
from splatproof.methods.sparse_views.cor_gs import COR_GS
from splatproof.methods.sparse_views.dropgaussian import DROPGAUSSIAN
from splatproof.methods.sparse_views.fsgs import FSGS
from splatproof.methods.stratosplat.method import STRATOSPLAT
from splatproof.methods.threedgs.absgs import ABSGS
from splatproof.methods.threedgs.method import THREEDGS
from splatproof.methods.threedgs.mip_splatting import MIP_SPLATTING

GROUP = "splatproof.methods"
"""Entry points of other packages: each loads to a Method of the same name."""


def _city(name: str, settings: type, description: str) -> Method:
    return Method(
        name=name, settings=settings, fit=partial(fit_city, method=name), cost=city_cost,
        description=description, blocks=True,
    )  # fmt: skip


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        THREEDGS,
        AUTO,
        ABSGS,
        MIP_SPLATTING,
        FSGS,
        DROPGAUSSIAN,
        COR_GS,
        DPGS,
        SCAFFOLD_GS,
        HDGS,
        PVG,
        DLG_GS,
        STRATOSPLAT,
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
}
"""Our own methods."""


def methods() -> dict[str, Method]:
    """Every method by name: ours, then those that installed packages add.

    Raises: UsageError if an installed package's entry point cannot be used.
    """
    return with_plugins(METHODS, GROUP, Method)


def get_method(name: str) -> Method:
    """The method of that name.

    Args:
        name: As suites and the command line write it.

    Raises: UsageError, with the nearest name, if there is none.
    """
    known = methods()
    if name not in known:
        raise unknown("method", name, known)
    return known[name]
