"""All components that have twins. Put a new one here and it is timed, judged, plotted and tested."""

from splatproof.suites.twins.anchors import DECODING
from splatproof.suites.twins.consistency import CONSISTENCY
from splatproof.suites.twins.diffusion import DIFFUSION
from splatproof.suites.twins.files import PACKING
from splatproof.suites.twins.fragments import FRAGMENTS
from splatproof.suites.twins.hierarchy import HIERARCHY
from splatproof.suites.twins.images import LOSS, SSIM
from splatproof.suites.twins.layers import GUIDE_DEPTH
from splatproof.suites.twins.lighting import ATTENTION, COLOUR_HEAD
from splatproof.suites.twins.optimizers import ADAM
from splatproof.suites.twins.ranks import SOFT_RANK
from splatproof.suites.twins.rasterizers import PIPELINE, RASTERIZER
from splatproof.suites.twins.stitching import STITCHING
from splatproof.suites.twins.stored import STORED
from splatproof.suites.twins.training import TRAINING
from splatproof.suites.twins.twin import Component
from splatproof.suites.twins.virtual import FIELD, HYBRID

COMPONENTS: dict[str, Component] = {
    component.name: component
    for component in (
        RASTERIZER, FRAGMENTS, PIPELINE, LOSS, SSIM, ADAM, DECODING, HIERARCHY, ATTENTION, COLOUR_HEAD,
        CONSISTENCY, DIFFUSION, GUIDE_DEPTH, FIELD, SOFT_RANK, STITCHING, STORED, PACKING, TRAINING, HYBRID,
    )
}  # fmt: skip
