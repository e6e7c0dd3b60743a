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
    odd = model.reconstruction.point3D_ids() ^ set(index.point_ids.tolist())
    if odd:
        raise DataError(
            f"{model.folder}: COLMAP reads other points than the file of points3D lists (one has point "
            f"{min(odd)}, the other has not); write the model again"
        )
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))

    view_of = {image.image_id: i for i, image in enumerate(model.images)}
    lookup = {i: view_of.get(i, -1) for i in index.image_ids}
    ids, inverse = np.unique(index.track_images, return_inverse=True)
    views = np.array([lookup[int(i)] for i in ids], dtype=np.int64)[inverse]
    rows = np.repeat(rank, index.track_lengths)
    # one number for each pair: numpy sorts those a hundred times as fast as rows of two
    pairs = np.sort((rows * len(view_of) + views)[views >= 0])
    rows, views = np.divmod(pairs[np.diff(pairs, prepend=-1) > 0], max(len(view_of), 1))
    starts = np.zeros(len(order) + 1, dtype=np.int64)
    np.cumsum(np.bincount(rows, minlength=len(order)), out=starts[1:])
    return SparsePoints(
        positions=torch.from_numpy(index.positions[order]),
        colours=torch.from_numpy(index.colours[order]),
        track_starts=torch.from_numpy(starts),
        track_views=torch.from_numpy(views),
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
