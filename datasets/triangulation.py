"""Sparse points of a scene whose poses are given: its training views matched, their points triangulated.

The points come from the training views alone, as the protocol shows them: nothing of a held-out view
is in them. Done once for equal pixels and cameras, then read from the cache.
"""

import hashlib
import io
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
import torch
from jaxtyping import UInt8

from splatproof.base.errors import DataError
from splatproof.base.files import read_bytes, write_bytes
from splatproof.base.folders import check_disk
from splatproof.base.locks import locked
from splatproof.datasets import pairing
from splatproof.datasets.cache_folder import ELSEWHERE, cache_folder
from splatproof.datasets.colmap_library import FEATURES, MATCHES, pycolmap
from splatproof.datasets.progress import bar
from splatproof.reference.types.scene import Scene, SparsePoints, View

SEED = 0
"""Seed of the verification of matches and of the triangulation, which draw samples."""
VERSION = "2"
"""Changes when other points would come out of equal views."""
_ROOM = "make room, or let TMPDIR be a folder with more"
Report = Callable[[int, int], None]


def with_triangulated(scene: Scene) -> Scene:
    """The scene with points triangulated from its training views under their own poses.

    SIFT features, every pair of views matched (of more than 40 views: the 30 nearest) and verified,
    tracks triangulated, those of two views too, which COLMAP leaves out by itself: of three far
    views hardly any others are left. Poses and intrinsics are not touched. No point may come out.

    Args:
        scene: The scene, whose own points are replaced.
    Raises: DataError with fewer than two training views; MissingError where the folder of temporary
        files, in which views are matched, has no room.
    Source: StratoSplat, Sec. 4.1 (implementation details); Schoenberger and Frahm 2016 (COLMAP).
    """
    views = scene.train_views
    if len(views) < 2:
        raise DataError(
            f"{scene.name}: {len(views)} training view, but points are to be triangulated from at "
            "least two; take a protocol with more"
        )
    digest = _digest(views)
    path = cache_folder() / "triangulated" / f"{digest}.npz"
    with locked(path.with_suffix(".lock"), elsewhere=ELSEWHERE):
        table = _kept(path)
        if table is None:
            with bar(f"triangulating points of {scene.name}") as report:
                made = _triangulate(views, report)
            write_bytes(path, made)
            table = _table(io.BytesIO(made))
    members = torch.tensor(scene.train, dtype=torch.int64)
    points = SparsePoints(**(table | {"track_views": members[table["track_views"]]}))
    facts = {"points": f"{len(points)} triangulated from {len(views)} training views"}
    return replace(scene, points=points, facts=scene.facts | facts)


def _kept(path: Path) -> dict[str, torch.Tensor] | None:
    """The points of an earlier call; None where there are none, or they are damaged and can be made again."""
    if not path.is_file():
        return None
    try:
        return _table(io.BytesIO(read_bytes(path)))
    except (ValueError, EOFError, BadZipFile):
        return None


def _table(file: io.BytesIO) -> dict[str, torch.Tensor]:
    with np.load(file) as kept:
        return {name: torch.from_numpy(kept[name]) for name in kept.files}


def _digest(views: Sequence[View]) -> str:
    """Hash of all that the points depend on."""
    digest = hashlib.sha256(f"{VERSION} {pycolmap.__version__} {SEED}".encode())
    for view in views:
        camera = view.camera
        digest.update(f"{view.name} {camera.width} {camera.height}".encode())
        digest.update(camera.K.numpy().tobytes())
        digest.update(camera.world_to_camera.numpy().tobytes())
        digest.update(_pixels(view).tobytes())
        digest.update(b"" if view.load_mask is None else view.load_mask().numpy().tobytes())
    return digest.hexdigest()


def _pixels(view: View) -> UInt8[np.ndarray, "h w 3"]:
    return (view.load() * 255).round().to(torch.uint8).numpy()


def _triangulate(views: Sequence[View], report: Report) -> bytes:
    """The points as the bytes of an .npz; tracks hold indices into `views`."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    steps = len(views) + 2
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for name in ("photos", "masks", "model"):
            (work / name).mkdir()
        for index, view in enumerate(views):
            report(index, steps)
            _extract(work, index, view)
        report(len(views), steps)
        _match(work, views)
        report(len(views) + 1, steps)
        model = pycolmap.triangulate_points(
            _posed(work, views), work / "database.db", work / "photos", work / "model",
            options=_options(),
        )  # fmt: skip
    report(steps, steps)
    return _packed(model)


def _extract(work: Path, index: int, view: View) -> None:
    """Features of one view, whose image and camera get the id index + 1."""
    camera = view.camera
    name = _name(index)
    check_disk(work, 3 * camera.width * camera.height + FEATURES, _ROOM)
    cv2.imwrite(str(work / "photos" / name), np.ascontiguousarray(_pixels(view)[..., ::-1]))
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    K = camera.K
    reader.camera_params = ",".join(repr(float(K[at])) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if view.load_mask is not None:
        mask = 255 * view.load_mask().numpy().astype(np.uint8)
        cv2.imwrite(str(work / "masks" / f"{name}.png"), mask)
        reader.mask_path = work / "masks"
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = max(camera.width, camera.height)
    pycolmap.extract_features(
        work / "database.db",
        work / "photos",
        image_names=[name],
        camera_mode=pycolmap.CameraMode.PER_IMAGE,
        reader_options=reader,
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def _name(index: int) -> str:
    return f"{index:06d}.png"


def _match(work: Path, views: Sequence[View]) -> None:
    """Match pairs of views and verify the matches."""
    if len(views) <= pairing.EXHAUSTIVE:
        pairs = pairing.exhaustive(len(views))
    else:
        centres = torch.stack([view.camera.centre for view in views]).numpy()
        pairs = pairing.nearest(centres, range(len(views)))
    check_disk(work, len(pairs) * MATCHES, _ROOM)
    listed = pycolmap.ImportedPairingOptions()
    listed.match_list_path = work / "pairs.txt"
    (work / "pairs.txt").write_text("".join(f"{_name(a)} {_name(b)}\n" for a, b in sorted(pairs)))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    pycolmap.match_image_pairs(
        work / "database.db",
        pycolmap.FeatureMatchingOptions(),
        listed,
        verification,
        pycolmap.Device.cpu,
    )


def _posed(work: Path, views: Sequence[View]) -> pycolmap.Reconstruction:
    """A model of the views' poses without points; ids as in the database."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(work / "database.db") as database:
        images = {image.name: image for image in database.read_all_images()}
        for index, view in enumerate(views):
            image = images[_name(index)]
            model.add_camera_with_trivial_rig(database.read_camera(image.camera_id))
            pose = view.camera.world_to_camera[:3].numpy()
            model.add_image_with_trivial_frame(
                pycolmap.Image(name=image.name, image_id=image.image_id, camera_id=image.camera_id),
                pycolmap.Rigid3d(pose),
            )
    return model


def _options() -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = SEED
    options.ba_refine_focal_length = False
    options.ba_refine_principal_point = False
    options.ba_refine_extra_params = False
    options.triangulation.ignore_two_view_tracks = False
    return options


def _packed(model: pycolmap.Reconstruction) -> bytes:
    """Points in order of their ids as an .npz, with tracks as CSR rows."""
    index = {image.image_id: int(Path(image.name).stem) for image in model.images.values()}
    points = [model.point3D(i) for i in sorted(model.point3D_ids())]
    tracks = [
        sorted({index[element.image_id] for element in point.track.elements}) for point in points
    ]
    buffer = io.BytesIO()
    np.savez(
        buffer,
        positions=np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        colours=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
        track_starts=np.cumsum([0, *map(len, tracks)], dtype=np.int64),
        track_views=np.array([view for track in tracks for view in track], np.int64),
    )
    return buffer.getvalue()
