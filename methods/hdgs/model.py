"""A model of moving anchors in layers: those alive and in view are decoded into Gaussians."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, get_args

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.contracts.model import Model, Moment, Schedule
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.dynamic.sky import SKY, Sky
from splatproof.methods.dynamic.smoothing import average_velocities, skipped
from splatproof.methods.dynamic.times import Clock
from splatproof.methods.hdgs.consistency import Ice, Pairs, pairs, supported
from splatproof.methods.hdgs.decode import decode_some, visible
from splatproof.methods.hdgs.networks import CONVOLUTION, hierarchy, support
from splatproof.methods.hdgs.settings import Smoothing
from splatproof.methods.kernels.hierarchy import Pyramid
from splatproof.reference.anchors.motion_hierarchy import (
    HierarchySettings,
    MotionAnchors,
)
from splatproof.reference.anchors.vibration import life
from splatproof.reference.partition.frustum import frustum
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.reference.types.splats import Splats

ALIVE = 0.05
"""Life from which an anchor is decoded."""
REACH = math.sqrt(2 * math.log(255))
"""Standard deviations within which an opaque Gaussian has an alpha of 1/255 and more."""
BLUR = 2.0
"""Pixels that rasterizers widen what is smaller than a pixel by, and round to, at most."""
CYCLE = 0.2
"""Model time of PVG (0.02 a frame) in one unit of time of this model: 10 frames."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """How the model's own coordinates lie in the scene's: networks read the model's."""

    middle: tuple[float, float, float]
    """Origin of the model's coordinates in the scene's frame, scene units."""
    unit: float
    """Unit of length of the model in scene units."""

    def inwards(self, positions: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
        """Positions in the scene's frame as the model counts them."""
        return (positions - positions.new_tensor(self.middle)) / self.unit

    def outwards(self, positions: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
        """Positions of the model in the scene's frame."""
        return positions * self.unit + positions.new_tensor(self.middle)


class HdgsModel(Model):
    """Layer 0 and all offsets are stored and trained; deeper anchors and Gaussians are decoded.

    Rows: features, instances, quaternions, log_scales, peaks, velocities, log_spans, offsets1 to
    offsets(N - 1). Labels: centres. Shared: networks and sky. Lengths are in the frame's unit, times
    in tens of frames from the drive's middle.
    """

    def __init__(
        self,
        parameters: Parameters,
        schedules: Mapping[str, Schedule],
        *,
        sizes: HierarchySettings,
        frame: Frame,
        clock: Clock,
        voxel: float,
        ice: Ice,
        smoothing: Smoothing,
        covered: float = 1.0,
    ) -> None:
        """Take the tensors.

        Args:
            parameters: As `start.started` makes them.
            schedules: Rate of each trained tensor.
            sizes: Sizes of the hierarchy.
            frame: Where the model's coordinates lie.
            clock: What turns a view's seconds into model time.
            voxel: Edge of the consistency step's voxels in the frame's unit.
            ice: Which parts of the consistency step run.
            smoothing: What is smoothed while training.
            covered: Alpha from which a pixel teaches the sky nothing.
        """
        super().__init__(parameters, schedules)
        self.sizes, self.frame, self.clock, self.smoothing = sizes, frame, clock, smoothing
        self.voxel = voxel
        self.ice: Ice = ice
        self.sky = Sky(covered)
        self._near: tuple[Tensor, Pairs] | None = None

    def anchors(self) -> MotionAnchors:
        """The stored anchors."""
        return stored_anchors(self.parameters, self.sizes.layers)

    def time(self, view: View) -> float:
        """Time of a view in the unit of the peaks.

        Args:
            view: Its time counts.

        Raises: UsageError if it has none.
        """
        return self.clock.of(view) / CYCLE

    def near(self) -> Pairs:
        """Who stands beside whom: found again whenever the anchors changed, for they never move.

        Density control gives the anchors a new tensor of centres; while that is the same memory, the
        pairs are those of before.
        """
        centres = self.parameters.labels["centres"]
        if self._near is None or self._near[0].data_ptr() != centres.data_ptr():
            self._near = (centres, pairs(centres, self.voxel))
        return self._near[1]

    @torch.no_grad()
    def in_view(self, camera: Camera, time: float, later: float = 0.0) -> Int[Tensor, " v"]:
        """Rows of the anchors that are alive and of whose Gaussians an image may show one.

        All of them are put in their places, residuals and vibration included, by the small networks
        of positions and scales alone; the larger ones run on what is left.

        Args:
            camera: Camera of the image.
            time: In the unit of the peaks.
            later: Time in the same unit that what is drawn has moved on by since then.
        """
        rows = self.parameters.rows
        alive = life(rows["peaks"], rows["log_spans"].exp(), time) > ALIVE
        (index,) = torch.where(alive)
        anchors, networks = self.anchors(), hierarchy(self.parameters.shared, self.sizes.layers)
        drift = self.drift(index, later) if later else None
        pyramid = pyramid_of(camera, self.frame)
        return index[visible(anchors, networks, self.sizes, time, index, pyramid, drift)]

    def drift(self, index: Int[Tensor, " v"], later: float) -> Float[Tensor, "v 3"]:
        """How far anchors get at their average velocity, in the model's unit.

        Args:
            index: Rows of the anchors.
            later: Time in the unit of the peaks.
        """
        rows, period = self.parameters.rows, self.sizes.period
        velocities, spans = (
            rows[name].index_select(0, index) for name in ("velocities", "log_spans")
        )
        return later * average_velocities(velocities, spans.exp(), period, self.smoothing.decay)

    def splats(self, view: View, moment: Moment) -> Splats:
        """What the anchors alive and in view decode to.

        While training, some steps draw the state of a moment nearby, moved on by the average velocity.

        Args:
            view: Its camera and time count.
            moment: Its generator draws the other moment.
        """
        later = skipped(moment, self.smoothing.probability, self.smoothing.reach)
        time = self.time(view) - later
        seen = self.in_view(view.camera, time, later)
        shared, layers = self.parameters.shared, self.sizes.layers
        anchors, features = self.anchors(), None
        if CONVOLUTION in shared:
            rows = self.parameters.rows
            features = supported(
                support(shared), rows["features"], self.parameters.labels["centres"],
                rows["quaternions"], rows["log_scales"].exp(), self.near(), seen, self.ice,
            )  # fmt: skip
        centre = self.frame.inwards(view.camera.centre)
        networks = hierarchy(shared, layers)
        splats = decode_some(
            anchors, networks, self.sizes, time, centre, seen, features=features,
            unit=self.frame.unit, middle=self.frame.middle,
        )  # fmt: skip
        if later:
            drift = self.drift(seen, later).repeat_interleave(self.sizes.gaussians, dim=0)
            splats = replace(splats, means=splats.means + drift * self.frame.unit)
        return splats

    def finish_image(self, view: View, output: RenderOutput) -> Float[Tensor, "h w c"]:
        """The sky behind what was rasterized.

        Args:
            view: What was rendered.
            output: Colours over the background, and alpha.
        """
        return self.sky.behind(self.parameters.shared, view.camera, output)

    @property
    def unbaked(self) -> tuple[str, ...]:
        """The sky, where there is one."""
        return ("its sky",) if SKY in self.parameters.shared else ()

    def facts(self) -> dict[str, Any]:
        """What `restored` needs beside the tensors."""
        return {
            "sizes": asdict(self.sizes), "frame": asdict(self.frame), "clock": self.clock.facts(),
            "voxel": self.voxel, "ice": self.ice,
        }  # fmt: skip


def pyramid_of(camera: Camera, frame: Frame) -> Pyramid:
    """What a camera's image may show, as the model counts lengths.

    Args:
        camera: Camera in the scene's frame.
        frame: The model's coordinates.
    """
    pose = camera.world_to_camera.double().cpu().numpy()[:3].copy()
    pose[:, 3] = (pose[:, :3] @ frame.middle + pose[:, 3]) / frame.unit
    sides = frustum(camera)[1:, :3]  # all pass through the camera
    sides = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    return Pyramid(
        pose=torch.from_numpy(pose.astype(np.float32)),
        near=camera.near / frame.unit,
        sides=torch.from_numpy(sides.astype(np.float32)),
        sigmas=REACH,
        blur=BLUR / float(camera.K.diagonal()[:2].min()),
    )


def stored_anchors(parameters: Parameters, layers: int) -> MotionAnchors:
    """Anchors of a model's tensors.

    Args:
        parameters: As `start.started` makes them.
        layers: Layers of the hierarchy.
    """
    parts = {"centres": parameters.labels["centres"], **parameters.rows}
    offsets = tuple(parts.pop(f"offsets{layer}") for layer in range(1, layers))
    return MotionAnchors(**parts, offsets=offsets)


def restored(facts: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> HdgsModel:
    """The model that was stored; it is not trained on.

    Args:
        facts: What `HdgsModel.facts` said.
        tensors: As `Parameters.state` names them.

    Raises: KeyError, TypeError or ValueError if something is missing or does not fit.
    """
    parameters = Parameters.of(tensors)
    sizes = HierarchySettings(**facts["sizes"])
    hierarchy(parameters.shared, sizes.layers)
    stored_anchors(parameters, sizes.layers)
    if facts["ice"] not in get_args(Ice):
        raise ValueError(f"ice {facts['ice']!r}")
    if CONVOLUTION in parameters.shared:
        support(parameters.shared)
    x, y, z = (float(value) for value in facts["frame"]["middle"])
    frame = Frame(middle=(x, y, z), unit=float(facts["frame"]["unit"]))
    return HdgsModel(
        parameters, {}, sizes=sizes, frame=frame, clock=Clock.read(facts["clock"]),
        voxel=float(facts["voxel"]), ice=facts["ice"], smoothing=Smoothing(),
    )  # fmt: skip
