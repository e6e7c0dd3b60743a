"""Every component with its source and its picture; `bench gallery` draws them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from splatproof.reference.types.scene import Scene
from splatproof.suites.gallery import anchoring, blocks, memory, trained


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One picture."""

    file: str
    draw: Callable[[Scene, Path], None]
    caption: str


@dataclass(frozen=True, kw_only=True)
class Component:
    """One component: where it stands, where it comes from, what it looks like."""

    title: str
    modules: tuple[str, ...]
    """Files of reference/ or metrics/, without .py."""
    source: str
    pictures: tuple[Picture, ...] = ()


COMPONENTS = (
    Component(
        title="Rasterizer",
        modules=("reference/types/camera", "reference/types/splats", "reference/rasterizer/rotation", "reference/rasterizer/spherical_harmonics",
                 "reference/rasterizer/projection", "reference/rasterizer/smoothing", "reference/rasterizer/compositing", "reference/rasterizer/rasterize",
                 "reference/rasterizer/screen_gradient", "reference/supervision/losses"),
        source="Kerbl et al. 2023, 3D Gaussian Splatting",
    ),
    Component(
        title="Partitions: ODBP and the three it is compared with",
        modules=("reference/partition/odbp", "reference/partition/voxel_graph", "reference/partition/metis", "reference/partition/boxes",
                 "reference/partition/ghosts", "reference/partition/contracted_grid", "reference/partition/camera_cells",
                 "reference/partition/density_split", "reference/partition/visibility", "reference/partition/block_time"),
        source="DPGS, Eqs. 5 to 8; CityGaussian; VastGaussian; BlockGaussian",
        pictures=(Picture(file="partitions", draw=blocks.draw_partitions,
                          caption="Blocks from above with each one's load over the mean"),),
    ),
    Component(
        title="Dense co-visibility initialisation",
        modules=("reference/supervision/dense_initialisation", "reference/supervision/dense_matching"),
        source="DPGS, Sec. 3.1, Eq. 1",
        pictures=(Picture(file="dense_points", draw=anchoring.draw_dense_points,
                          caption="A pair, the certainty of its flow, and the points that survive"),),
    ),
    Component(
        title="Side views",
        modules=("reference/supervision/spiral_path", "reference/supervision/side_views"),
        source="DPGS, Sec. 3.2, Eqs. 2 to 4",
        pictures=(Picture(file="spiral", draw=memory.draw_spiral,
                          caption="The descent from the training views to the facades"),),
    ),
    Component(
        title="Views from beside a photo, and inverse depth",
        modules=("reference/supervision/sideways_view",),
        source="BlockGaussian, its pseudo-view and depth terms",
    ),
    Component(
        title="A photo's appearance",
        modules=("reference/supervision/decoupled_appearance",),
        source="VastGaussian, Sec. 4.2, Eq. 5",
    ),
    Component(
        title="Few views",
        modules=("reference/sparse_views/unpooling", "reference/sparse_views/depth_correlation",
                 "reference/sparse_views/co_pruning", "reference/sparse_views/pseudo_views"),
        source="FSGS, Eqs. 4 and 6; CoR-GS, Eqs. 4 to 6",
    ),
    Component(
        title="Density control: relocation, errors of several views, spread of opacity gradients",
        modules=("reference/density/relocation", "reference/density/multi_view_error",
                 "reference/density/opacity_spread"),
        source="Kheradmand et al. 2024, 3DGS-MCMC; Ren et al. 2025, FastGS; MooreThreads, LiteGS",
    ),
    Component(
        title="Layered memory and sequential depth adaptation",
        modules=("reference/layered_memory/layered_depth", "reference/layered_memory/depth_adaptation",
                 "reference/layered_memory/edge_diffusion", "reference/layered_memory/guide_depth",
                 "reference/layered_memory/nadir_reference"),
        source="StratoSplat, Sec. 3.2, Eqs. 2 to 4",
        pictures=(
            Picture(file="layers", draw=memory.draw_layers,
                    caption="Layers a pixel, the nearest one, and the guide depth of another view"),
            Picture(file="adaptation", draw=memory.draw_adaptation,
                    caption="Depth of one view from its sparse points and its edges alone"),
        ),
    ),
    Component(
        title="Multi-plane Gaussians",
        modules=("reference/layered_memory/multi_plane", "reference/layered_memory/coordinate_field"),
        source="StratoSplat, Sec. 3.3",
        pictures=(Picture(file="planes", draw=memory.draw_planes,
                          caption="The plane stack, and the virtual Gaussians of one camera"),),
    ),
    Component(
        title="Anchors and the HDGS hierarchy",
        modules=("reference/anchors/scaffold", "reference/anchors/vibration", "reference/anchors/motion_hierarchy",
                 "reference/anchors/sparse_convolution", "reference/anchors/support_network",
                 "reference/anchors/control", "reference/types/mlp", "reference/types/cells"),
        source="Scaffold-GS; PVG; HDGS, Sec. 3.2, 3.3 and 3.5, Eqs. 1 to 8",
        pictures=(
            Picture(file="hierarchy", draw=anchoring.draw_hierarchy,
                    caption="Two anchors' Gaussians in motion, and their life"),
            Picture(file="support", draw=anchoring.draw_support,
                    caption="Neighbours on the sparse grid, and alignment with the principal axis"),
        ),
    ),
    Component(
        title="Depth supervision",
        modules=("reference/supervision/soft_rank", "reference/supervision/depth_supervision",
                 "reference/supervision/depth_constraint"),
        source="HDGS, Sec. 3.4, Eqs. 9 to 13; DLG-GS, Sec. 2.2, Eqs. 1 to 5",
    ),
    Component(
        title="Lighting-adaptive appearance",
        modules=("reference/anchors/hvi", "reference/anchors/attention", "reference/anchors/lighting_appearance",
                 "reference/types/nearest_view"),
        source="DLG-GS, Sec. 2.3, Eqs. 6 to 19",
        pictures=(Picture(file="attention", draw=anchoring.draw_attention,
                          caption="Whom three anchors attend to, and how strongly"),),
    ),
    Component(
        title="Stitching, view sampling and the small file",
        modules=("reference/stitching/stochastic", "reference/partition/view_sampling", "reference/stitching/preclean",
                 "reference/compression/spectral", "reference/compression/affine_codes", "reference/compression/packing",
                 "reference/compression/container"),
        source="StitchGS, Sec. 3 and 4",
        pictures=(
            Picture(file="stitching", draw=blocks.draw_stitching,
                    caption="Zones of the blocks, primitives kept and dropped"),
            Picture(file="sampling", draw=blocks.draw_sampling,
                    caption="Views by azimuth and distance, and how often each is drawn"),
            Picture(file="spectrum", draw=trained.draw_spectral_energy,
                    caption="Spectral energy of a short run's Gaussians, and what the gate drops"),
        ),
    ),
    Component(
        title="The small file: codes and their coder",
        modules=("reference/compression/quantisers", "reference/compression/gaps", "reference/compression/columns",
                 "reference/compression/harmonics", "reference/compression/mixing", "reference/compression/logistic",
                 "reference/compression/range_coder", "reference/compression/merging"),
        source="ours; context mixing: Mahoney 2005; merging: Runnalls 2007; what it costs is in size.md",
    ),
    Component(
        title="Metrics",
        modules=("metrics/ssim", "metrics/ldr_flip", "metrics/colour_difference", "metrics/gradient",
                 "metrics/seam", "metrics/seam_released", "metrics/geometry", "metrics/depth",
                 "metrics/balance", "metrics/scoring"),
        source="spec of each in its docstring; StitchGS, Sec. 5 for the seam family",
        pictures=(Picture(file="seams", draw=trained.draw_seams,
                          caption="A render, its blocks, the seam mask over it, and its error"),),
    ),
)  # fmt: skip


def draw(scene: Scene, folder: Path, report: Callable[[str], None]) -> list[Path]:
    """Draw every picture into a folder; `report` hears each file as it is done.

    Args:
        scene: Scene that the pictures are made of.
        folder: Folder of the pictures.
        report: Called with the name of each file as it is done.
    """
    files = []
    for component in COMPONENTS:
        for picture in component.pictures:
            path = folder / f"{picture.file}.png"
            picture.draw(scene, path)
            files.append(path)
            report(path.name)
    return files


def page(images: str) -> str:
    """Markdown page of all components.

    Args:
        images: Address of the pictures' folder as seen from the page.
    """
    lines = [
        "# Components",
        "",
        "Made by `bench gallery docs/images/components --page docs/components.md`.",
        "",
    ]
    for component in COMPONENTS:
        lines += [f"## {component.title}", "", f"Source: {component.source}.", ""]
        lines += [
            f"- [`{module}.py`](../{module}.py): {summary(module)}" for module in component.modules
        ]
        lines += [""]
        for picture in component.pictures:
            lines += [
                f"![{picture.caption}]({images}/{picture.file}.png)",
                "",
                f"{picture.caption}.",
                "",
            ]
    return "\n".join(lines).rstrip() + "\n"


def summary(module: str) -> str:
    """First line of a module's docstring."""
    root = Path(__file__).resolve().parents[1]
    text = (root.parent / f"{module}.py").read_text(encoding="utf-8")
    return text.split('"""')[1].splitlines()[0]
