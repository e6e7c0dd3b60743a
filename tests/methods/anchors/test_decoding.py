"""Decoding of some anchors: whoever does it, rows and slots count among all."""

import pytest
import torch
from torch import Tensor

from splatproof.methods.anchors.decoding import decode_some
from splatproof.reference.anchors import scaffold
from splatproof.reference.anchors.scaffold import Anchors, Decoder
from splatproof.reference.types import mlp

CAMERA = torch.tensor([0.1, 0.2, -2.0], dtype=torch.float64)
INDEX = torch.tensor([1, 2, 5, 8])


def drawn(dtype: torch.dtype) -> tuple[Anchors, Decoder, Tensor]:
    g = torch.Generator().manual_seed(3)
    draw = lambda *shape: torch.randn(*shape, generator=g).to(dtype)
    anchors = Anchors(
        centres=draw(9, 3), offsets=draw(9, 4, 3), features=draw(9, 6), log_scales=draw(9, 6)
    )
    decoder = scaffold.create_decoder(6, 4, g, dtype=dtype)
    return anchors, decoder, draw(4, 6)


@pytest.mark.parametrize("own_features", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_some_are_those_of_all_at_their_rows(dtype, own_features):
    anchors, decoder, features = drawn(dtype)
    stored = anchors.features.clone()
    if own_features:
        stored[INDEX] = features
    every = Anchors(**{**vars(anchors), "features": stored})
    want = scaffold.decode(every, decoder, CAMERA)
    found = decode_some(
        anchors, decoder, CAMERA, INDEX, features=features if own_features else None
    )
    assert want.rows is not None
    assert want.slots is not None
    assert found.rows is not None
    assert found.slots is not None
    assert found.decoded is not None
    assert torch.equal(found.decoded, INDEX)
    chosen = torch.isin(want.rows, INDEX)
    assert chosen.any()
    assert not chosen.all()
    assert torch.equal(found.slots, want.slots[chosen])
    assert torch.equal(found.rows, want.rows[chosen])
    for name in ("means", "quaternions", "scales", "opacities", "colours"):
        torch.testing.assert_close(getattr(found, name), getattr(want, name)[chosen])
        assert getattr(found, name).dtype == dtype


def test_networks_that_the_kernels_do_not_evaluate_are_evaluated():
    anchors, decoder, _ = drawn(torch.float32)
    deep = mlp.create((9, 6, 6, 4), torch.Generator().manual_seed(0))
    deeper = Decoder(opacity=deep, shape=decoder.shape, colour=decoder.colour)
    want = scaffold.decode(anchors, deeper, CAMERA)
    found = decode_some(anchors, deeper, CAMERA, torch.arange(9))
    assert torch.equal(found.opacities, want.opacities)
    assert len(found)
