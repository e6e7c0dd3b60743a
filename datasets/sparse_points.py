"""Sparse points of a COLMAP model, their tracks as rows of view indices."""

import numpy as np
import torch

from splatproof.base.errors import DataError
from splatproof.datasets.colmap_model import Model
from splatproof.reference.types.scene import SparsePoints


def read_points(model: Model) -> SparsePoints:
    """All points in order of their ids; a view counts once a point, unregistered images do not.

    Args:
        model: The checked model.
    Raises: DataError where COLMAP took other points from the files than were checked.
    """
    index = model.index
    order = np.argsort(index.point_ids)
    try:
        points = [model.reconstruction.point3D(int(i)) for i in index.point_ids[order]]
    except IndexError as error:
        raise DataError(
            f"{model.folder}: COLMAP reads other points than the file of points3D lists ({error}); "
            "write the model again"
        ) from None
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))

    view_of = {image.image_id: i for i, image in enumerate(model.images)}
    lookup = {i: view_of.get(i, -1) for i in index.image_ids}
    ids, inverse = np.unique(index.track_images, return_inverse=True)
    views = np.array([lookup[int(i)] for i in ids], dtype=np.int64)[inverse]
    rows = np.repeat(rank, index.track_lengths)
    pairs = np.unique(np.stack([rows, views], axis=1)[views >= 0], axis=0)
    starts = np.zeros(len(points) + 1, dtype=np.int64)
    np.cumsum(np.bincount(pairs[:, 0], minlength=len(points)), out=starts[1:])
    return SparsePoints(
        positions=torch.from_numpy(np.array([p.xyz for p in points], np.float64).reshape(-1, 3)),
        colours=torch.from_numpy(np.array([p.color for p in points], np.uint8).reshape(-1, 3)),
        track_starts=torch.from_numpy(starts),
        track_views=torch.from_numpy(pairs[:, 1].copy()),
    )


def seen_in_training(points: SparsePoints, train: tuple[int, ...]) -> SparsePoints:
    """Points without those that only held-out views see; points that no view sees stay.

    Tracks keep their held-out views: they are facts about the model, not pixels.

    Args:
        points: Points with their tracks.
        train: Indices of the training views.
    """
    lengths = points.track_starts.diff()
    rows = torch.repeat_interleave(torch.arange(len(points)), lengths)
    trained = torch.isin(points.track_views, torch.tensor(train, dtype=torch.int64))
    seen = torch.zeros(len(points), dtype=torch.int64).index_add_(0, rows, trained.long()) > 0
    keep = seen | (lengths == 0)
    starts = torch.cat([lengths.new_zeros(1), lengths[keep].cumsum(0)])
    return SparsePoints(
        positions=points.positions[keep],
        colours=points.colours[keep],
        track_starts=starts,
        track_views=points.track_views[keep[rows]],
    )
