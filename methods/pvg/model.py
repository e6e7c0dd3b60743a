"""Gaussians that swing about their centres and fade around their life peaks."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.methods.contracts.model import Model, Moment, Schedule
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.dynamic.sky import SKY, Sky
from splatproof.methods.dynamic.smoothing import average_velocities, skipped
from splatproof.methods.dynamic.times import Clock
from splatproof.methods.models.gaussian_model import assemble
from splatproof.methods.pvg.settings import Motion
from splatproof.methods.training.schedules import active_degree
from splatproof.reference.anchors.vibration import life, vibrate
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats, activated

LEAST_SPAN, MOST_SPAN = 1e-4, 1e6
"""Bounds of spans of life as they are drawn, in model time: a frame is 0.02."""
ROWS = (
    "means", "sh_dc", "sh_rest", "opacity_logits", "log_scales", "quaternions", "peaks", "log_spans",
    "velocities",
)  # fmt: skip


class VibrationModel(Model):
    """Explicit Gaussians, each with a life peak, a span of life and a velocity at the peak.

    Source: Chen et al. 2023, "Periodic Vibration Gaussian", Sec. 3.2.
    """

    def __init__(
        self,
        parameters: Parameters,
        schedules: Mapping[str, Schedule],
        *,
        clock: Clock,
        motion: Motion,
        mode: Mode = "classic",
        sh_every: float = 0.0,
        covered: float = 1.0,
    ) -> None:
        """Take the tensors.

        Args:
            parameters: Rows as named in ROWS, and where there is a sky, its shared tensor.
            schedules: Rate of each trained tensor.
            clock: What model time is.
            motion: Period, and what is smoothed while training.
            mode: How it is rasterized.
            sh_every: Steps until one more band of harmonics is drawn; 0: all from the start.
            covered: Alpha from which a pixel teaches the sky nothing.

        Raises: KeyError or ValueError for rows that are missing or of another shape.
        """
        super().__init__(parameters, schedules)
        self.degree = math.isqrt(parameters.rows["sh_rest"].shape[1] + 1) - 1
        for name in ROWS:
            if parameters.rows[name].shape[1:] != self._shape(name):
                raise ValueError(f"{name} has shape {tuple(parameters.rows[name].shape)}")
        self.clock, self.motion, self.sh_every = clock, motion, sh_every
        self.mode: Mode = mode
        self.sky = Sky(covered)

    def _shape(self, name: str) -> tuple[int, ...]:
        """Shape of one row of a tensor."""
        shapes = {
            "sh_dc": (1, 3), "sh_rest": ((self.degree + 1) ** 2 - 1, 3), "quaternions": (4,),
            "opacity_logits": (), "peaks": (), "log_spans": (),
        }  # fmt: skip
        return shapes.get(name, (3,))

    def splats(self, view: View, moment: Moment) -> Splats:
        """The Gaussians that live at the view's time, where they are then.

        While training, some steps draw the state of a moment nearby, moved on by the average
        velocity: so motion is smooth in time without another loss.

        Args:
            view: Its time counts.
            moment: Says how many bands of harmonics are drawn; its generator draws the other moment.

        Raises: UsageError if the view has no time.
        """
        motion = self.motion
        later = skipped(moment, motion.smoothing, motion.reach)
        then = self.clock.of(view) - later
        rows = self.parameters.rows
        with torch.no_grad():
            shown = life(rows["peaks"], spans(rows), then) > motion.least_life
        index = None
        if not bool(shown.all()):
            index = torch.where(shown)[0]
            rows = {name: rows[name].index_select(0, index) for name in ROWS}
        means = vibrate(rows["means"], rows["velocities"], rows["peaks"], then, motion.period)
        if later:
            slow = average_velocities(rows["velocities"], spans(rows), motion.period, motion.decay)
            means = means + slow * later
        degree = self.degree
        if moment.trains:
            degree = active_degree(moment.step, self.sh_every, self.degree)
        drawn = activated(assemble({**rows, "means": means}, degree))
        return Splats(
            means=drawn.means, quaternions=drawn.quaternions, scales=drawn.scales, sh=drawn.sh,
            opacities=drawn.opacities * life(rows["peaks"], spans(rows), then), rows=index,
        )  # fmt: skip

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w c"]:
        """The sky behind what was drawn, where there is one.

        Args:
            view: Its camera counts.
            output: Colours, alpha.
        """
        return self.sky.behind(self.parameters.shared, view.camera, output)

    @property
    def unbaked(self) -> tuple[str, ...]:
        """The sky, where there is one."""
        return ("its sky",) if SKY in self.parameters.shared else ()

    def facts(self) -> dict[str, Any]:
        """What `restored` needs beside the tensors."""
        return {
            "clock": self.clock.facts(), "period": self.motion.period,
            "least_life": self.motion.least_life, "mode": self.mode,
        }  # fmt: skip


def spans(rows: Mapping[str, Tensor]) -> Float[Tensor, " n"]:
    """Spans of life in model time.

    Args:
        rows: log_spans counts.
    """
    return rows["log_spans"].clamp(math.log(LEAST_SPAN), math.log(MOST_SPAN)).exp()


def restored(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> VibrationModel:
    """The model that was stored; it is not trained on.

    Args:
        facts: What `VibrationModel.facts` said.
        tensors: As `Parameters.state` names them.

    Raises: KeyError, TypeError or ValueError if something is missing or does not fit.
    """
    motion = Motion(period=float(facts["period"]), least_life=float(facts["least_life"]))
    if facts["mode"] not in ("classic", "antialiased"):
        raise ValueError(f"mode is {facts['mode']!r}")
    return VibrationModel(
        Parameters.of(tensors), {}, clock=Clock.read(facts["clock"]), motion=motion,
        mode=facts["mode"],
    )  # fmt: skip
