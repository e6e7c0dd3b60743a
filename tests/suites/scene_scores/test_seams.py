"""Seam metrics of a case: a planted seam is seen, and only where the partition says so."""

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import pytest
import torch

from helpers.tiny_scene import camera, sparse_points
from splatproof.methods.city.block_facts import BlockFacts
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.regions import GroundRegion, OrientedRegion
from splatproof.methods.kernels.rasterizer import rasterize
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.scene_registry import SCENE_METRICS
from splatproof.metrics.seam_released import NAMES as RELEASED
from splatproof.metrics.seam_released import seam_mask_released, seam_view_released
from splatproof.reference.partition.boxes import OrientedBox, Region
from splatproof.reference.rasterizer.rasterize import Mode
from splatproof.reference.types.gaussians import Gaussians
from splatproof.reference.types.scene import Scene, View
from splatproof.suites.held_out import score_views
from splatproof.suites.scene_scores.city_scores import city_scores
from splatproof.suites.scene_scores.released_seams import boxes_of
from splatproof.suites.scene_scores.seams import block_picture, mask_picture, score_seams

PROTOCOL = replace(load_protocol("default"), rounding="float")
BOXES = tuple(
    OrientedBox(
        centre=torch.tensor([x, 0.0, 0.0], dtype=torch.float64),
        rotation=torch.eye(3, dtype=torch.float64),
        half=torch.tensor([1.5, 9.0, 9.0], dtype=torch.float64),
    )
    for x in (-1.5, 1.5)
)
BOXED = tuple(OrientedRegion(box=box) for box in BOXES)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwoBlocks:
    """A wall of Gaussians cut in two at x = 0."""

    model: Gaussians
    blocks: torch.Tensor
    distances: torch.Tensor
    regions: tuple[Region, ...] = BOXES
    mode: Mode = "classic"

    def bake(self, view: View | None = None) -> Gaussians:
        del view
        return self.model


def wall(*, step: float = 0.0, sink: float = 0.0) -> TwoBlocks:
    """A grid over |x|, |y| < 3 at z = 0; block 1 is brighter by `step`, its rim sunk by `sink`."""
    line = torch.arange(-3, 3.01, 0.15) + 0.01
    x, y = torch.meshgrid(line, line, indexing="ij")
    means = torch.stack([x.ravel(), y.ravel(), torch.zeros(x.numel())], dim=1)
    blocks = (means[:, 0] > 0).long()
    means[:, 2] += sink * blocks
    sh = torch.full((len(means), 1, 3), -0.5)
    sh[:, 0] += step / 0.28209479 * blocks[:, None]  # DC band: colour = 0.282 sh + 0.5
    model = Gaussians(
        means=means,
        quaternions=torch.tensor([[1.0, 0, 0, 0]]).repeat(len(means), 1),
        log_scales=torch.full((len(means), 3), 0.12).log(),
        opacity_logits=torch.full((len(means),), 3.0),
        sh=sh,
    )
    distances = torch.stack([box.distance(means.double()) for box in BOXES])
    own = distances[blocks, torch.arange(len(means))]
    return TwoBlocks(model=model, blocks=blocks, distances=own)


def scene(of: TwoBlocks | None = None) -> Scene:
    """Two views whose photos show the wall without a seam."""
    truth = (of or wall()).model

    def view(index: int) -> View:
        where = camera(index, width=48, height=36)
        photo = rasterize(
            where, truth.means, truth.quaternions, truth.scales, truth.opacities, sh=truth.sh
        ).colour.clamp(0, 1)
        return View(name=f"{index}.png", camera=where, load=lambda: photo)

    line = torch.linspace(-2, 2, 9).double()
    points = torch.cat([torch.cartesian_prod(line, line), torch.zeros(81, 1).double()], dim=1)
    return Scene(
        name="wall", root=None, views=(view(1), view(2), view(3)), train=(0,), test=(1, 2),
        points=sparse_points(points), up=torch.tensor([0.0, -1.0, 0.0]).double(), units="sfm",
        shift=torch.zeros(3).double(),
    )  # fmt: skip


def scores(model: TwoBlocks, folder, protocol=PROTOCOL, of: Scene | None = None):
    return score_seams(of or scene(), model, protocol, "cpu", folder)


def test_a_perfect_model_has_no_seam_but_a_seam_mask(tmp_path):
    views, whole = scores(wall(), tmp_path)
    assert whole["seam_psnr_partition"] == float("inf")
    assert 0.02 < whole["seam_coverage_partition"] < 0.5
    assert views.keys() == {"2.png", "3.png"}
    pooled = np.mean([views[name]["seam_coverage_partition"] for name in views])
    assert whole["seam_coverage_partition"] == pytest.approx(pooled)  # views of one size


def test_a_planted_step_lowers_seam_psnr_and_raises_bpd(tmp_path):
    faint, strong = (scores(wall(step=step), tmp_path)[1] for step in (0.02, 0.1))
    none = scores(wall(), tmp_path)[1]
    assert (
        none["seam_psnr_partition"]
        > faint["seam_psnr_partition"]
        > strong["seam_psnr_partition"] + 10
    )
    assert none["bpd_l1_partition"] < faint["bpd_l1_partition"] < strong["bpd_l1_partition"]
    # off by 0.1 on one side of the border and by nothing on the other, blended by Gaussians as
    # wide as the mask: a quarter of the pixels at least and all of them at most
    assert 20 < strong["seam_psnr_partition"] < -10 * np.log10(0.25 * 0.01) + 1


def test_a_planted_jump_in_depth_raises_the_gradient_jump(tmp_path):
    level, sunk = (scores(wall(sink=sink), tmp_path)[1]["nbgj_partition"] for sink in (0.0, 0.5))
    assert sunk != pytest.approx(level, rel=0.05)


def test_the_mask_is_the_partitions_whatever_the_merge_kept(tmp_path):
    model = wall()
    kept = model.distances <= 0.9  # a merge that drops more than a hard one
    part = replace(
        model,
        model=Gaussians(**{name: values[kept] for name, values in vars(model.model).items()}),
        blocks=model.blocks[kept],
        distances=model.distances[kept],
    )
    assert (
        scores(part, tmp_path)[1]["seam_coverage_partition"]
        == scores(model, tmp_path)[1]["seam_coverage_partition"]
    )
    assert scores(part, tmp_path)[1]["seam_psnr_partition"] < 30


def test_the_papers_own_mask_asks_what_the_merge_kept(tmp_path):
    hard = wall(step=0.1)
    cut = scores(hard, tmp_path)[1]
    assert cut["seam_coverage"] == 0
    assert np.isnan(cut["seam_psnr"])
    rim = hard.model.means[:, 0].abs() < 0.3
    both = replace(hard, distances=torch.where(rim, 1.05, hard.distances))
    views, kept = scores(both, tmp_path)
    assert 0.02 < kept["seam_coverage"] < 0.5
    assert 20 < kept["seam_psnr"] < 40  # half of the pixels are off by 0.1
    assert views["2.png"]["seam_coverage"] > 0
    of_partition = {name for name in kept if name.endswith("_partition")}
    assert {name.removesuffix("_partition") for name in of_partition} <= kept.keys()
    assert {name: kept[name] for name in of_partition} == {name: cut[name] for name in of_partition}


def test_pixels_off_the_mask_do_not_count(tmp_path):
    model = wall()
    far = model.model.means[:, 0].abs() > 0.8
    sh = model.model.sh + 0.5 * far[:, None, None]
    spoilt = replace(model, model=replace(model.model, sh=sh))
    assert scores(spoilt, tmp_path)[1]["seam_psnr_partition"] > 60
    near = replace(model, model=replace(model.model, sh=model.model.sh + 0.5 * ~far[:, None, None]))
    assert scores(near, tmp_path)[1]["seam_psnr_partition"] < 20  # the control


def test_one_region_is_undefined_not_perfect(tmp_path):
    views, whole = scores(replace(wall(), regions=BOXES[:1]), tmp_path)
    assert whole["seam_coverage_partition"] == 0
    assert np.isnan(whole["seam_psnr_partition"])
    assert np.isnan(views["2.png"]["bpd_l1_partition"])
    assert np.isnan(whole["seam_psnr_released"])


def test_masked_pixels_are_on_no_seam(tmp_path):
    masked = scene()
    views = tuple(
        replace(view, load_mask=lambda: torch.zeros(36, 48, dtype=torch.bool))
        for view in masked.views
    )
    masked = replace(masked, views=views)
    hidden = scores(wall(), tmp_path, of=masked)[1]
    assert hidden["seam_coverage_partition"] == 0
    assert np.isnan(hidden["seam_l1_released"])
    open_rules = replace(PROTOCOL, masked=False)
    shown = scores(wall(), tmp_path, open_rules, of=masked)[1]
    assert shown["seam_coverage_partition"] > 0
    assert shown["seam_l1_released"] < 1e-6


def test_the_releases_metrics_stand_beside_the_papers(tmp_path):
    model = wall(step=0.1)
    views, whole = scores(model, tmp_path)
    names = set(RELEASED)
    assert names <= whole.keys() <= SCENE_METRICS.keys()
    assert all(names <= view.keys() for view in views.values())
    for name in names:  # means over views, not pooled
        assert whole[name] == pytest.approx(np.mean([view[name] for view in views.values()]))
    # by hand, of one view
    view = scene().test_views[0]
    gaussians = model.model
    render = rasterize(
        view.camera, gaussians.means, gaussians.quaternions, gaussians.scales,
        gaussians.opacities, sh=gaussians.sh,
    )  # fmt: skip
    seam = seam_mask_released(render.depth, view.camera, BOXES)
    assert 0.02 < seam.double().mean() < 0.5
    want = seam_view_released(render.colour.clamp(0, 1), view.load(), render.depth, seam)
    assert {name: views["2.png"][name] for name in names} == pytest.approx(want.values)


def test_a_planted_step_is_seen_by_the_release_too(tmp_path):
    none, strong = (scores(wall(step=step), tmp_path)[1] for step in (0.0, 0.1))
    assert none["seam_l1_released"] < 1e-6 < strong["seam_l1_released"]
    assert strong["seam_psnr_released"] < 40 < none["seam_psnr_released"]
    # boxes are widened before their rims are taken, so those lie beside the border, and what is
    # sharp at the border itself is off the release's seam
    ratio = "seam_gradient_ratio_released"
    assert strong[ratio] < 0.5 * none[ratio]


def test_blocks_that_are_no_boxes_have_no_released_metrics(tmp_path):
    frame = torch.eye(3, dtype=torch.float64)
    cells = tuple(
        GroundRegion(frame=frame, corners=torch.tensor([[low, -9.0], [low + 3.0, 9.0]]).double())
        for low in (-3.0, 0.0)
    )
    assert boxes_of(cells) == boxes_of((BOXED[0], cells[1])) == ()
    assert boxes_of(BOXED) == BOXES
    views, whole = scores(replace(wall(), regions=cells), tmp_path)
    assert not set(RELEASED) & (whole.keys() | views["2.png"].keys())
    assert "seam_psnr_partition" in whole


def test_a_case_of_blocks_has_seams_and_balance_beside_its_scores(tmp_path):
    of = wall(step=0.1)
    facts = tuple(
        BlockFacts(block=b, views=2, points=8, load=16, seconds=1.0 + b, peak_mb=9.0, primitives=4)
        for b in range(2)
    )
    model = CityModel(
        model=of.model, blocks=of.blocks, distances=of.distances, regions=BOXED,
        block_facts=facts, packed=b"12345",
    )  # fmt: skip
    plain = score_views(scene(), model, PROTOCOL, tmp_path)
    line = torch.zeros(513, 3).double()
    line[:, 0] = torch.linspace(-2, 2, 513)
    rowed = replace(scene(), points=sparse_points(torch.cat([line, line + 1.0])))
    images, found = city_scores(rowed, model, PROTOCOL, plain, tmp_path)
    assert found["edge_cut"] == 2  # two rows of voxels that the wall between the blocks crosses
    unmeasured = replace(scene(), points=sparse_points(torch.zeros(0, 3).double()))
    assert "edge_cut" not in city_scores(unmeasured, model, PROTOCOL, plain, tmp_path)[1]
    assert found["seam_psnr_partition"] == scores(of, tmp_path)[1]["seam_psnr_partition"]
    assert found["seconds_max_over_mean"] == pytest.approx(2 / 1.5)
    assert found["packed_bytes"] == 5
    assert found.keys() <= SCENE_METRICS.keys()
    for before, after in zip(plain, images, strict=True):
        assert before.metrics.items() <= after.metrics.items()
        assert after.metrics["seam_coverage_partition"] > 0


def test_pictures(tmp_path):
    scores(wall(step=0.1), tmp_path)
    for kind in ("seams", "blocks"):
        picture = cv2.imread(str(tmp_path / kind / "2.png"))
        assert picture is not None
        assert picture.shape == (36, 48, 3)
    weights = torch.zeros(2, 2, 9)
    weights[0, 0, 0] = weights[1, 1, 8] = 1.0
    painted = block_picture(weights)
    assert painted[0, 0].tolist() == painted[1, 1].tolist() == [68, 119, 170]  # colours come round
    assert painted[0, 1].tolist() == [0, 0, 0]
    seam = torch.tensor([[True, False]])
    assert mask_picture(torch.full((1, 2, 3), 1.0), seam).tolist() == [[[255, 128, 128], [255] * 3]]


@pytest.mark.parametrize("mode", ["classic", "antialiased"])
def test_one_pass_over_all_blocks_sees_what_a_pass_each_sees(mode: Mode):
    """The kernels' passes against metrics' own, with more blocks than one pass has channels."""
    from splatproof.methods.kernels.blocks import block_weights, render_blocks
    from splatproof.metrics.seam_render import render_seam_view

    held = wall(step=0.1)
    blocks = torch.arange(len(held.model)) % 20
    at, truth, grey = camera(0), torch.zeros(18, 24, 3), torch.full((3,), 0.5)
    plain = partial(rasterize, mode=mode)
    one = render_seam_view(plain, at, held.model, blocks, held.distances, truth, grey)
    passes = {"render_blocks": partial(render_blocks, mode=mode),
              "block_weights": partial(block_weights, mode=mode)}  # fmt: skip
    two = render_seam_view(plain, at, held.model, blocks, held.distances, truth, grey, **passes)
    for name in ("image", "depth", "seam", "block_weights", "block_images", "block_depths"):
        assert torch.equal(getattr(one, name), getattr(two, name)), name
    many = torch.arange(len(held.model)) % 40
    wide = render_seam_view(plain, at, held.model, many, held.distances, truth, grey, **passes)
    assert wide.block_weights.shape[2] == 40
