"""What a training consists of beside its model and its run."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from jaxtyping import Int
from torch import Tensor

from splatproof.methods.contracts.density_strategy import DensityStrategy
from splatproof.methods.contracts.parameters import Parameters
from splatproof.methods.training.optimizer import Adam
from splatproof.methods.training.resolution import Resolution
from splatproof.methods.training.shape_bounds import Shapes
from splatproof.methods.training.terms import ImageTerm, ParameterTerm
from splatproof.methods.training.view_order import ViewOrder
from splatproof.reference.types.scene import View


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """What a training consists of beside its model and its run."""

    steps: int
    """Number of steps of the whole training."""
    views: tuple[View, ...]
    """Views that are trained on."""
    terms: tuple[ImageTerm | ParameterTerm, ...]
    """What is minimised; their names are distinct."""
    density: DensityStrategy
    key: str
    """Everything that the result depends on, as text: a checkpoint of another key is refused."""
    restarts: tuple[int, ...] = ()
    """Steps after which rates and density control begin again and moments are forgotten, see `restarts`."""
    views_per_step: int = 1
    """Views whose mean gradient one step follows."""
    resolution: Resolution = field(default_factory=Resolution)
    """How large photos are at which step; smaller ones only where the photo's is the one image term."""
    random_background: bool = False
    """Train every view of a step over a background of its own, drawn at random."""
    order: ViewOrder | None = None
    """In which order views come; None: shuffled epochs."""
    optimizer: type[Adam] = Adam
    """How parameters follow their gradients."""
    held: Callable[[Parameters], Mapping[str, Int[Tensor, " _"]]] | None = None
    """Rows of tensors that keep their values in every update, by tensor; None: none do."""
    recount: Callable[[int, float], int | None] | None = None
    """recount(step, seconds of training so far), asked after each step: the number of steps of the whole
    training from now on, with photos in full size; None: as before. None: it stays."""
    shapes: Shapes = field(default_factory=Shapes)
    """Which shapes Gaussians may have."""
    native: bool = True
    """Whether the kernels' own step may be used; False: always autograd."""
