"""The city looks like the world to a feature detector: structure from motion registers its views."""

import numpy as np
import pycolmap
import pytest

from splatproof.datasets.procedural import worlds


@pytest.mark.slow
def test_structure_from_motion_registers_the_nadir_views(tmp_path):
    folder = worlds.make("city", "small", 0, tmp_path / "city")
    database, photos = tmp_path / "database.db", folder / "photos"
    names = sorted(path.name for path in photos.iterdir())
    camera = pycolmap.Reconstruction(folder / "sparse" / "0").cameras[1]
    reader = pycolmap.ImageReaderOptions(
        camera_model="PINHOLE", camera_params=",".join(map(str, camera.params))
    )
    pycolmap.extract_features(
        database, photos, camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
        device=pycolmap.Device.cpu,
    )  # fmt: skip
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    (tmp_path / "sfm").mkdir()
    # a flat scene from one height does not tell the focal length: the true one is kept
    options = pycolmap.IncrementalPipelineOptions(ba_refine_focal_length=False)
    models = pycolmap.incremental_mapping(database, photos, tmp_path / "sfm", options)
    best = max(models.values(), key=lambda model: model.num_reg_images())
    assert best.num_reg_images() >= 0.95 * len(names)
    # and in the right places: camera centres agree with the truth up to a similarity
    truth = {
        image.name: image.projection_center()
        for image in pycolmap.Reconstruction(folder / "sparse" / "0").images.values()
    }
    found = {image.name: image.projection_center() for image in best.images.values()}
    shared = sorted(found)
    source, target = (np.array([table[name] for name in shared]) for table in (found, truth))
    fit = pycolmap.estimate_sim3d(source, target)
    assert fit is not None
    gap = np.linalg.norm(np.array([fit * x for x in source]) - target, axis=1)
    assert np.median(gap) < 1.0  # of 105 metres above ground
