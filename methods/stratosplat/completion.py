"""The dense cloud that explicit Gaussians start from: depths of few photos, completed one after another."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from torch import Tensor

from splatproof.base.errors import DataError
from splatproof.datasets.resize import resample, scale_intrinsics
from splatproof.datasets.truth_image import shrink_mask
from splatproof.methods.kernels import guide_depth
from splatproof.methods.priors.network import COMPLETION, DepthNetwork, load_network, said_of
from splatproof.methods.stratosplat.denoiser import PhotoDiffusion
from splatproof.methods.stratosplat.prior_depth import believed, relative_depth
from splatproof.methods.stratosplat.settings import Completion
from splatproof.reference.layered_memory import depth_adaptation, layered_depth
from splatproof.reference.layered_memory.depth_adaptation import (
    AdaptationSettings,
    SparseDepths,
    adapt_view,
    depth_unit,
    depths_of,
    sparse_depths,
)
from splatproof.reference.layered_memory.layered_depth import LayeredDepth
from splatproof.reference.layered_memory.nadir_reference import nadir_reference
from splatproof.reference.supervision.dense_initialisation import observations, points_of
from splatproof.reference.supervision.side_views import inside_image, unproject
from splatproof.reference.types.camera import Camera, project_points
from splatproof.reference.types.scene import Scene, View

MARGIN = 1.25
"""The memory's reference camera holds frusta from the nearest sparse point's depth over this to the
farthest one's times this: completed depths go beyond the points."""
TRIMMED, BEYOND = 0.01, 4.0
"""A point guides no depth that lies so many times beyond all but this share of those that a view sees with it (at least
one of three). A wrong one would, through the memory, and stretch the memory's camera without end."""
ALL_KEPT = 1e-12
"""eps_d of a memory that merges nothing but equal samples, in place of the setting `merge`."""
MOST_KEPT = 1_000_000
"""Layers a pixel of such a memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DenseCloud:
    """What completion leaves: P_dense, and what it cost the memory."""

    positions: Float[Tensor, "n 3"]
    """Float64, scene units."""
    colours: Float[Tensor, "n 3"]
    """sRGB in [0, 1]."""
    unseen: int
    """Samples that the memory's reference camera did not see and that are lost."""
    forced: int
    """Merges that were only made to keep the cap on the layers of a pixel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Photo:
    """A training view at the size at which it is completed."""

    name: str
    camera: Camera
    image: Float[Tensor, "h w 3"]
    sparse: SparseDepths
    prior: Float[Tensor, "h w"] | None
    """Depth in (0, 1) of the view's prior or of our network; None: there is neither."""
    counted: Bool[Tensor, "h w"]
    """Pixels that no mask hides; what is hidden is not of the scene."""


def completed(
    scene: Scene,
    settings: Completion,
    *,
    guided: bool,
    generator: torch.Generator,
    report: Callable[[str], None],
) -> DenseCloud:
    """Complete the depth of every training view and merge them all, but for what masks hide.

    A view without points waits until a completed one overlaps it. One that none ever does, or any where
    none guides, is not completed, which is ours: the paper's views all overlap, and photos spread over a
    whole flight do not. It is trained on like the others, from what the others show and from virtual Gaussians.

    Args:
        scene: With sparse points and training views, which may have depth priors.
        settings: Memory, order, size and guidance.
        guided: Whether the memory of earlier views guides the next (layered), or none does
            (independent).
        generator: Source of the denoiser's noise and of a random order.
        report: Told one line about what is odd.

    Raises: DataError if no view shows a sparse point, and where the network's weights are missing or damaged.

    Source: StratoSplat, Sec. 3.2.
    """
    kept = guiding(scene)
    network = load_network(COMPLETION) if settings.prior == "own" else None
    photos = [_photo(view, points, settings.side, network) for view, points in _seen(scene, kept)]
    memory = _start(scene, kept, photos, settings)
    ranks = _order(photos, memory, settings, generator)
    asked = AdaptationSettings(
        visible_weight=settings.visible_weight, guidance_steps=settings.guidance_steps
    )
    left, doubted = [photos[index] for index in ranks], 0
    while left:
        later: list[Photo] = []
        for photo in left:
            nothing = torch.zeros(photo.image.shape[:2], dtype=torch.float64)
            guide, visible = nothing, nothing.bool()
            if guided:
                guide, visible = guide_depth.render(memory, photo.camera)
            if not len(photo.sparse.depths) and not bool(visible.any()):
                later.append(photo)  # one that is completed after it may reach it
                continue
            prior, steps = _believed(photo, guide, visible, asked)
            doubted += photo.prior is not None and prior is None
            depth = adapt_view(
                PhotoDiffusion(photo.image, prior), photo.image, photo.sparse, guide, visible,
                steps, generator,
            )  # fmt: skip
            shown = (photo.counted & (depth > photo.camera.near)).reshape(-1)
            memory = layered_depth.insert(
                memory, unproject(photo.camera, depth)[shown], photo.image.reshape(-1, 3)[shown]
            )
        if len(later) == len(left):
            report(_alone(later, guided=guided))
            break
        left = later
    if doubted:
        report(
            f"completion: the depth priors of {doubted} of {len(photos)} photos contradict what is known there "
            "and are left out"
        )
    if memory.unseen:
        report(f"layered memory: {memory.unseen} samples lie outside its camera and are left out")
    if memory.forced:
        report(f"layered memory: {memory.forced} merges were forced by the cap on layers")
    if not bool(kept.all()):
        report(
            f"completion: {int((~kept).sum())} points lie far beyond all others and guide no depth"
        )
    lone, tints = scene.points.positions[~kept], scene.points.colours[~kept]
    return DenseCloud(
        positions=torch.cat([memory.positions, lone.to(memory.positions)]),
        colours=torch.cat([memory.colours, tints.to(memory.colours) / 255]),
        unseen=memory.unseen, forced=memory.forced,
    )  # fmt: skip


def _believed(
    photo: Photo,
    guide: Float[Tensor, "h w"],
    visible: Bool[Tensor, "h w"],
    settings: AdaptationSettings,
) -> tuple[Float[Tensor, "h w"] | None, AdaptationSettings]:
    """The photo's prior as far as its points, or without any the memory, bear it out, and how guidance steps."""
    if photo.prior is None:
        return None, settings
    known = photo.sparse if len(photo.sparse.depths) else depths_of(guide, visible)
    unit = depth_unit(photo.sparse, guide, visible)
    return believed(photo.prior, known, unit, settings)


def _alone(photos: list[Photo], *, guided: bool) -> str:
    """What is told of views that nothing brings to the scene's scale."""
    names = ", ".join(sorted(photo.name for photo in photos))
    if not guided:
        return (
            "left out of the completion, for they show no point, and init = 'independent' completes "
            f"a photo by its own points alone: {names}; init = 'layered' would use what other "
            "photos show of them"
        )
    return (
        f"left out of the completion, for they show no point and overlap no completed view, so nothing "
        f"says how far away what they show is: {names}; --points triangulated, or photos between them "
        "and the others, may help"
    )


def guiding(scene: Scene) -> Bool[Tensor, " n"]:
    """Which points guide depths: those that are plausible in each training view that sees them.

    Args:
        scene: With sparse points.

    Source: ours.
    """
    positions = scene.points.positions
    kept = torch.ones(len(positions), dtype=torch.bool)
    for view, rows in _rows(scene):
        at, z = project_points(view.camera, positions[rows])
        inside = inside_image(view.camera, at) & (z > view.camera.near)
        kept[rows[inside][~plausible(z[inside])]] = False
    return kept


def plausible(depths: Float[Tensor, " n"]) -> Bool[Tensor, " n"]:
    """Which depths do not lie far beyond the others, nearer or farther (TRIMMED, BEYOND); of two nobody knows which.

    Args:
        depths: Positive numbers.
    """
    if len(depths) < 3:
        return torch.ones_like(depths, dtype=torch.bool)
    known = depths.sort().values
    cut = max(1, int(TRIMMED * len(known)))
    return (BEYOND * depths >= known[cut]) & (depths <= BEYOND * known[-1 - cut])


def _rows(scene: Scene) -> list[tuple[View, Int[Tensor, " m"]]]:
    """Each training view with the points in its track; with all points where there are no tracks."""
    seen: csr_array = observations(scene.points, len(scene.views))
    every = torch.arange(len(scene.points))
    return [(scene.views[i], points_of(seen, i) if seen.nnz else every) for i in scene.train]


def _seen(scene: Scene, kept: Bool[Tensor, " n"]) -> list[tuple[View, Float[Tensor, "m 3"]]]:
    positions = scene.points.positions
    return [(view, positions[rows[kept[rows]]]) for view, rows in _rows(scene)]


def _photo(
    view: View, points: Float[Tensor, "m 3"], side: int, network: DepthNetwork | None
) -> Photo:
    """A view made so small that its longer side has at most `side` pixels."""
    camera = view.camera
    share = min(1.0, side / max(camera.width, camera.height))
    size = (max(1, round(share * camera.width)), max(1, round(share * camera.height)))
    small = replace(
        camera, K=scale_intrinsics(camera.K, (camera.width, camera.height), size), width=size[0],
        height=size[1],
    )  # fmt: skip
    sparse = sparse_depths(small, points)
    said = None if view.load_prior is None else view.load_prior()
    if network is not None:
        said = said_of(network, view, points)
    prior = None if said is None else relative_depth(said, sparse, (size[1], size[0]))
    counted = torch.ones(size[1], size[0], dtype=torch.bool)
    if view.load_mask is not None:
        counted = shrink_mask(view.load_mask(), size, "area")
    # float32: what the kernel of PhotoDiffusion takes
    return Photo(
        name=view.name, camera=small, image=resample(view.load(), size, "area"), sparse=sparse,
        prior=prior, counted=counted,
    )  # fmt: skip


def _start(
    scene: Scene, kept: Bool[Tensor, " n"], photos: list[Photo], settings: Completion
) -> LayeredDepth:
    """The memory that holds the sparse points that guide, seen from above all frusta."""
    points, colours = scene.points.positions[kept], scene.points.colours[kept]
    ranges = [
        (float(p.sparse.depths.min()) / MARGIN, float(p.sparse.depths.max()) * MARGIN)
        for p in photos
        if len(p.sparse.depths)
    ]
    if not ranges:
        raise DataError(
            f"scene {scene.name!r}: no training view shows a sparse point, so nothing says how far "
            "away anything is; make points with --points triangulated, take photos that overlap, or "
            "take init = 'sfm', which starts from points drawn at random"
        )
    whole = (min(low for low, _ in ranges), max(high for _, high in ranges))
    pairs = [
        (float(p.sparse.depths.min()) / MARGIN, float(p.sparse.depths.max()) * MARGIN)
        if len(p.sparse.depths)
        else whole
        for p in photos
    ]
    camera = nadir_reference([p.camera for p in photos], pairs, scene.up)
    farthest = float((points - camera.centre).norm(dim=1).max())
    keeps = settings.memory == "accumulate"
    memory = layered_depth.empty(
        camera, (ALL_KEPT if keeps else settings.merge) * farthest,
        MOST_KEPT if keeps else 8,
    )  # fmt: skip
    return layered_depth.insert(memory, points, colours.double() / 255)


def _order(
    photos: list[Photo], memory: LayeredDepth, settings: Completion, generator: torch.Generator
) -> list[int]:
    """Indices of the views, first to last."""
    if settings.order == "random":
        return depth_adaptation.order_at_random(len(photos), generator)
    if settings.order == "distance":
        centres = torch.stack([p.camera.centre for p in photos])
        return depth_adaptation.order_by_distance(centres, memory.camera.centre)
    counts = torch.tensor([len(p.sparse.depths) for p in photos])
    return torch.sort(counts, descending=True, stable=True).indices.tolist()
