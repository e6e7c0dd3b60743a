"""Method 3dgs as the registry knows it."""

from splatproof.methods.contracts.method import Method
from splatproof.methods.threedgs.cost import cost
from splatproof.methods.threedgs.fit import fit
from splatproof.methods.threedgs.settings import ThreeDGS

THREEDGS = Method(
    name="3dgs",
    settings=ThreeDGS,
    fit=fit,
    cost=cost,
    description="3D Gaussian Splatting (Kerbl et al. 2023): SfM points, adaptive density control, "
    "opacity reset, SH warm-up, L1 + 0.2 D-SSIM",
)
