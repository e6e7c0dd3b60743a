"""Decoding of some of a model's anchors: by the kernels where they can, else by the reference."""

from dataclasses import replace

from jaxtyping import Float, Int
from torch import Tensor

from splatproof.methods.kernels import anchors as native
from splatproof.reference.anchors import scaffold
from splatproof.reference.anchors.scaffold import Anchors, Decoder
from splatproof.reference.types.splats import Splats


def decode_some(
    anchors: Anchors,
    decoder: Decoder,
    camera_centre: Float[Tensor, "3"],
    index: Int[Tensor, " v"],
    *,
    with_distance: bool = False,
    features: Float[Tensor, "v f"] | None = None,
) -> Splats:
    """What some of the anchors decode to; rows and slots count among all.

    Args:
        anchors: All stored anchors.
        decoder: The three networks.
        camera_centre: Centre of the camera in the world, scene units.
        index: Rows of the anchors that are decoded, ascending.
        with_distance: Whether the networks also read the distance to the camera.
        features: Features that the networks read, one row a decoded anchor; None: the stored ones.
    """
    if native.applies(anchors, decoder, camera_centre):
        return native.decode(
            anchors, decoder, camera_centre, with_distance=with_distance, index=index,
            features=features,
        )  # fmt: skip
    chosen = Anchors(
        **{name: value.index_select(0, index) for name, value in vars(anchors).items()}
    )
    if features is not None:
        chosen = replace(chosen, features=features)
    splats = scaffold.decode(chosen, decoder, camera_centre, with_distance=with_distance)
    assert splats.rows is not None
    assert splats.slots is not None
    k = anchors.offsets.shape[1]
    rows = index[splats.rows]
    return replace(splats, rows=rows, slots=rows * k + splats.slots % k, decoded=index)
