"""Every per-image metric by its name: ours, and those that installed packages add."""

import functools
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from splatproof.base.errors import UsageError
from splatproof.base.names import unknown
from splatproof.base.plugin_files import PluginFile, plugin_files
from splatproof.base.plugins import with_plugins
from splatproof.metrics import colour_difference, gradient, ldr_flip, lpips, pixel, ssim
from splatproof.metrics.scene_registry import SCENE_METRICS

GROUP = "splatproof.metrics"
"""Entry point group of other packages' metrics."""

NAMES = re.compile(r"[a-zA-Z][a-zA-Z0-9_]*")
"""What another's metric may be called: a column, and a key of records."""
TAKEN = frozenset(
    [
        "suite",
        "scene",
        "method",
        "variant",
        "pose_noise",
        "depth_prior",
        "seed",
        "protocol",
        "image",
        "status",
        "error",
        "folder",
        "seconds",
        "primitives",
        "bytes_on_disk",
        "disk_mb",
        "peak_memory_mb",
        "render_ms",
        "train_seconds",
        "cpu_seconds",
        "truth_sha256",
        "valid_share",
    ]
)
"""Keys that stand beside metrics in what commands print and in tables."""

MetricFunction = Callable[
    [Float[Tensor, "h w 3"], Float[Tensor, "h w 3"], Bool[Tensor, "h w"] | None], float
]
"""(image, target, mask of pixels that count or None) -> value; nan where it is undefined."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A per-image metric and how to read it."""

    name: str
    function: MetricFunction
    unit: str
    """Name of the unit; empty: none."""
    higher_is_better: bool
    range: tuple[float, float]
    source: str
    masked: bool = True
    """Whether it can be taken over valid pixels only."""
    load_weights: Callable[[], str] | None = None
    """Loads the metric's network and returns the sha256 of its weights; raises MissingError where
    they are not on this machine. None: the metric needs no weights."""


def all_metrics() -> dict[str, Metric]:
    """Every metric that a protocol may name, in the order in which tables show them.

    Installed packages add theirs through entry points of the group GROUP, each of which loads to a
    `Metric` and has its name; plug-in files have theirs at their top level. Packages are looked up
    at the first call, so that importing this module loads no other package.

    Returns: Ours by name, then those of other packages, then those of plug-in files.
    Raises: UsageError, naming the package or file, where an entry point cannot be loaded or is no
        Metric, or where its name is another than the metric's or one that is in use.
    """
    return _all_metrics(plugin_files())


@functools.cache
def _all_metrics(_: tuple[PluginFile, ...]) -> dict[str, Metric]:
    table = with_plugins(BUILT_IN, GROUP, Metric)
    for name, metric in table.items():
        if name != metric.name:
            raise UsageError(
                f"entry point {name} in {GROUP}: its metric is called {metric.name!r}; both must "
                "have one name, by which protocols and tables know it"
            )
        if name not in BUILT_IN and not NAMES.fullmatch(name) or name in TAKEN:
            raise UsageError(
                f"entry point or plugin's metric {name!r} in {GROUP}: expected a name of letters, digits "
                "and '_' that records do not use for something else"
            )
        if name in SCENE_METRICS:
            raise UsageError(
                f"entry point or plugin's metric {name} in {GROUP}: the name is taken by a metric "
                "of whole scenes; give it another one or leave it out"
            )
    return table


def find_metric(name: str) -> Metric:
    """The metric of that name.

    Raises: UsageError naming the nearest one where there is none, and see `all_metrics`.
    """
    metrics = all_metrics()
    if name not in metrics:
        raise unknown("metric", name, metrics)
    return metrics[name]


def load_weights(names: Iterable[str]) -> dict[str, str]:
    """Load what these metrics need, before long work depends on it.

    Args:
        names: Names of metrics, see `all_metrics`.
    Returns: Metric name -> sha256 of its weights, for the record; only metrics that have some.
    Raises: UsageError on an unknown name, MissingError where something is not on this machine.
    """
    metrics = [find_metric(name) for name in names]
    return {metric.name: metric.load_weights() for metric in metrics if metric.load_weights}


_ALL = (
    Metric(
        name="psnr",
        function=pixel.psnr,
        unit="dB",
        higher_is_better=True,
        range=(0.0, math.inf),
        source="-10 log10(MSE), peak 1",
    ),
    Metric(
        name="ssim_3dgs",
        function=ssim.ssim_3dgs,
        unit="",
        higher_is_better=True,
        range=(-1.0, 1.0),
        source="Wang et al. 2004, 11x11 Gaussian, zero padding as in the 3DGS release",
    ),
    Metric(
        name="ssim_valid",
        function=ssim.ssim_valid,
        unit="",
        higher_is_better=True,
        range=(-1.0, 1.0),
        source="Wang et al. 2004, 11x11 Gaussian, windows inside the image only",
    ),
    Metric(
        name="ssim_skimage",
        function=ssim.ssim_skimage,
        unit="",
        higher_is_better=True,
        range=(-1.0, 1.0),
        source="skimage.metrics.structural_similarity(data_range=1, channel_axis=-1)",
    ),
    Metric(
        name="ssim_kornia",
        function=ssim.ssim_kornia,
        unit="",
        higher_is_better=True,
        range=(-1.0, 1.0),
        source="kornia.metrics.ssim(window_size=11, eps=0), borders mirrored",
    ),
    Metric(
        name="ms_ssim_kornia",
        function=ssim.ms_ssim_kornia,
        unit="",
        higher_is_better=True,
        range=(-1.0, 1.0),
        source="Zhao et al. 2017 as in kornia.losses.MS_SSIMLoss: full-size Gaussians, not a pyramid",
    ),
    Metric(
        name="ssim_contrast",
        function=ssim.ssim_contrast,
        unit="",
        higher_is_better=True,
        range=(0.0, 1.0),
        source="Wang et al. 2004, Eq. 9: the contrast term alone, windows inside the image only",
    ),
    Metric(
        name="flip",
        function=ldr_flip.flip,
        unit="",
        higher_is_better=False,
        range=(0.0, 1.0),
        source="Andersson et al. 2020, LDR-FLIP, 67 pixels per degree, mean of the error map",
    ),
    Metric(
        name="l1",
        function=pixel.l1,
        unit="",
        higher_is_better=False,
        range=(0.0, 1.0),
        source="mean absolute difference",
    ),
    Metric(
        name="delta_e_76",
        function=colour_difference.delta_e_76,
        unit="ΔE",
        higher_is_better=False,
        range=(0.0, math.inf),
        source="CIE76 colour difference, distance in CIELAB (D65) by kornia.color.rgb_to_lab",
    ),
    Metric(
        name="delta_e_2000",
        function=colour_difference.delta_e_2000,
        unit="ΔE",
        higher_is_better=False,
        range=(0.0, math.inf),
        source="CIEDE2000 colour difference (Sharma et al. 2005) in CIELAB by kornia.color.rgb_to_lab",
    ),
    Metric(
        name="gradient_l1",
        function=gradient.gradient_l1,
        unit="",
        higher_is_better=False,
        range=(0.0, gradient.LARGEST),
        source="mean absolute difference of gradient magnitudes, kornia.filters.spatial_gradient",
    ),
    *(
        Metric(
            name=function.__name__,
            function=function,
            unit="",
            higher_is_better=False,
            range=(0.0, math.inf),
            source=f"Zhang et al. 2018, LPIPS v0.1, {network}, inputs in {inputs}, by torchmetrics",
            masked=False,
            load_weights=functools.partial(lpips.load, network),
        )
        for function, network, inputs in (
            (lpips.lpips_vgg_m11, "vgg", "[-1, 1]"),
            (lpips.lpips_alex_m11, "alex", "[-1, 1]"),
            (lpips.lpips_vgg_01, "vgg", "[0, 1] as the 3DGS release has them"),
        )
    ),
)

BUILT_IN: dict[str, Metric] = {metric.name: metric for metric in _ALL}
"""Our own per-image metrics by name; see `all_metrics`."""
