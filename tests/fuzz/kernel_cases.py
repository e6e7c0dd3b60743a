"""Calls of the native layer with what nobody should give it, drawn at random."""

import random
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from splatproof import _ext
from splatproof.methods.hdgs.networks import drawn, hierarchy
from splatproof.methods.kernels import adam
from splatproof.methods.kernels import hierarchy as native_hierarchy
from splatproof.methods.kernels import support as native_support
from splatproof.methods.kernels.blocks import block_weights, render_blocks
from splatproof.methods.kernels.loss import photometric
from splatproof.methods.kernels.rasterizer import native_camera, rasterize
from splatproof.methods.kernels.step import ViewGradients, observe
from splatproof.reference.anchors.motion_hierarchy import HierarchySettings, MotionAnchors
from splatproof.reference.anchors.support_network import create
from splatproof.reference.compression.logistic import squash, stretch
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.gaussians import Gaussians

ODD = (0.0, -0.0, 1e-45, -1e-30, 1e-8, 1.0, -1.0, 88.0, -104.0, 1e10, -1e20, 3e38, -3e38,
       float("inf"), float("-inf"), float("nan"))  # fmt: skip
DTYPES = (torch.float64, torch.float16, torch.int64, torch.bool)
COUNTS = (0, 1, 2, 15, 16, 17, 31, 33, 100, 300, 700)


def numbers(draw: random.Random, *shape: int, spoil: bool = True) -> Tensor:
    """Mostly ordinary numbers, sometimes with some or only odd ones between them."""
    g = torch.Generator().manual_seed(draw.getrandbits(31))
    values = torch.randn(shape, generator=g) * 10.0 ** draw.randint(-3, 2)
    share = draw.choice((0, 0, 0.02, 0.3, 1)) if spoil else 0
    odd = torch.tensor(ODD)[torch.randint(len(ODD), shape, generator=g)]
    return torch.where(torch.rand(shape, generator=g) < share, odd, values)


def spoiled(draw: random.Random, tensor: Tensor) -> Tensor:
    """Rarely of another dtype, shape or layout, with the same numbers where that is possible."""
    kind = draw.randrange(120)
    if kind == 0:
        return tensor.to(draw.choice(DTYPES))
    if kind == 1 and tensor.ndim:
        return tensor[: len(tensor) // 2]
    if kind == 2 and tensor.ndim:
        return torch.cat([tensor, tensor])
    if kind == 3:
        return tensor[..., None].expand(*tensor.shape, 2)[..., 0]  # strides of their own
    if kind == 4 and tensor.ndim > 1:
        return tensor.transpose(0, 1)
    if kind == 5 and tensor.ndim > 1:
        return tensor.transpose(0, 1).contiguous().transpose(0, 1)
    if kind == 6:
        return tensor.reshape(-1)
    if kind == 7:
        return torch.empty(0)
    return tensor


def camera(draw: random.Random) -> Camera:
    """Of any size from one pixel on; sometimes no camera at all."""
    width, height = draw.randint(1, 90), draw.randint(1, 70)
    focal = draw.choice((0.5, 1.0, 1.0, 10.0, 1e-6, 1e6, 0.0, float("nan"))) * width
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    pose = torch.eye(4)
    if draw.random() < 0.1:
        pose = numbers(draw, 4, 4)
    elif draw.random() < 0.7:
        pose[2, 3] = draw.choice((3.0, 300.0, 0.0, 1e30))
    return Camera(
        K=K.double(), world_to_camera=pose.double(), width=width, height=height,
        near=draw.choice((0.01, 0.01, 0.0, -1.0, 1e30, float("nan"))),
    )  # fmt: skip


def background(draw: random.Random, channels: int = 3) -> Tensor | None:
    return None if draw.random() < 0.4 else spoiled(draw, numbers(draw, channels))


def model(draw: random.Random) -> dict[str, Tensor]:
    n, k = draw.choice(COUNTS), draw.choice((1, 4, 9, 16))
    return {
        "means": numbers(draw, n, 3), "quaternions": numbers(draw, n, 4),
        "scales": numbers(draw, n, 3), "opacities": numbers(draw, n).abs(),
        "sh": numbers(draw, n, k, 3),
    }  # fmt: skip


def draw_and_differentiate(draw: random.Random) -> None:
    parts: dict[str, Any] = {name: spoiled(draw, value) for name, value in model(draw).items()}
    if draw.random() < 0.3:
        channels = draw.choice((0, 1, 2, 3, 5, 16, 31, 32, 33))
        parts["colours"] = spoiled(draw, numbers(draw, len(parts["means"]), channels))
        del parts["sh"]
    for value in parts.values():
        if value.is_floating_point():
            value.requires_grad_()
    out = rasterize(
        camera(draw), **parts, background=background(draw, draw.choice((3, 3, 1))),
        mode=draw.choice(("classic", "antialiased")), distance=draw.random() < 0.3,
        median=draw.random() < 0.3, contributors=draw.choice((0, 0, 1, 5)),
    )  # fmt: skip
    if out.colour.requires_grad:
        total = (out.colour * numbers(draw, *out.colour.shape)).sum() + out.alpha.sum()
        for picture in (out.depth, out.distance, out.median_depth):
            if picture is not None and draw.random() < 0.5:
                total = total + (picture * numbers(draw, *picture.shape)).sum()
        total.backward()


def step(draw: random.Random) -> None:
    values, view = model(draw), camera(draw)
    parameters = {
        "means": values["means"], "quaternions": values["quaternions"], "log_scales": values["scales"],
        "opacity_logits": values["opacities"], "sh_dc": values["sh"][:, :1].contiguous(),
        "sh_rest": values["sh"][:, 1:].contiguous(),
    }  # fmt: skip
    own = ViewGradients()
    for _ in range(draw.choice((1, 2))):
        truth = spoiled(draw, numbers(draw, view.height, view.width, 3))
        own.of(
            view, {name: spoiled(draw, value) for name, value in parameters.items()}, truth,
            degree=draw.choice((-1, 0, 0, 0, 1, 2, 3, 4)), background=background(draw),
            mask=spoiled(draw, numbers(draw, view.height, view.width) > 0),
            dssim=draw.choice((0.0, 0.2, 1.0, float("nan"))),
        )  # fmt: skip


def blocks(draw: random.Random) -> None:
    values, count = model(draw), draw.choice((0, 1, 2, 7, 40))
    gaussians = Gaussians(
        means=values["means"], quaternions=values["quaternions"], log_scales=values["scales"],
        opacity_logits=values["opacities"], sh=values["sh"],
    )  # fmt: skip
    highest = count + (draw.random() < 0.2)
    chosen = [draw.randrange(max(highest, 1)) for _ in range(len(gaussians))]
    ids = torch.tensor(chosen, dtype=torch.int64) - (draw.random() < 0.1)
    ids = spoiled(draw, ids)
    render_blocks(camera(draw), gaussians, ids, count, background=background(draw))
    block_weights(camera(draw), gaussians, ids, count)


def loss(draw: random.Random) -> None:
    shape = (draw.randint(0, 40), draw.randint(0, 40), draw.choice((0, 1, 2, 3, 4, 17)))
    image = spoiled(draw, numbers(draw, *shape))
    if image.is_floating_point():
        image.requires_grad_()
    mask = None if draw.random() < 0.5 else spoiled(draw, numbers(draw, *shape[:2]) > 0)
    value = photometric(image, spoiled(draw, numbers(draw, *shape)), mask=mask)
    value.backward()


def update(draw: random.Random) -> None:
    n = draw.choice(COUNTS)
    shapes = [(n, 3), (n,), (n, 15, 3), (n, 0, 3)][: draw.randint(0, 4)]
    groups = [[spoiled(draw, numbers(draw, *shape)) for shape in shapes] for _ in range(4)]
    rows = None if draw.random() < 0.5 else spoiled(draw, numbers(draw, n) > 0)
    adam.step(*groups, rates=[0.01] * len(shapes), number=draw.choice((1, 2, 10**6)), rows=rows)


def statistics(draw: random.Random) -> None:
    n = draw.choice(COUNTS)
    observe(
        spoiled(draw, numbers(draw, n, 2)), spoiled(draw, numbers(draw, n)), camera(draw),
        spoiled(draw, numbers(draw, n)), spoiled(draw, numbers(draw, n)),
    )  # fmt: skip


def bare(draw: random.Random) -> None:
    """The bindings themselves, without the wrappers' checks."""
    values, view = model(draw), camera(draw)
    n, k = values["sh"].shape[:2]
    lit = draw.choice(
        (n, n, n, n // 2, 0, n + 1)
    )  # harmonics of so many, and colours of the others
    plain = max(n - lit, 0)
    colours = (
        numbers(draw, plain, draw.choice((3, 3, 3, 2))) if plain or draw.random() < 0.1 else None
    )
    rest = numbers(draw, lit, draw.choice((0, 3, 8, 15))) if draw.random() < 0.3 else None
    means, quaternions, scales, opacities = (
        spoiled(draw, values[name]) for name in ("means", "quaternions", "scales", "opacities")
    )
    made = _ext.Model(
        means, quaternions, scales, opacities,
        None if colours is None else spoiled(draw, colours), spoiled(draw, values["sh"][:lit]),
        draw.choice((k, k, 0, -1, 16, 17)), draw.random() < 0.5, draw.random() < 0.5, rest,
    )  # fmt: skip
    height, width = view.height, view.width
    pictures = [
        torch.empty(height, width, 3),
        torch.empty(height, width),
        torch.empty(height, width),
    ]
    radii = torch.empty(n)
    if draw.random() < 0.5:
        ids = torch.empty(height, width, 2, dtype=torch.int64)
        weights = torch.empty(height, width, draw.choice((2, 2, 3)))
    else:
        ids = weights = None
    (colour, alpha, depth), radii = [spoiled(draw, p) for p in pictures], spoiled(draw, radii)
    state = _ext.render(
        made,
        *native_camera(view),
        background(draw),
        colour,
        alpha,
        depth,
        radii,
        None,
        None,
        None,
        ids,
        weights,
    )
    gradients = [
        torch.empty(n, 3), torch.empty(n, 4), torch.empty(n, 3), torch.empty(n),
        None if colours is None else torch.empty_like(colours), torch.empty(min(lit, n), k, 3),
        torch.empty(n, 2), draw.choice((None, torch.empty(n, 2))), draw.choice((None, torch.empty(n, 3))),
    ]  # fmt: skip
    given = [None if g is None else spoiled(draw, g) for g in gradients]
    pull = spoiled(draw, numbers(draw, height, width, 3))
    _ext.render_backward(
        state, made, background(draw), alpha, depth, None, pull, None, None, None, None,
        *given,
    )  # fmt: skip


def huge(draw: random.Random) -> None:
    """More than memory holds, claimed by arrays that repeat one row: refused without a copy."""
    n = draw.choice((2**31, 2**33, 2**40))
    one = torch.zeros(1)
    _ext.Model(
        one[:, None].expand(n, 3), one[:, None].expand(n, 4), one[:, None].expand(n, 3),
        one.expand(n), None, one[:, None, None].expand(n, 1, 3), 1, False, False,
    )  # fmt: skip


def flood(draw: random.Random) -> None:
    """Gaussians that each cover the whole image, and bands of one pair."""
    values: dict[str, Any] = {**model(draw)}
    values["scales"] = values["scales"] * 0 + 10.0 ** draw.randint(-2, 8)
    values["means"][:, 2] = 1
    _ext.set_backward_rows(draw.choice((0, 1, 50)))
    try:
        for value in values.values():
            value.requires_grad_()
        rasterize(camera(draw), **values).colour.sum().backward()
    finally:
        _ext.set_backward_rows(2**22)


def codes(draw: random.Random) -> None:
    """Coders of codes: what they wrote comes back, and no stream, shape or index ends the process."""
    n, g = draw.choice(COUNTS), torch.Generator().manual_seed(draw.getrandbits(31))

    def whole(*shape: int, low: int = 0, high: int = 8) -> Tensor:
        return spoiled(draw, torch.randint(low, high, shape, generator=g, dtype=torch.int32))

    tables = _ext.CodecTables(*(torch.from_numpy(table) for table in (stretch(), squash())))
    cells, near = whole(n, 3, high=2**21), torch.empty(n, 3, dtype=torch.int32)
    _ext.nearest_before(cells, draw.choice((-1, 0, 1, 128)), near)
    places = torch.empty(n, dtype=torch.int64)
    _ext.morton_of_cells(cells, places)
    places = places.sort().values if draw.random() < 0.9 else places
    classes, side, bits = whole(n, high=7), whole(n, high=99), whole(3, low=3, high=14)
    near = near if draw.random() < 0.9 else whole(n, 3, low=-3, high=n + 3)
    small, colours = whole(3, n), whole(draw.choice((0, 9, 10)), n, low=-20, high=20)
    streams = [
        _ext.encode_gaps(tables, places), _ext.encode_columns(tables, small, bits, near, side),
        _ext.encode_harmonics(tables, colours, near, classes),
    ]  # fmt: skip
    streams.append(draw.randbytes(draw.randrange(200)))
    streams.append(draw.choice(streams)[: draw.randrange(200)])
    _ext.decode_gaps(tables, draw.choice(streams), torch.zeros_like(places))
    _ext.decode_columns(tables, draw.choice(streams), bits, near, side, torch.zeros_like(small))
    back = torch.zeros_like(colours)
    _ext.decode_harmonics(tables, draw.choice(streams), near, classes, back)
    sh = torch.empty(n, len(colours) // 3, 3)
    opponent = numbers(draw, 3, 3).double()
    _ext.restore_harmonics(back, classes, draw.choice((0.1, float("nan"))), opponent, sh)


def attention(draw: random.Random) -> None:
    """Lists that may be wrong, of anchors of which some take part."""
    n, width, out = draw.choice(COUNTS), draw.choice((1, 7, 16, 28, 33)), draw.choice((1, 16, 40))
    g = torch.Generator().manual_seed(draw.getrandbits(31))
    lengths = torch.randint(draw.choice((1, 5, 40)), (n,), generator=g)
    targets = torch.randint(max(n, 1), (int(lengths.sum()),), generator=g)
    starts = lengths.cumsum(0) - lengths
    if draw.random() < 0.1 and len(targets):
        targets[draw.randrange(len(targets))] = draw.choice((-1, n, 2**40))
    if draw.random() < 0.1 and n:
        starts[draw.randrange(n)] = draw.choice((-1, 3, 2**40))
    near = _ext.NearLists(spoiled(draw, starts), spoiled(draw, targets))
    rows = torch.randperm(n, generator=g)[: draw.choice((0, 1, n))].sort().values
    if draw.random() < 0.1 and len(rows):
        rows[draw.randrange(len(rows))] = draw.choice((-1, 0, n, 2**40))
    query, key, value = (spoiled(draw, numbers(draw, len(rows), c)) for c in (width, width, out))
    centres = draw.choice((None, spoiled(draw, numbers(draw, n, 3))))
    radius = draw.choice((0.0, 1.0, float("inf"), float("nan"), -1.0))
    state = _ext.Attended(near, query, key, value, spoiled(draw, rows), centres, radius)
    del near
    _ext.attend(state, spoiled(draw, torch.empty(len(rows), out)))
    made = [spoiled(draw, torch.empty(len(rows), c)) for c in (width, width, out)]
    _ext.attend_backward(state, spoiled(draw, numbers(draw, len(rows), out)), *made)


def moving_anchors(draw: random.Random) -> None:
    """A hierarchy of any sizes, some of whose tensors do not fit the others."""
    n, k, layers = draw.choice(COUNTS), draw.randint(1, 3), draw.randint(2, 5)
    sizes = HierarchySettings(
        layers=layers, children=k, gaussians=draw.randint(1, 3) * k ** (layers - 2),
        features=draw.choice((0, 1, 5, 16, 33)), instance=draw.choice((0, 1, 8)),
        period=draw.choice((1.0, 1.0, 1e-30, 0.0, float("nan"))),
    )  # fmt: skip
    part = lambda *shape: spoiled(draw, numbers(draw, n, *shape))
    counts = [k**layer for layer in range(1, layers - 1)] + [sizes.gaussians]
    anchors = MotionAnchors(
        centres=part(3), features=part(sizes.features), instances=part(sizes.instance),
        quaternions=torch.zeros(n, 4), log_scales=part(3), peaks=part(), velocities=part(3),
        log_spans=part(), offsets=tuple(part(count, 3) for count in counts),
    )  # fmt: skip
    shared = {
        name: spoiled(draw, value)
        for name, value in drawn(sizes, draw.getrandbits(20), ice=False).items()
    }
    for value in (*shared.values(), *anchors.offsets, anchors.features, anchors.peaks):
        if value.is_floating_point() and draw.random() < 0.8:
            value.requires_grad_()
    index = None
    if draw.random() < 0.6:
        index = spoiled(
            draw, torch.tensor([i for i in range(n + 1) if draw.random() < 0.5][-n:]).long()
        )
    networks, time = hierarchy(shared, layers), draw.choice(ODD)
    if index is None or draw.random() < 0.5:
        pyramid = native_hierarchy.Pyramid(
            pose=spoiled(draw, numbers(draw, 3, 4)), near=draw.choice(ODD),
            sides=spoiled(draw, numbers(draw, 4, 3)), sigmas=draw.choice(ODD),
            blur=draw.choice(ODD),
        )  # fmt: skip
        count = n if index is None else len(index)
        drift = None if draw.random() < 0.5 else spoiled(draw, numbers(draw, count, 3))
        native_hierarchy.visible(anchors, networks, sizes, time, pyramid, index=index, drift=drift)
    splats = native_hierarchy.decode(anchors, networks, sizes, time, numbers(draw, 3), index=index)
    if splats.means.requires_grad:
        (splats.means.sum() + splats.scales.sum()).backward()


def support(draw: random.Random) -> None:
    """Sites and pairs of which some do not exist."""
    n, c = draw.choice(COUNTS), draw.choice((1, 5, 16, 33))
    network = create(c, torch.Generator().manual_seed(draw.getrandbits(20)), torch.float32)
    parts = [spoiled(draw, numbers(draw, n, width)) for width in (c, 3, 4, 3)]
    seen = [i for i in range(n) if draw.random() < 0.7]
    count = draw.choice((0, 1, 40, 900)) if seen else 0
    receives = torch.tensor([draw.choice(seen) for _ in range(count)], dtype=torch.int64)
    gives = torch.tensor(
        [draw.randrange(n + (draw.random() < 0.001)) for _ in range(count)], dtype=torch.int64
    )
    ends = sorted(draw.randint(0, count) for _ in range(26)) + [count + (draw.random() < 0.05)]
    for i in (0, 2, 3):
        if parts[i].is_floating_point():
            parts[i].requires_grad_()
    out = native_support.support(
        network, parts[0], parts[1], parts[2], parts[3],
        (spoiled(draw, receives), spoiled(draw, gives), ends),
        spoiled(draw, torch.tensor(seen, dtype=torch.int64)),
        modulated=draw.random() < 0.7, gated=draw.random() < 0.7,
    )  # fmt: skip
    if out.requires_grad:
        out.sum().backward()


def stored(draw: random.Random) -> None:
    """Harmonics on steps of classes that scales and opacities of any size decide."""
    n, count = draw.choice(COUNTS), draw.choice((0, 1, 15, 16, 17))
    weights = torch.tensor([draw.choice((0, -3, 2**26, -(2**63), 2**63 - 1)) for _ in range(6)])
    parts = [spoiled(draw, numbers(draw, *shape)) for shape in ((n, count, 3), (n, 3), (n,))]
    sizes = [draw.choice((0.1, 1e-30, 1e30, *ODD)) for _ in range(3)]
    out = spoiled(draw, torch.empty(n, count, 3))
    _ext.store_harmonics(
        parts[0], parts[1], parts[2], sizes[0], sizes[1], sizes[2], spoiled(draw, weights), out
    )


def layers(draw: random.Random) -> None:
    """Layers in any order, in a reference image that may not hold them, in front of any view."""
    n, g = draw.choice((0, 1, 2, 17, 33)), torch.Generator().manual_seed(draw.getrandbits(31))
    reference, view = camera(draw), camera(draw)
    pixels = torch.randint(reference.width * reference.height, (n,), generator=g).sort().values
    if n and draw.random() < 0.2:
        pixels[draw.randrange(n)] = draw.choice((-1, 2**40, -(2**63)))
    spoil = draw.random() < 0.3
    positions = numbers(draw, n, 3, spoil=spoil).double()
    depths = (pixels + 1).double() * 10.0 ** draw.randint(-8, 2)  # rising: sorted
    depths = numbers(draw, n).double() if spoil else depths
    K, pose, width, height, _ = native_camera(reference)
    made = _ext.Layers(
        spoiled(draw, pixels),
        spoiled(draw, depths),
        spoiled(draw, positions),
        K,
        pose,
        width,
        height,
        draw.choice((1.0, 3.0, *ODD)),
    )
    out = spoiled(draw, torch.empty(view.height, view.width, dtype=torch.float64))
    _ext.draw_layers(made, *native_camera(view), out)


CASES: dict[str, Callable[[random.Random], None]] = {
    "rasterize": draw_and_differentiate, "step": step, "blocks": blocks, "photometric": loss,
    "adam": update, "observe": statistics, "bindings": bare, "huge counts": huge, "flood": flood,
    "codes": codes, "attention": attention, "moving anchors": moving_anchors, "support": support,
    "stored harmonics": stored, "layers": layers,
}  # fmt: skip
