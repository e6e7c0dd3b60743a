"""Rising difficulties of the metrics that are not of one pair of images alone."""

import math

import torch
from torch import Tensor

from splatproof.metrics import balance, depth, geometry, scoring, seam, seam_released
from splatproof.metrics.protocol_files import load_protocol
from splatproof.metrics.registry import find_metric
from splatproof.metrics.seam import SeamView
from splatproof.reference.partition.boxes import OrientedBox
from splatproof.suites.hard_cases.case import joined
from splatproof.suites.hard_cases.rising import Rising, normal, tenth, uniform
from splatproof.suites.hard_cases.rising_views import SIDE, camera, picture


def _metric(name: str):
    """The metric of a picture and one that differs by 1 / rung, in that unit."""

    def run(rung: float, image: Tensor, truth: Tensor) -> Tensor:
        close = (image - truth) / rung + truth
        return rung * torch.tensor([find_metric(name).function(close, truth, None)]).to(image)

    return run


def _contrast(rung: float, image: Tensor, truth: Tensor) -> Tensor:
    """What a picture's contrast term lacks of 1, which falls as the square of how much it differs."""
    close = (image - truth) / rung + truth
    lacks = 1 - find_metric("ssim_contrast").function(close, truth, None)
    return rung**2 * torch.tensor([lacks]).to(image)


def _seam(rung: float, image: Tensor, truth: Tensor, weights: Tensor) -> Tensor:
    """Two blocks, one of which shows ever less of the pixels, at ever larger depth."""
    shares = torch.stack([weights, weights / rung], dim=-1)
    far = rung * (1 + image[..., 0])
    found = seam.seam_scores([seam.seam_sums(SeamView(
        image=image, truth=truth, depth=far, seam=weights > 0.3, block_weights=shares,
        block_images=torch.stack([image, truth]), block_depths=torch.stack([far, far.flip(0)]),
    ))])  # fmt: skip
    return torch.tensor([value for _, value in sorted(found.values.items())]).to(image)


def _released(rung: float, image: Tensor, truth: Tensor) -> Tensor:
    """Boxes and a camera that stand so far from the origin."""
    box = OrientedBox(
        centre=torch.tensor([rung, 0, 2.0]).double(), rotation=torch.eye(3).double(),
        half=torch.full((3,), 0.4).double(),
    )  # fmt: skip
    mask = seam_released.seam_mask_released(1.5 + image[..., 0], camera(rung), [box])
    found = seam_released.seam_view_released(image, truth, 1.5 + image[..., 0], mask)
    values = [value for _, value in sorted(found.values.items())]
    return joined(mask, torch.tensor([0.0 if math.isnan(v) else v for v in values])).to(image)


def _geometry(rung: float, cloud: Tensor, truth: Tensor) -> Tensor:
    """Clouds of whole coordinates, so far from the origin, some of whose distances are the threshold."""
    del rung
    return torch.tensor(list(vars(geometry.geometry_scores(cloud, truth, 1.0)).values())).to(cloud)


def _facades(rung: float, normals: Tensor) -> Tensor:
    """Surfaces 1 / rung of a degree away from the limit."""
    turn = torch.deg2rad(70 + (torch.arange(4) - 1.5) / rung).to(normals)
    tilted = torch.stack([turn.sin(), 0 * turn, turn.cos()], dim=1)
    return geometry.vertical_faces(tilted, normals.new_tensor([0.0, 0, 1])).to(normals)


def _depths(rung: float, found: Tensor, truth: Tensor) -> Tensor:
    """Depths over so many decades, of which every third is nothing drawn."""
    wide = truth ** math.log10(rung)
    drawn = torch.where(torch.arange(SIDE) % 3 > 0, wide * found, 0)
    errors = depth.depth_errors(drawn, wide)
    scale = {"sq_rel": rung, "rmse": rung}
    return torch.tensor([v / scale.get(n, 1.0) for n, v in sorted(errors.items())]).to(found)


def _balance(rung: float, loads: Tensor) -> Tensor:
    """One block with `rung` times the load of the others."""
    heavy = loads.clone()
    heavy[0] *= rung
    return torch.tensor(balance.spread(heavy.numpy())).to(loads)


def _scored(rung: float, image: Tensor, truth: Tensor) -> Tensor:
    """A render far outside what can be shown."""
    wild = 0.5 + rung * (image - 0.5)
    made = scoring.prepare(wild, truth, load_protocol("default"))
    score = scoring.score_image("view", wild, truth, load_protocol("default"))
    return joined(made.render, torch.tensor([score.metrics["psnr"]])).to(image)


def _pair() -> tuple[Tensor, Tensor]:
    return picture(), picture(1)


CASES = (
    Rising(component="delta_e_76", name="times as alike", run=_metric("delta_e_76"), rungs=(1.0, 1e1, 1e2, 1e3),
           inputs=lambda h: _pair(), more=tenth,
           reason="differences of 1 / h of colours that are rounded to 6e-8, a hundred of which is a unit"),
    Rising(component="delta_e_2000", name="times as alike", run=_metric("delta_e_2000"),
           rungs=(1.0, 1e1, 1e2, 1e3), inputs=lambda h: _pair(), more=tenth, reason="as of delta_e_76"),
    Rising(component="gradient_l1", name="times as alike", run=_metric("gradient_l1"),
           rungs=(1.0, 1e1, 1e2, 1e3), inputs=lambda h: _pair(), more=tenth, reason="as of delta_e_76"),
    Rising(component="ssim_contrast", name="times as alike", run=_contrast,
           rungs=(1.0, 1e1, 1e2), inputs=lambda h: _pair(), more=tenth, reason="as of delta_e_76"),
    Rising(component="seam", name="times as faint, and as far", run=_seam, rungs=(1.0, 1e2, 1e4),
           inputs=lambda h: (*_pair(), uniform(SIDE, SIDE))),
    Rising(component="seam, released", name="distance from the origin", run=_released, rungs=(1.0, 1e2, 1e4),
           inputs=lambda h: _pair()),
    Rising(component="geometry", name="distance from the origin", run=_geometry,
           inputs=lambda h: ((8 * normal(40, 3)).round() + h, (8 * normal(40, 3, seed=1)).round() + h)),
    Rising(component="geometry", name="1 / degrees from the limit", run=_facades, rungs=(1.0, 1e2, 1e3),
           inputs=lambda h: (torch.zeros(1).double(),)),
    Rising(component="depth errors", name="farthest / nearest", run=_depths,
           inputs=lambda h: (0.5 + uniform(SIDE, SIDE), 1 + 9 * uniform(SIDE, SIDE, seed=1))),
    Rising(component="balance", name="heaviest / lightest", run=_balance,
           inputs=lambda h: (1 + (8 * uniform(12)).floor(),)),
    Rising(component="scoring", name="times outside what can be shown", run=_scored,
           inputs=lambda h: _pair()),
)  # fmt: skip
