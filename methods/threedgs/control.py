"""Which density control the settings of method 3dgs ask for."""

from collections.abc import Sequence

from splatproof.base.errors import UsageError
from splatproof.methods.contracts.backends import get_backend
from splatproof.methods.contracts.density_strategy import DensityStrategy
from splatproof.methods.contracts.run import Run
from splatproof.methods.threedgs.density import StrategicDensity
from splatproof.methods.threedgs.error_control import ErrorControl
from splatproof.methods.threedgs.mcmc import McmcControl
from splatproof.methods.threedgs.scored_views import ViewScorer
from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.threedgs.spread_control import SpreadControl
from splatproof.methods.training.density_control import DensityControl
from splatproof.methods.training.schedules import log_linear
from splatproof.reference.types.scene import View


def control(settings: Settings, views: Sequence[View], extent: float, run: Run) -> DensityStrategy:
    """The density control of a run.

    Args:
        settings: What is chosen about the method.
        views: Training views, whose photos are kept in memory where errors are looked at.
        extent: Size of the scene in scene units.
        run: Backend and background.
    """
    density, iterations = settings.density, settings.round_steps
    if not isinstance(density, StrategicDensity):
        return DensityControl(density, iterations=iterations, extent=extent)
    if density.strategy == "mcmc":
        rates = settings.rates
        rate = log_linear(rates.means, rates.means_final, factor=extent)
        return McmcControl(density, iterations=iterations, extent=extent, rate=rate)
    if not density.looks:
        return DensityControl(density, iterations=iterations, extent=extent)
    backend = get_backend(run.backend)
    scorer = ViewScorer(
        views=views, count=density.scored_views, backend=backend,
        mode=settings.mode, background=run.background, resolution=settings.resolution,
        total=iterations, dssim=settings.dssim,
    )  # fmt: skip
    if density.strategy == "spread":
        if backend.tally is None:
            raise UsageError(
                f"setting density.strategy is 'spread', and backend {run.backend} does not tell single fragments; use "
                "backend cpu or another strategy"
            )
        return SpreadControl(density, iterations=iterations, extent=extent, scorer=scorer)
    return ErrorControl(density, iterations=iterations, extent=extent, scorer=scorer)
