"""Structure from motion by pycolmap, in steps that a killed run takes up again.

Everything lands in one database: photos that have features and pairs that are matched are
passed over, so a step that is started again does only what is missing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.folders import check_disk
from splatproof.datasets import pairing
from splatproof.datasets.colmap_library import FEATURES, MATCHES, pycolmap
from splatproof.datasets.ingesting import alignment
from splatproof.datasets.ingesting.survey import Photo

Report = Callable[[str, int, int], None]
"""Told (step, done, total)."""
Lens = tuple[int, int, str]
_PHOTOS_A_CALL = 8
_PAIRS_A_CALL = 100
_ROOM = "make room or choose another folder; the same command continues where it stopped"


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Where a run works and what it was asked."""

    database: Path
    given: Path
    """Folder that the user gave, for errors."""
    photos: Path
    """Folder of the photos under their scene names."""
    max_image_size: int
    """Longest side at which features are looked for, in pixels."""
    threads: int
    seed: int


def extract(work: Structure, photos: Sequence[Photo], report: Report) -> None:
    """Find SIFT features in every photo; photos of equal lens share one SIMPLE_RADIAL camera.

    Args:
        work: Where the database and the photos are, and the settings.
        photos: All photos of the scene.
        report: Told ("features", photos done, photos in all).

    Raises: MissingError where the disk has no room for them.
    """
    options = pycolmap.FeatureExtractionOptions()
    options.max_image_size = work.max_image_size
    options.num_threads = work.threads
    cameras = _cameras(work, photos)
    _images(work, photos, cameras)
    done = 0
    for lens, camera in cameras.items():
        reader = pycolmap.ImageReaderOptions()
        reader.existing_camera_id = camera
        names = [photo.name for photo in photos if photo.lens == lens]
        for start in range(0, len(names), _PHOTOS_A_CALL):
            report("features", done, len(photos))
            chunk = names[start : start + _PHOTOS_A_CALL]
            check_disk(work.database.parent, len(chunk) * FEATURES, _ROOM)
            pycolmap.extract_features(
                work.database,
                work.photos,
                image_names=chunk,
                camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=options,
                device=pycolmap.Device.cpu,
            )
            done += len(chunk)
    report("features", done, len(photos))


def _cameras(work: Structure, photos: Sequence[Photo]) -> dict[Lens, int]:
    """Camera id of each lens, written once with a rig of it alone; ids follow the sorted lenses."""
    first: dict[Lens, Photo] = {}
    for photo in photos:
        first.setdefault(photo.lens, photo)
    ids = {lens: i + 1 for i, lens in enumerate(sorted(first))}
    with pycolmap.Database.open(work.database) as database:
        for lens, number in ids.items():
            if not database.exists_camera(number):
                camera = pycolmap.infer_camera_from_image(work.photos / first[lens].name)
                camera.camera_id = number
                database.write_camera(camera, use_camera_id=True)
            if not database.exists_rig(number):
                rig = pycolmap.Rig(rig_id=number)
                rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number))
                database.write_rig(rig, use_rig_id=True)
    return ids


def _images(work: Structure, photos: Sequence[Photo], cameras: Mapping[Lens, int]) -> None:
    """Write every photo's entry before its features: ids follow cameras and names.

    COLMAP numbers photos as their features are found, which with several threads is chance, and
    mapping depends on the numbers.
    """
    ordered = sorted(photos, key=lambda photo: cameras[photo.lens])
    with pycolmap.Database.open(work.database) as database:
        for number, photo in enumerate(ordered, start=1):
            camera = cameras[photo.lens]
            image = pycolmap.Image(name=photo.name, camera_id=camera, image_id=number)
            frame = pycolmap.Frame(frame_id=number, rig_id=camera)
            frame.add_data_id(image.data_id)
            if not database.exists_image(number):
                database.write_image(image, use_image_id=True)
            if not database.exists_frame(number):
                database.write_frame(frame, use_frame_id=True)


def choose_pairs(work: Structure, photos: Sequence[Photo]) -> tuple[list[tuple[str, str]], str]:
    """Choose which photos are matched with which.

    Args:
        work: Where the database with the features is.
        photos: All photos of the scene, sorted by name.
    Returns: Names of the pairs, sorted, and the rule that chose them in words.
    """
    located = [i for i, photo in enumerate(photos) if photo.gps is not None]
    count = len(photos)
    if len(located) >= pairing.GPS_SHARE * count:
        gps = np.array([photo.gps for photo in photos if photo.gps is not None])
        metres, _ = alignment.local_metres(gps)
        pairs = pairing.nearest(metres[:, :2], located) | pairing.following(count)
        others = sorted(set(range(count)) - set(located))
        if others:
            pairs |= pairing.alike(_signatures(work, photos), others)
        rule = f"{pairing.NEIGHBOURS} nearest by GPS"
    elif count <= pairing.EXHAUSTIVE:
        pairs, rule = pairing.exhaustive(count), "all pairs"
    else:
        pairs = pairing.following(count) | pairing.alike(_signatures(work, photos), range(count))
        rule = f"next {pairing.FOLLOWING} by name and {pairing.ALIKE} most alike"
    return [(photos[a].name, photos[b].name) for a, b in sorted(pairs)], rule


def _signatures(work: Structure, photos: Sequence[Photo]) -> np.ndarray:
    none = np.zeros((0, 128), dtype=np.uint8)
    with pycolmap.Database.open(work.database) as database:
        ids = {image.name: image.image_id for image in database.read_all_images()}
        found = [
            np.asarray(database.read_descriptors(ids[photo.name]).data)
            if photo.name in ids
            else none
            for photo in photos
        ]
    return pairing.vlad(found, work.seed)


def match(work: Structure, pairs: Sequence[tuple[str, str]], report: Report) -> None:
    """Match and verify every pair that is not matched yet.

    Args:
        work: Where the database with the features is, and the settings.
        pairs: Names of the photos of each pair.
        report: Told ("matches", pairs done, pairs in all).

    Raises: MissingError where the disk has no room for them.
    """
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = work.threads
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = work.seed
    listed = pycolmap.ImportedPairingOptions()
    listed.match_list_path = work.database.with_name("pairs.txt")
    for start in range(0, len(pairs), _PAIRS_A_CALL):
        report("matches", start, len(pairs))
        chunk = pairs[start : start + _PAIRS_A_CALL]
        check_disk(work.database.parent, len(chunk) * MATCHES, _ROOM)
        Path(listed.match_list_path).write_text("".join(f"{a} {b}\n" for a, b in chunk))
        pycolmap.match_image_pairs(
            work.database, matching, listed, verification, pycolmap.Device.cpu
        )
    report("matches", len(pairs), len(pairs))


def reconstruct(
    work: Structure, count: int, report: Report
) -> tuple[pycolmap.Reconstruction, dict[str, int]]:
    """Incremental mapping.

    Args:
        work: Where the matched database is.
        count: Number of photos, for the report.
        report: Told (step, done, total).

    Returns: The largest model, and for every photo of another one the size of its group.
    Raises: DataError if no two photos can be joined.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = work.threads
    options.random_seed = work.seed
    options.min_model_size = min(3, count)
    done = 0

    def one_more() -> None:
        nonlocal done
        done = min(done + 1, count)
        report("mapping", done, count)

    output = work.database.with_name("models")
    output.mkdir(exist_ok=True)
    pycolmap.set_random_seed(work.seed)
    models = pycolmap.incremental_mapping(
        work.database, work.photos, output, options, next_image_callback=one_more
    )
    if not models:
        raise DataError(
            f"{work.given}: no two of {count} photos could be joined ({_best(work)}); take photos "
            "that overlap by 60 to 80 % from different places, with texture and without blur"
        )
    report("mapping", count, count)
    ranked = sorted(models.values(), key=lambda model: -model.num_reg_images())
    groups = {
        image.name: model.num_reg_images()
        for model in ranked[1:]
        for image in model.images.values()
    }
    return ranked[0], groups


def matched_photos(work: Structure) -> dict[str, int]:
    """Each photo with features, and the most verified matches that it has with another one."""
    with pycolmap.Database.open(work.database) as database:
        names = {
            image.image_id: image.name
            for image in database.read_all_images()
            if database.exists_keypoints(image.image_id)
        }
        best = dict.fromkeys(names.values(), 0)
        pairs, counts = database.read_two_view_geometry_num_inliers()
    for pair, matches in zip(pairs, counts, strict=True):
        ids = pycolmap.pair_id_to_image_pair(pair) if isinstance(pair, int) else pair
        for number in ids:
            best[names[number]] = max(best[names[number]], int(matches))
    return best


def _best(work: Structure) -> str:
    most = max(matched_photos(work).values(), default=0)
    return f"the best pair has {most} common points" if most else "no pair has common points"
