"""Native CPU kernels of splatproof."""

import math

from torch import Tensor

def simd_level() -> str:
    """The SIMD level in use."""

def simd_levels() -> list[str]:
    """SIMD levels that this machine can run, slowest first."""

def set_simd_level(name: str) -> None:
    """Use another level from now on."""

def threads() -> int:
    """Threads in use."""

def set_threads(count: int) -> None:
    """Use so many threads from now on."""

def compiler() -> str:
    """The compiler that built this module."""

def exp2(x: Tensor, y: Tensor) -> None:
    """y = 2^x for x in [-100, 0], as the kernels compute it."""

class CodecTables:
    """Tables of the logistic function."""

    def __init__(self, stretch: Tensor, squash: Tensor) -> None: ...

def morton_of_cells(cells: Tensor, codes: Tensor) -> None:
    """Places of cells on the Morton curve."""

def cells_of_morton(codes: Tensor, cells: Tensor) -> None:
    """Cells of places on the Morton curve."""

def nearest_before(cells: Tensor, window: int, nearest: Tensor) -> None:
    """The three nearest of those just before each."""

def encode_gaps(tables: CodecTables, codes: Tensor) -> bytes:
    """A stream of codes that never decrease."""

def decode_gaps(tables: CodecTables, data: bytes, codes: Tensor) -> None:
    """The codes of such a stream, written into zeros."""

def encode_columns(
    tables: CodecTables, codes: Tensor, bits: Tensor, nearest: Tensor, side: Tensor
) -> bytes:
    """A stream of columns."""

def decode_columns(
    tables: CodecTables, data: bytes, bits: Tensor, nearest: Tensor, side: Tensor, codes: Tensor
) -> None:
    """The columns of such a stream, written into zeros."""

def encode_harmonics(tables: CodecTables, codes: Tensor, nearest: Tensor, classes: Tensor) -> bytes:
    """A stream of codes of harmonics."""

def decode_harmonics(
    tables: CodecTables, data: bytes, nearest: Tensor, classes: Tensor, codes: Tensor
) -> None:
    """The columns of such a stream, written into zeros."""

def restore_harmonics(
    codes: Tensor, classes: Tensor, base: float, opponent: Tensor, sh: Tensor
) -> None:
    """SH coefficients of codes."""

def stage_seconds() -> dict[str, float]:
    """Wall seconds of project, bin, blend, blend_backward and project_backward of the last calls."""

def roofline(seconds: float, bytes: int) -> dict[str, float]:
    """flops, blend_pairs, blend_backward_pairs and bytes a second of all threads at this SIMD level."""

def count_pairs(splats: Tensor, width: int, height: int) -> dict[str, float]:
    """Pairs that an image cannot do without: contributing, and lanes of 4x4 blocks."""

class Model:
    """Arrays of a set of Gaussians."""

    def __init__(
        self,
        means: Tensor,
        quaternions: Tensor | None,
        scales: Tensor | None,
        opacities: Tensor | None,
        colours: Tensor | None,
        sh: Tensor | None,
        sh_used: int,
        raw: bool,
        antialiased: bool,
        sh_rest: Tensor | None = None,
        stop: float = 1e-4,
        sigmas: float = math.inf,
    ) -> None: ...

class State:
    """What a backward pass needs of the forward pass."""

    @property
    def bytes(self) -> int:
        """Memory held."""

    @property
    def pairs(self) -> int:
        """Pairs of Gaussian and tile."""

def render(
    model: Model,
    K: Tensor,
    world_to_camera: Tensor,
    width: int,
    height: int,
    near: float,
    background: Tensor | None,
    colour: Tensor,
    alpha: Tensor,
    depth: Tensor,
    radii: Tensor,
    left: Tensor | None,
    distance: Tensor | None,
    median: Tensor | None,
    ids: Tensor | None,
    weights: Tensor | None,
) -> State:
    """Render into the given arrays."""

def render_again(before: State, model: Model, background: Tensor | None, colour: Tensor) -> State:
    """Other colours of Gaussians that were drawn, and what a backward pass needs of that."""

def render_backward(
    state: State,
    model: Model,
    background: Tensor | None,
    alpha_value: Tensor,
    depth_value: Tensor,
    distance_value: Tensor | None,
    colour: Tensor | None,
    alpha: Tensor | None,
    depth: Tensor | None,
    distance: Tensor | None,
    median: Tensor | None,
    means: Tensor | None,
    quaternions: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor | None,
    colours: Tensor | None,
    sh: Tensor | None,
    screen: Tensor | None,
    screen_absolute: Tensor | None,
    fragments: Tensor | None = None,
) -> None:
    """Gradients of the model from gradients of the pictures."""

def photometric(
    image: Tensor, truth: Tensor, mask: Tensor | None, dssim: float, gradient: Tensor | None
) -> float:
    """The loss; its gradient goes into `gradient`."""

def adam(
    values: list[int],
    gradients: list[int],
    first: list[int],
    second: list[int],
    lengths: list[int],
    sizes: list[int],
    rates: list[float],
    step: int,
    beta1: float,
    beta2: float,
    epsilon: float,
    rows: Tensor | None,
) -> None:
    """One update of all tensors in place."""

def step(
    model: Model,
    K: Tensor,
    world_to_camera: Tensor,
    width: int,
    height: int,
    near: float,
    background: Tensor | None,
    truth: Tensor,
    mask: Tensor | None,
    dssim: float,
    means: Tensor | None,
    quaternions: Tensor | None,
    scales: Tensor | None,
    opacities: Tensor | None,
    sh: Tensor | None,
    sh_rest: Tensor | None,
    screen: Tensor | None,
    screen_absolute: Tensor | None,
    radii: Tensor,
) -> float:
    """The loss of one view; its gradients go into the given arrays, unless it is not finite."""

def observe(
    screen: Tensor,
    radii: Tensor,
    half_width: float,
    half_height: float,
    gradient_sum: Tensor,
    seen: Tensor,
) -> None:
    """Add one view's screen gradients to the sums."""

def memory() -> tuple[int, int, int]:
    """Bytes of scratch in use, most in use at once, and kept for later."""

def forget_peak() -> None:
    """The most in use starts again at what is in use now."""

def pairs_listed() -> int:
    """Pairs of Gaussian and tile of all pictures of this process so far."""

def set_backward_rows(count: int) -> None:
    """Pairs of Gaussian and tile whose gradients a backward pass holds at once."""

def render_blocks(
    model: Model,
    K: Tensor,
    world_to_camera: Tensor,
    width: int,
    height: int,
    near: float,
    background: Tensor | None,
    blocks: Tensor,
    colour: Tensor,
    alpha: Tensor,
    depth: Tensor,
) -> None:
    """Render each block of Gaussians alone."""

class Anchors:
    """Arrays of anchors and of the networks that decode them."""

    def __init__(
        self,
        centres: Tensor,
        offsets: Tensor,
        features: Tensor,
        log_scales: Tensor,
        index: Tensor | None,
        camera_centre: Tensor,
        with_distance: bool,
        own_features: bool,
        networks: list[Tensor],
    ) -> None: ...

class Decoded:
    """What a backward pass needs of the decoding of anchors."""

    @property
    def count(self) -> int:
        """Gaussians."""

    @property
    def bytes(self) -> int:
        """Memory held."""

def open_anchors(anchors: Anchors) -> Decoded:
    """Evaluate what decides how many Gaussians there are."""

def fill_anchors(
    state: Decoded,
    anchors: Anchors,
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    rows: Tensor,
    slots: Tensor,
) -> None:
    """Decode the Gaussians into the given arrays."""

def decode_backward(
    state: Decoded,
    anchors: Anchors,
    quaternions: Tensor,
    scales: Tensor,
    colours: Tensor,
    of_means: Tensor | None,
    of_quaternions: Tensor | None,
    of_scales: Tensor | None,
    of_opacities: Tensor | None,
    of_colours: Tensor | None,
    by_centres: Tensor | None,
    by_offsets: Tensor | None,
    by_features: Tensor | None,
    by_log_scales: Tensor | None,
    by_networks: list[Tensor],
) -> None:
    """Gradients by anchors and networks from gradients by what was decoded."""

class NearLists:
    """Of each anchor those near it."""

    def __init__(self, starts: Tensor, targets: Tensor) -> None: ...

class Attended:
    """Query, key and value of some anchors, and what each mixed of those near it."""

    def __init__(
        self,
        lists: NearLists,
        query: Tensor,
        key: Tensor,
        value: Tensor,
        rows: Tensor,
        centres: Tensor | None,
        radius: float,
    ) -> None: ...

def attend(state: Attended, mixed: Tensor) -> None:
    """What each anchor mixes into the given array."""

def attend_backward(
    state: Attended, of: Tensor, by_query: Tensor, by_key: Tensor, by_value: Tensor
) -> None:
    """Gradients by query, key and value from the gradient by what was mixed."""

class MovingAnchors:
    """Arrays of a hierarchy of anchors and of the networks that decode it."""

    def __init__(
        self,
        features: Tensor,
        instances: Tensor,
        centres: Tensor,
        velocities: Tensor,
        log_scales: Tensor,
        peaks: Tensor,
        log_spans: Tensor,
        offsets: list[Tensor],
        index: Tensor | None,
        camera_centre: Tensor,
        own_features: bool,
        children: int,
        gaussians: int,
        period: float,
        time: float,
        unit: float,
        middle: Tensor,
        networks: list[Tensor],
    ) -> None: ...

def visible_anchors(
    anchors: MovingAnchors,
    pose: Tensor,
    sides: Tensor,
    near: float,
    sigmas: float,
    blur: float,
    drift: Tensor | None,
    out: Tensor,
) -> None:
    """Whether a view's pyramid may show a Gaussian of each anchor."""

def decode_moving_anchors(
    anchors: MovingAnchors,
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colours: Tensor,
    rows: Tensor,
    slots: Tensor,
) -> None:
    """Decode the Gaussians into the given arrays."""

def moving_anchors_backward(
    anchors: MovingAnchors,
    of_means: Tensor | None,
    of_quaternions: Tensor | None,
    of_scales: Tensor | None,
    of_opacities: Tensor | None,
    of_colours: Tensor | None,
    by_anchors: list[Tensor | None],
    by_networks: list[Tensor],
) -> None:
    """Gradients by anchors and networks from gradients by what was decoded."""

class Sites:
    """Arrays of anchors that support one another, and of the networks for it."""

    def __init__(
        self,
        features: Tensor,
        centres: Tensor,
        quaternions: Tensor,
        scales: Tensor,
        sites: Tensor,
        neighbours: Tensor,
        ends: list[int],
        seen: Tensor,
        parameters: list[Tensor],
        modulated: bool,
        gated: bool,
    ) -> None: ...

def support(sites: Sites, out: Tensor, mixed: Tensor) -> None:
    """Features of the seen sites after the step."""

def support_backward(
    sites: Sites,
    mixed: Tensor,
    of_out: Tensor | None,
    by_features: Tensor | None,
    by_quaternions: Tensor | None,
    by_scales: Tensor | None,
    by_parameters: list[Tensor],
) -> None:
    """Gradients by sites and parameters from gradients by the features after the step."""

class ColourHead:
    """Colours of Gaussians and the network that adapts them."""

    def __init__(
        self,
        colours: Tensor,
        of_each: Tensor,
        owner: Tensor,
        of_colour: Tensor,
        second: Tensor,
        second_bias: Tensor,
        third: Tensor,
        third_bias: Tensor,
    ) -> None: ...

def adapt_colours(head: ColourHead, adapted: Tensor) -> None:
    """Adapted colours into the given array."""

def adapt_colours_backward(
    head: ColourHead,
    of: Tensor,
    by_colours: Tensor,
    by_each: Tensor,
    by_of_colour: Tensor,
    by_second: Tensor,
    by_second_bias: Tensor,
    by_third: Tensor,
    by_third_bias: Tensor,
) -> None:
    """Gradients by everything from the gradient by the adapted colours."""

def diffuse(values: Tensor, across: Tensor, down: Tensor, sweeps: int, smoothed: Tensor) -> None:
    """Sweeps of exchange with the four neighbours into the given array."""

class Layers:
    """Layers of a memory, and the camera that they are layers of."""

    def __init__(
        self,
        pixels: Tensor,
        depths: Tensor,
        positions: Tensor,
        K: Tensor,
        world_to_camera: Tensor,
        width: int,
        height: int,
        reach: float,
    ) -> None: ...

def draw_layers(
    layers: Layers,
    K: Tensor,
    world_to_camera: Tensor,
    width: int,
    height: int,
    near: float,
    depth: Tensor,
) -> None:
    """Depth of what is nearest in each pixel of a view into the given array; infinite where nothing is."""

def store_harmonics(
    rest: Tensor,
    log_scales: Tensor,
    logits: Tensor,
    log_scale: float,
    opacity: float,
    harmonics: float,
    weights: Tensor,
    stored: Tensor,
) -> None:
    """View-dependent colour on the steps of each Gaussian's class, into the given array."""

class Field:
    """Places, and the grids and network that give them values."""

    def __init__(
        self,
        places: Tensor,
        grids: list[Tensor],
        hidden: Tensor,
        hidden_bias: Tensor,
        out: Tensor,
        out_bias: Tensor,
    ) -> None: ...

def evaluate_field(field: Field, features: Tensor, values: Tensor) -> None:
    """Features and values of all places into the given arrays."""

def evaluate_field_backward(
    field: Field,
    features: Tensor,
    of: Tensor,
    by_grids: list[Tensor],
    by_hidden: Tensor,
    by_hidden_bias: Tensor,
    by_out: Tensor,
    by_out_bias: Tensor,
) -> None:
    """Gradients by grids and network from the gradient by the values."""
