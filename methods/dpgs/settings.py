"""What can be chosen about method dpgs."""

import math
from dataclasses import dataclass, field
from typing import Literal

from splatproof.methods.threedgs.settings import Settings
from splatproof.methods.training.schedules import require
from splatproof.reference.supervision.spiral_path import SpiralSettings

RefinerName = Literal["none", "warp", "own", "sd-turbo"]


@dataclass(frozen=True, kw_only=True)
class SideSettings:
    """Side views: where they look from, who refines them, and how often they are trained on. The
    paper gives no numbers but the half of the run that they begin at: these are ours."""

    every: int = 10
    """Steps from one side view to the next, from the middle of the run on, in a shorter run as many; it takes
    the place of a photo. 0: none, an ablation of the paper."""
    refiner: RefinerName = "warp"
    """What makes a side view's target of its render. warp: the nearest photo's texture where that
    photo sees the surface, holes inpainted; own: that, corrected by our small network, whose weights
    come with the package; sd-turbo: Stable Diffusion Turbo as the paper has it, with weights of one's own
    (`pip install splatproof[priors]`); none: the render as it was, a control that says what training on
    one's own renders does."""
    weights: str = ""
    """Folder of sd-turbo's weights, as diffusers saves a StableDiffusionImg2ImgPipeline; nothing is fetched."""
    reference: bool = True
    """Whether sd-turbo sees the nearest photo; off: an ablation of the paper."""
    holes: bool = False
    """Whether side views are trained on where the render has no surface (alpha below one half), and the refiner's
    word is all there is. DPGS's diffusion model may know what stands there; what warping or our network puts
    there hangs in front of the scene as fog (docs/unseen.md), so those pixels are masked unless this is on."""
    refresh: int = 5000
    """Steps, of a 30,000 step run, after which targets are made anew by the model as it is then."""
    spirals: int = 1
    """Number of parts that the ground is cut into, each with a spiral of its own: one around all of
    a city shows outer facades only. The paper has one a block of its partition, and so have methods of
    blocks here; one model has one around everything, so give it about as many as there would be blocks."""
    spiral: SpiralSettings = field(default_factory=SpiralSettings)
    """Shape of a spiral."""

    def __post_init__(self) -> None:
        """Refuse settings that no run can follow."""
        require(self.every >= 0, "side.every", self.every, ">= 0")
        for name in ("refresh", "spirals"):
            require(getattr(self, name) >= 1, f"side.{name}", getattr(self, name), ">= 1")
        needs = self.refiner == "sd-turbo"
        told = "the folder of its weights" if needs else f"none: refiner is {self.refiner!r}"
        require(needs == bool(self.weights), "side.weights", self.weights, told)
        shape = self.spiral
        for name in ("layers", "views"):
            require(getattr(shape, name) >= 1, f"side.spiral.{name}", getattr(shape, name), ">= 1")
        within = 1 <= shape.radius < math.inf  # else orbits go through what they are to circle
        require(within, "side.spiral.radius", shape.radius, "1 or more")
        require(0 <= shape.look_up < 1, "side.spiral.look_up", shape.look_up, "[0, 1)")


NO_SIDES = SideSettings(every=0)
"""No side views at all."""


@dataclass(frozen=True, kw_only=True)
class Dpgs(Settings):
    """Method dpgs: 3dgs with matched points at its start and side views in its second half. Steps
    are those of a 30,000 step run, and a shorter run shrinks them in proportion, except side.every."""

    dense_cell: float = 4.0
    """About how many pixels added points lie apart: before training, photos are matched (by whom
    says dense.matcher), and points added where there are none. 0: none, an ablation of the paper."""
    side: SideSettings = field(default_factory=SideSettings)
    """Side views of places that the photos do not show."""
