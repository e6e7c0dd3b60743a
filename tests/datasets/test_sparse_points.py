"""Points of a COLMAP model: those that COLMAP itself reads, and not one call of it for each."""

import dataclasses

import numpy as np
import pycolmap
import pytest

from helpers.colmap_scenes import Flight, write_scene
from splatproof.base.errors import DataError
from splatproof.datasets.colmap_model import Model, find_model, read_model
from splatproof.datasets.sparse_points import read_points


@pytest.fixture(params=[False, True], ids=["bin", "txt"])
def model(request, tmp_path) -> Model:
    folder = write_scene(tmp_path / "scene", Flight(views=4, points=60), text=request.param)
    return read_model(find_model(folder))


def test_points_are_what_colmap_reads(model):
    points = read_points(model)
    known = sorted(model.reconstruction.points3D.items())
    assert len(points) == len(known) > 0
    view_of = {image.image_id: i for i, image in enumerate(model.images)}
    for row, (_, point) in enumerate(known):
        assert np.array_equal(points.positions[row].numpy(), point.xyz)
        assert np.array_equal(points.colours[row].numpy(), point.color)
        track = points.track_views[points.track_starts[row] : points.track_starts[row + 1]]
        assert track.tolist() == sorted({view_of[e.image_id] for e in point.track.elements})


def test_ids_may_stand_in_any_order(model):
    points, index = read_points(model), model.index
    turned = dataclasses.replace(
        index,
        point_ids=index.point_ids[::-1],
        positions=index.positions[::-1],
        colours=index.colours[::-1],
        track_lengths=index.track_lengths[::-1],
        track_images=index.track_images[::-1],
        track_observations=index.track_observations[::-1],
    )
    other = read_points(dataclasses.replace(model, index=turned))
    for name in ("positions", "colours", "track_starts", "track_views"):
        assert getattr(points, name).equal(getattr(other, name))


def test_no_point_is_asked_for_by_itself(model, monkeypatch):
    """A call of COLMAP a point takes seconds of a large model, each time that it is opened."""

    def refuse(*_: object) -> None:
        raise AssertionError("COLMAP was asked for a point")

    monkeypatch.setattr(pycolmap.Reconstruction, "point3D", refuse)
    monkeypatch.setattr(pycolmap.Reconstruction, "points3D", property(refuse))
    assert len(read_points(read_model(model.folder))) > 0


def test_points_that_colmap_does_not_read_are_refused(model):
    index = model.index
    ids = index.point_ids.copy()
    ids[0] += 1000
    other = dataclasses.replace(model, index=dataclasses.replace(index, point_ids=ids))
    with pytest.raises(DataError, match=r"other points than the file of points3D lists"):
        read_points(other)
