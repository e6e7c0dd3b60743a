"""HDGS hierarchy: few moving anchors, refined layer by layer into the Gaussians of one instant."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatproof.reference.anchors.scaffold import view_code
from splatproof.reference.anchors.vibration import life, vibrate
from splatproof.reference.rasterizer import rotation
from splatproof.reference.types import mlp
from splatproof.reference.types.mlp import Mlp
from splatproof.reference.types.splats import Splats

CODE_OCTAVES = 4
"""Octaves of the sine-cosine embedding of positions and time (ours: the paper gives none)."""


@dataclass(frozen=True, kw_only=True)
class HierarchySettings:
    """Sizes of the hierarchy. Source: HDGS, Sec. 4.1."""

    layers: int = 3
    """N: layers 0 to N - 2 hold anchors, layer N - 1 the Gaussians."""
    children: int = 2
    """k: number of children of an anchor in the anchor layers."""
    gaussians: int = 12
    """K: number of Gaussians of one initial anchor; a multiple of k^(N - 2). The paper's K stays at
    12, which stores more numbers the more layers there are, and does not divide at N = 5; with
    `by_leaf` it grows with the depth instead. Tables over N have a row for either rule."""
    features: int = 32
    instance: int = 8
    period: float = 1.0
    """p: after this time the vibration repeats. In the unit of the scene's times."""

    @property
    def leaves(self) -> int:
        """Anchors of layer N - 2 that descend from one initial anchor: k^(N - 2)."""
        return self.children ** (self.layers - 2)


def by_leaf(settings: HierarchySettings, leaf: int) -> HierarchySettings:
    """The second rule of size, K = leaf k^(N - 2): the last anchors keep their number of Gaussians.

    One layer more then halves the number of initial anchors that a number of Gaussians takes,
    which is the halved storage of the paper's Table 8.

    Args:
        settings: Layers N and children k are read; `gaussians` is replaced.
        leaf: Number of Gaussians of each anchor of layer N - 2, > 0; the paper has 6 at N = 3.

    Raises: ValueError if there are fewer than 2 layers: one layer of Gaussians without anchors is
        no hierarchy but per-Gaussian motion, a method of its own.

    Source: ours.
    """
    _check_layers(settings)
    return replace(settings, gaussians=leaf * settings.leaves)


def _check_layers(settings: HierarchySettings) -> None:
    """Refuse a hierarchy without anchors."""
    if settings.layers < 2:
        raise ValueError(f"need at least 2 layers, anchors and Gaussians: N {settings.layers}")


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionAnchors:
    """What is stored: layer 0 and every layer's offsets. Deeper anchors are decoded, never saved."""

    centres: Float[Tensor, "n 3"]
    """mu_0: positions at the life peak, scene units."""
    features: Float[Tensor, "n f"]
    instances: Float[Tensor, "n h"]
    """h: instance features; all descendants of an anchor inherit them."""
    quaternions: Float[Tensor, "n 4"]
    """Orientation of the base covariance that the support network reads; decoding does not."""
    log_scales: Float[Tensor, "n 3"]
    peaks: Float[Tensor, " n"]
    """tau: the time at which an anchor is most visible and stands at its centre."""
    velocities: Float[Tensor, "n 3"]
    log_spans: Float[Tensor, " n"]
    """Logarithm of beta, how long an anchor stays visible around its peak."""
    offsets: tuple[Float[Tensor, "n _ 3"], ...]
    """For layers 1 to N - 1: o_i in units of the scale, k^i rows (the last: K rows) an anchor."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LayerNetworks:
    """Residual networks of one anchor layer; inputs h, emb(mu), emb(t); outputs for k children."""

    position: Mlp
    feature: Mlp
    scale: Mlp


@dataclass(frozen=True, kw_only=True, eq=False)
class HierarchyNetworks:
    """All networks; shared by all anchors."""

    layers: tuple[LayerNetworks, ...]
    """Residual networks of the anchor layers 1 to N - 2."""
    leaf_position: Mlp
    """Residual of the Gaussians' positions, layer N - 1."""
    colour: Mlp
    """Inputs f, distance, direction; 3 outputs a Gaussian, then sigmoid."""
    opacity: Mlp
    """1 output a Gaussian, then sigmoid; multiplied by F(t)."""
    shape: Mlp
    """7 outputs a Gaussian: scale factor 3 (sigmoid), quaternion 4."""


def code(values: Float[Tensor, "n d"]) -> Float[Tensor, "n e"]:
    """Embedding (x, sin 2^l x, cos 2^l x for l < 4), d * 9 numbers."""
    waves = [
        f(values * 2**octave) for octave in range(CODE_OCTAVES) for f in (torch.sin, torch.cos)
    ]
    return torch.cat([values, *waves], dim=1)


def create_networks(
    settings: HierarchySettings, generator: torch.Generator, dtype: torch.dtype = torch.float32
) -> HierarchyNetworks:
    """Networks with one hidden layer; residual ones start at zero, so that motion starts rigid.

    Args:
        settings: Sizes of the hierarchy, which fix the networks' inputs and outputs.
        generator: Source of the random weights.
        dtype: Dtype of the parameters.

    Raises: ValueError if there are fewer than 2 layers or K is not a multiple of k^(N - 2).
    """
    _check_layers(settings)
    if settings.gaussians % settings.leaves:
        raise ValueError(
            f"K must be a multiple of k^(N - 2), see by_leaf: N {settings.layers}, "
            f"k {settings.children}, K {settings.gaussians}"
        )
    wide = settings.features
    inputs = settings.instance + 4 * (1 + 2 * CODE_OCTAVES)
    leaf = settings.gaussians // settings.leaves

    def residual(outputs: int) -> Mlp:
        network = mlp.create((inputs, wide, outputs), generator, dtype)
        last = torch.zeros_like(network.weights[-1])
        return Mlp(weights=(*network.weights[:-1], last), biases=network.biases)

    k = settings.children
    layer = lambda: LayerNetworks(
        position=residual(3 * k), feature=residual(settings.features * k),
        scale=residual(3 * k),
    )  # fmt: skip
    sees = settings.features + 4
    return HierarchyNetworks(
        layers=tuple(layer() for _ in range(settings.layers - 2)),
        leaf_position=residual(3 * leaf),
        colour=mlp.create((sees, wide, 3 * leaf), generator, dtype),
        opacity=mlp.create((sees, wide, leaf), generator, dtype),
        shape=mlp.create((sees, wide, 7 * leaf), generator, dtype),
    )


def decode(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    settings: HierarchySettings,
    time: float,
    camera_centre: Float[Tensor, "3"],
) -> Splats:
    """Gaussians at time t: every layer adds its offset and its residual to its parent, once.

    mu_i(t) = mu_{i-1}(t) + o_i * scale + MLP_i^p(h, emb(mu_{i-1}), emb(t)). The paper's Eq. 2 has
    no offset and Eq. 4 sums offsets up to level N - 1 under one set of parentheses; unrolling the
    reading above gives Eq. 4's sum with each level counted once (our decision).

    Args:
        anchors: The stored layer 0 and offsets.
        networks: From `create_networks` with the same settings.
        settings: Sizes; the offsets must fit them.
        time: t, in the unit of the peaks and of the period.
        camera_centre: Camera centre in the world, scene units; all but position depends on it.

    Source: HDGS, Eqs. 1 to 6.
    """
    at = vibrate(anchors.centres, anchors.velocities, anchors.peaks, time, settings.period)
    features, scales, instances = anchors.features, anchors.log_scales, anchors.instances
    for layer, offsets in zip(networks.layers, anchors.offsets[:-1], strict=True):
        inputs = _inputs(instances, at, time)
        k = settings.children
        steps = offsets.reshape(-1, 3) * scales.exp().repeat_interleave(k, dim=0)
        at, features, scales = (
            _children(at, layer.position, inputs, k) + steps,
            _children(features, layer.feature, inputs, k),
            _children(scales, layer.scale, inputs, k),
        )
        instances = instances.repeat_interleave(k, dim=0)
    return _leaves(
        anchors, networks, settings, time, camera_centre, at, features, scales, instances
    )


def _children(
    parents: Float[Tensor, "n c"], network: Mlp, inputs: Float[Tensor, "n i"], k: int
) -> Float[Tensor, "m c"]:
    """Attributes of the k children of each anchor: the parent's plus the predicted residual."""
    change = mlp.evaluate(network, inputs).reshape(len(parents) * k, parents.shape[1])
    return parents.repeat_interleave(k, dim=0) + change


def _inputs(
    instances: Float[Tensor, "n h"], at: Float[Tensor, "n 3"], time: float
) -> Float[Tensor, "n i"]:
    """What the residual networks read: h, emb(mu), emb(t)."""
    moment = code(torch.full_like(at[:, :1], time))
    return torch.cat([instances, code(at), moment], dim=1)


def _leaves(
    anchors: MotionAnchors,
    networks: HierarchyNetworks,
    settings: HierarchySettings,
    time: float,
    camera_centre: Float[Tensor, "3"],
    at: Float[Tensor, "a 3"],
    features: Float[Tensor, "a f"],
    log_scales: Float[Tensor, "a 3"],
    instances: Float[Tensor, "a h"],
) -> Splats:
    """Layer N - 1: the Gaussians of the last anchors."""
    count = settings.gaussians // settings.leaves
    base = log_scales.exp().repeat_interleave(count, dim=0)
    change = mlp.evaluate(networks.leaf_position, _inputs(instances, at, time)).reshape(-1, 3)
    offsets = anchors.offsets[-1].reshape(-1, 3)
    direction, distance = view_code(at, camera_centre)
    seen = torch.cat([features, distance, direction], dim=1)
    shape = mlp.evaluate(networks.shape, seen).reshape(-1, 7)
    opacity = torch.sigmoid(mlp.evaluate(networks.opacity, seen)).reshape(-1)
    alive = life(anchors.peaks, anchors.log_spans.exp(), time)
    return Splats(
        means=at.repeat_interleave(count, dim=0) + offsets * base + change,
        quaternions=rotation.normalise(shape[:, 3:]),
        scales=base * torch.sigmoid(shape[:, :3]),
        opacities=opacity * alive.repeat_interleave(settings.gaussians),
        colours=torch.sigmoid(mlp.evaluate(networks.colour, seen)).reshape(-1, 3),
        rows=torch.arange(len(anchors.peaks)).repeat_interleave(settings.gaussians),
    )


def stored_numbers(anchors: MotionAnchors, networks: HierarchyNetworks) -> int:
    """Numbers that are saved: anchors and networks, not the decoded Gaussians.

    Args:
        anchors: Layer 0 and the offsets of all layers.
        networks: All networks, biases included.
    """
    stored = [value for value in vars(anchors).values() if isinstance(value, Tensor)]
    stored += anchors.offsets
    nets = [networks.leaf_position, networks.colour, networks.opacity, networks.shape]
    for layer in networks.layers:
        nets += [layer.position, layer.feature, layer.scale]
    stored += [value for net in nets for value in (*net.weights, *net.biases)]
    return sum(value.numel() for value in stored)
