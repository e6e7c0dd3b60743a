"""Hard cases of partition, stitching, quantisation and the small file."""

from collections.abc import Callable

import torch
from torch import Tensor

from splatproof.reference.compression import affine_codes, container
from splatproof.reference.compression.packing import PackSettings, pack
from splatproof.reference.partition import odbp
from splatproof.reference.partition.boxes import OrientedBox, box_distance
from splatproof.reference.partition.odbp import OdbpSettings
from splatproof.reference.stitching import stochastic as stitching
from splatproof.reference.stitching.stochastic import StitchSettings, TrainedBlock
from splatproof.reference.types.gaussians import Gaussians
from splatproof.suites.hard_cases.case import HardCase, drawn, fixed, joined


def _cut(k: int, voxel: float = 1.0) -> Callable[..., Tensor]:
    """Every point has one owner, and the loads add up; the owners themselves are METIS' choice."""

    def run(points: Tensor, loads: Tensor) -> Tensor:
        found = odbp.partition(
            points.double(), loads.long(), OdbpSettings(blocks=k, voxel_size=voxel, seeds=2)
        )
        owned = (found.labels >= 0) & (found.labels < k)
        return joined(owned.sum(), found.loads.sum(), torch.tensor(float(found.worst)))

    return run


def _line(n: int) -> Tensor:
    return torch.arange(float(n))[:, None] * torch.tensor([1.0, 0, 0])


def _block(x: float, means: Tensor, scale: float = 0.1) -> TrainedBlock:
    return TrainedBlock(
        box=OrientedBox(
            centre=torch.tensor([x, 0.0, 0]).to(means),
            rotation=torch.eye(3).to(means),
            half=torch.ones(3).to(means),
        ),
        means=means,
        opacity_logits=torch.zeros(len(means)).to(means),
        log_scales=torch.full((len(means), 3), scale).to(means).log(),
    )


RIM = torch.tensor([[1.05, 0.0, 0], [1.05, 0.2, 0], [0.0, 0, 0], [1.5, 0, 0]])


def _stitch(
    sharpness: float = 30.0, gap: float = 2.0, blocks: int = 2, scale: float = 0.1, k: int = 5
) -> Callable[[Tensor], Tensor]:
    """Keep probabilities of blocks side by side that hold mirrored copies of the same points."""

    def run(means: Tensor) -> Tensor:
        mirror = torch.tensor([-1.0, 1, 1]).to(means)
        made = [_block(0.0, means, scale)]
        for i in range(1, blocks):
            made.append(
                _block(gap * i, means * mirror + torch.tensor([gap * i, 0, 0]).to(means), scale)
            )
        settings = StitchSettings(sharpness=sharpness, neighbours=k)
        return joined(*stitching.keep_probabilities(tuple(made), settings))

    return run


def _codes(values: Tensor) -> Tensor:
    return affine_codes.decode(affine_codes.encode(values))


def _model(degree: int = 1, scale: float = 0.0) -> Gaussians:
    g = torch.Generator().manual_seed(0)
    return Gaussians(
        means=torch.randn(5, 3, generator=g), quaternions=torch.randn(5, 4, generator=g),
        log_scales=torch.full((5, 3), scale), opacity_logits=torch.randn(5, generator=g),
        sh=torch.randn(5, (degree + 1) ** 2, 3, generator=g),
    )  # fmt: skip


def _file(damage: Callable[[bytes], bytes], degree: int = 1, scale: float = 0.0):
    def run(_: Tensor) -> Tensor:
        data = damage(container.encode(pack(_model(degree, scale), PackSettings())))
        opened = container.decode(data)
        return joined(opened.means, opened.rest.codes.float())

    return run


def _flipped(data: bytes) -> bytes:
    return data[:-3] + bytes([data[-3] ^ 1]) + data[-2:]


def _version(data: bytes) -> bytes:
    return data[:4] + b"\x07\x00" + data[6:]


def _bomb(data: bytes) -> bytes:
    """Claims 2^40 primitives, with a checksum that fits the claim."""
    magic, version, degree, packing, _, size, _ = container.HEADER.unpack_from(data)
    payload = data[container.HEADER.size :]
    fields = (magic, version, degree, packing, 2**40, size)
    return container.HEADER.pack(*fields, container._checksum(fields, payload)) + payload


NOTHING = fixed(torch.zeros(1))

CASES = (
    HardCase(component="partition", name="all points in one voxel",
             inputs=fixed(0.01 * torch.rand(20, 3, generator=torch.Generator().manual_seed(0)),
                          torch.ones(20)), run=_cut(2)),
    HardCase(component="partition", name="one heavy voxel",
             inputs=fixed(torch.cat([_line(10), torch.zeros(30, 3) + 0.1]), torch.ones(40)),
             run=_cut(2)),
    HardCase(component="partition", name="more blocks than points",
             inputs=fixed(_line(3), torch.ones(3)), run=_cut(5), expect="refused"),
    HardCase(component="partition", name="points on a line",
             inputs=fixed(_line(40), torch.ones(40)), run=_cut(4)),
    HardCase(component="partition", name="two far islands",
             inputs=fixed(torch.cat([_line(10), _line(10) + 1e4]), torch.ones(20)), run=_cut(2)),
    HardCase(component="partition", name="duplicate points",
             inputs=fixed(_line(5).repeat(6, 1), torch.ones(30)), run=_cut(2)),
    HardCase(component="partition", name="points that no view sees",
             inputs=fixed(_line(12), torch.zeros(12)), run=_cut(3)),
    HardCase(component="partition", name="NaN position",
             inputs=fixed(_line(3) * torch.nan, torch.ones(3)), run=_cut(1), expect="refused"),
    HardCase(component="boxes", name="zero extent", inputs=fixed(torch.tensor([1.0, 0, 1])),
             run=lambda half: box_distance(
                 OrientedBox(centre=half * 0, rotation=torch.eye(3).to(half), half=half), half[None]),
             expect="refused"),
    HardCase(component="stitching", name="no competitor", inputs=fixed(RIM),
             run=_stitch(gap=100.0)),
    HardCase(component="stitching", name="one block", inputs=fixed(RIM), run=_stitch(blocks=1)),
    HardCase(component="stitching", name="coincident competitor",
             inputs=fixed(torch.tensor([[1.03, 0.0, 0], [0.97, 0, 0]])), run=_stitch(gap=2.0)),
    HardCase(component="stitching", name="three blocks", inputs=fixed(RIM), run=_stitch(blocks=3)),
    HardCase(component="stitching", name="scales of 1e-8", inputs=fixed(RIM),
             run=_stitch(scale=1e-8), budget=1e-3),
    HardCase(component="stitching", name="K larger than a block", inputs=fixed(RIM),
             run=_stitch(k=50)),
    HardCase(component="stitching", name="eta 0", inputs=fixed(RIM), run=_stitch(sharpness=0.0)),
    HardCase(component="stitching", name="eta 1e9", inputs=fixed(RIM[1:] * 0.99),
             run=_stitch(sharpness=1e9)),
    HardCase(component="stitching", name="eta infinite", inputs=fixed(RIM),
             run=_stitch(sharpness=float("inf")), expect="refused"),
    HardCase(component="quantisation", name="r = 0", inputs=fixed(torch.full((6, 2), 0.3)),
             run=_codes),
    HardCase(component="quantisation", name="no primitive", inputs=fixed(torch.zeros(0, 3)),
             run=_codes),
    HardCase(component="quantisation", name="infinite", inputs=fixed(torch.full((2, 2), torch.inf)),
             run=_codes, expect="refused"),
    HardCase(component="quantisation", name="NaN", inputs=fixed(torch.full((2, 2), torch.nan)),
             run=_codes, expect="refused"),
    HardCase(component="quantisation", name="one outlier of 1e6",
             inputs=lambda: (torch.cat([drawn(0, (20, 1))()[0], torch.tensor([[1e6]]).double()]),),
             run=_codes),
    HardCase(component="small file", name="degree 0", inputs=NOTHING,
             run=_file(lambda data: data, degree=0)),
    HardCase(component="small file", name="half-precision overflow", inputs=NOTHING,
             run=_file(lambda data: data, scale=1e5), expect="refused"),
    HardCase(component="small file", name="truncated", inputs=NOTHING,
             run=_file(lambda data: data[:-5]), expect="refused"),
    HardCase(component="small file", name="flipped byte", inputs=NOTHING, run=_file(_flipped),
             expect="refused"),
    HardCase(component="small file", name="wrong version", inputs=NOTHING, run=_file(_version),
             expect="refused"),
    HardCase(component="small file", name="claims 2^40 primitives", inputs=NOTHING,
             run=_file(_bomb), expect="refused"),
    HardCase(component="small file", name="empty", inputs=NOTHING, run=_file(lambda _: b""),
             expect="refused"),
)  # fmt: skip
