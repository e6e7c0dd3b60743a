"""All components that have twins. Put a new one here and it is timed, judged, plotted and tested."""

from splatbench.suites.twins.files import PACKING
from splatbench.suites.twins.images import LOSS, SSIM
from splatbench.suites.twins.optimizers import ADAM
from splatbench.suites.twins.ranks import SOFT_RANK
from splatbench.suites.twins.rasterizers import PIPELINE, RASTERIZER
from splatbench.suites.twins.stitching import STITCHING
from splatbench.suites.twins.training import TRAINING
from splatbench.suites.twins.twin import Component

COMPONENTS: dict[str, Component] = {
    component.name: component
    for component in (
        RASTERIZER, PIPELINE, LOSS, SSIM, ADAM, SOFT_RANK, STITCHING, PACKING, TRAINING,
    )
}  # fmt: skip
