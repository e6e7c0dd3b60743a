from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.nn import functional
from torch.testing import assert_close

from splatproof.reference.anchors import sparse_convolution, support_network
from splatproof.reference.types import mlp

D = torch.float64


def sites(n: int, seed: int) -> Tensor:
    """Distinct voxels of a 5 x 5 x 5 grid around the origin, negative ones too."""
    order = torch.randperm(125, generator=torch.Generator().manual_seed(seed))[:n]
    return torch.stack([order // 25, order // 5 % 5, order % 5], dim=1) - 2


@given(n=st.integers(0, 40), seed=st.integers(0, 2**16))
@settings(max_examples=40)
def test_convolution_is_the_dense_one_masked(n, seed):
    g = torch.Generator().manual_seed(seed)
    where = sites(n, seed)
    features = torch.randn(n, 3, generator=g, dtype=D)
    weights = torch.randn(27, 3, 4, generator=g, dtype=D)
    x, y, z = (where + 2).T
    dense = torch.zeros(1, 3, 5, 5, 5, dtype=D)
    dense[0, :, x, y, z] = features.T
    kernel = weights.permute(2, 1, 0).reshape(4, 3, 3, 3, 3)
    want = functional.conv3d(dense, kernel, padding=1)[0, :, x, y, z].T
    got = sparse_convolution.convolve(features, sparse_convolution.neighbours(where), weights)
    assert_close(got, want)


def test_one_site_sees_only_itself():
    around = sparse_convolution.neighbours(torch.tensor([[-7, 3, 100]]))
    assert around[0, sparse_convolution.SELF] == 0
    assert int((around >= 0).sum()) == 1


def test_kernel_cells_are_ordered_x_slowest():
    around = sparse_convolution.neighbours(torch.tensor([[0, 0, 0], [1, 0, 0], [0, 0, 1]]))
    cell = sparse_convolution.OFFSETS.index
    assert around[0, cell((1, 0, 0))] == 1
    assert around[0, cell((0, 0, 1))] == 2
    assert cell((1, 0, 0)) == 22
    assert cell((0, 0, 1)) == 14


def test_two_anchors_in_a_voxel_are_refused():
    with pytest.raises(ValueError, match="share a voxel"):
        sparse_convolution.neighbours(torch.tensor([[1, 2, 3], [1, 2, 3]]))


def test_voxels_round_down_on_both_sides_of_zero():
    got = sparse_convolution.voxelise(torch.tensor([[-0.1, 0.1, 0.5]], dtype=D), 0.25)
    assert got.tolist() == [[-1, 0, 2]]
    with pytest.raises(ValueError, match="voxel size"):
        sparse_convolution.voxelise(torch.zeros(1, 3), 0.0)


def anchors(n: int, seed: int):
    g = torch.Generator().manual_seed(seed)
    centres = sites(n, seed) + torch.rand(n, 3, generator=g, dtype=D)
    quaternions = torch.randn(n, 4, generator=g, dtype=D)
    scales = 0.1 + torch.rand(n, 3, generator=g, dtype=D)
    features = torch.randn(n, 6, generator=g, dtype=D)
    network = support_network.create(6, g, D)
    network = replace(network, residual=mlp.create((6, 6), g, D))
    return network, features, centres, quaternions, scales


def test_support_by_loop():
    network, features, centres, quaternions, scales = anchors(12, 3)
    got = support_network.support(network, features, centres, quaternions, scales, 1.0)
    voxel = centres.floor()
    for i in range(12):
        sigma = torch.eye(3, dtype=D)
        w, x, y, z = (quaternions[i] / quaternions[i].norm()).tolist()
        turn = torch.tensor(
            [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
             [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
             [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]], dtype=D)  # fmt: skip
        sigma = turn @ torch.diag(scales[i].square()) @ turn.T
        values, vectors = torch.linalg.eigh(sigma)
        values, axis = values.flip(0), vectors[:, 2]
        modulated = torch.zeros(6, dtype=D)
        for j in range(12):
            step = (voxel[j] - voxel[i]).long()
            if step.abs().max() > 1:
                continue
            cell = sparse_convolution.OFFSETS.index(tuple(step.tolist()))
            way = centres[j] - centres[i]
            cosine2 = float((way @ axis) ** 2 / (way @ way)) if i != j else 0.0
            code = torch.cat([torch.tensor([cosine2 * float(1 - values[1] / values[0])], dtype=D),
                              values / values.sum()])  # fmt: skip
            weight = mlp.evaluate(network.modulation, code[None])[0]
            modulated += weight * (features[j] @ network.convolution[cell])
        gate = torch.sigmoid(mlp.evaluate(network.gate, modulated[None]))[0]
        want = features[i] + gate * mlp.evaluate(network.residual, modulated[None])[0]
        assert_close(got[i], want)


@given(n=st.integers(0, 20), seed=st.integers(0, 2**16))
@settings(max_examples=25)
def test_permuting_anchors_permutes_the_result(n, seed):
    network, *rest = anchors(n, seed)
    order = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    got = support_network.support(network, *rest, voxel=1.0)
    other = support_network.support(network, *(value[order] for value in rest), voxel=1.0)
    assert_close(other, got[order])


def test_an_isolated_anchor_does_not_depend_on_the_others():
    network, features, centres, quaternions, scales = anchors(5, 1)
    centres[0] += 100
    got = support_network.support(network, features, centres, quaternions, scales, 1.0)
    alone = support_network.support(
        network, features[:1], centres[:1], quaternions[:1], scales[:1], 1.0
    )
    assert_close(got[:1], alone)


def test_a_sphere_has_no_direction():
    network, features, centres, quaternions, scales = anchors(12, 2)
    scales = torch.full_like(scales, 0.3)
    other = torch.randn(12, 4, generator=torch.Generator().manual_seed(9), dtype=D)
    a = support_network.support(network, features, centres, quaternions, scales, 1.0)
    b = support_network.support(network, features, centres, other, scales, 1.0)
    assert a.isfinite().all()
    assert_close(a, b)


def test_the_sign_of_an_axis_does_not_matter():
    network, features, centres, _, scales = anchors(12, 4)
    scales = scales * torch.tensor([3.0, 1, 1])
    quaternions = torch.tensor([[1.0, 0, 0, 0]], dtype=D).expand(12, 4)
    turned = torch.tensor([[0.0, 0, 0, 1]], dtype=D).expand(12, 4)  # half a turn: x axis to -x
    a = support_network.support(network, features, centres, quaternions, scales, 1.0)
    b = support_network.support(network, features, centres, turned, scales, 1.0)
    assert_close(a, b)


def test_direction_matters_where_there_is_one():
    network, features, centres, quaternions, scales = anchors(12, 4)
    other = torch.randn(12, 4, generator=torch.Generator().manual_seed(9), dtype=D)
    a = support_network.support(network, features, centres, quaternions, scales, 1.0)
    b = support_network.support(network, features, centres, other, scales, 1.0)
    assert float((a - b).abs().max()) > 1e-3


def test_a_fresh_network_changes_nothing():
    network, features, centres, quaternions, scales = anchors(8, 5)
    network = support_network.create(6, torch.Generator().manual_seed(0), D)
    got = support_network.support(network, features, centres, quaternions, scales, 1.0)
    assert_close(got, features)


def test_gradients():
    network, features, centres, quaternions, scales = anchors(5, 6)
    inputs = [x.requires_grad_() for x in (features, quaternions, scales)]

    def run(f, q, s):
        return support_network.support(network, f, centres, q, s, 1.0)

    assert torch.autograd.gradcheck(run, inputs)


@given(sizes=st.lists(st.integers(1, 6), min_size=2, max_size=4), n=st.integers(0, 5))
def test_network_is_torch_s_sequential(sizes, n):
    g = torch.Generator().manual_seed(n)
    network = mlp.create(tuple(sizes), g, D)
    layers: list[torch.nn.Module] = []
    for weight, bias in zip(network.weights, network.biases, strict=True):
        linear = torch.nn.Linear(weight.shape[0], weight.shape[1], dtype=D)
        linear.weight.data, linear.bias.data = weight.T, bias
        layers += [linear, torch.nn.ReLU()]
    x = torch.randn(n, sizes[0], generator=g, dtype=D)
    assert_close(mlp.evaluate(network, x), torch.nn.Sequential(*layers[:-1])(x).detach())
