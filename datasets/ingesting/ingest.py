"""Photos in, scene folder out: photos/, sparse/0/ and scene.toml; killed runs go on."""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatproof.base.errors import DataError
from splatproof.base.files import write_text
from splatproof.base.locks import locked
from splatproof.datasets.colmap_library import pycolmap
from splatproof.datasets.ingesting import structure
from splatproof.datasets.ingesting.alignment import Alignment, align, local_metres
from splatproof.datasets.ingesting.structure import Report, Structure
from splatproof.datasets.ingesting.survey import Photo, Survey, survey_photos
from splatproof.datasets.ingesting.upright import copy_upright
from splatproof.datasets.scene_file import SceneFile, write_scene_file

_FEW_MATCHES = 30
"""COLMAP's mapper wants this many inliers to place a photo (abs_pose_min_num_inliers)."""


@dataclass(frozen=True, kw_only=True)
class Ingested:
    """What became of the photos."""

    folder: Path
    registered: int
    scene: SceneFile


def ingest_photos(
    photos: Path,
    out: Path,
    *,
    max_image_size: int,
    threads: int,
    seed: int,
    report: Report,
    say: Callable[[str], None],
) -> Ingested:
    """Make a scene folder from photos.

    While it works, everything is in a hidden folder beside `out`; a killed run that is started
    again with the same photos and settings goes on there. Mapping, the last step, starts anew.

    Args:
        photos: Folder of JPEG, PNG and TIFF photos; only read.
        out: Scene folder to make; must not exist.
        max_image_size: Longest side in pixels at which features are looked for.
        threads: CPU threads.
        seed: Starts everything that draws random numbers; equal seeds give equal scenes.
        report: Told (step, done, total) as work goes on.
        say: Told, one line each, what a person should know.

    Raises: DataError if the photos cannot become a scene; then nothing is left behind; UsageError
        while another process makes the same folder.
    """
    if max_image_size < 100 or threads < 1:
        raise DataError(
            f"max image size {max_image_size}, threads {threads}: expected at least 100 and 1"
        )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(
            f"{out}: cannot be made here ({error.strerror}); choose another folder"
        ) from None
    work = out.parent / f".{out.name}.ingest"
    with _alone(out, work.with_name(f"{work.name}.lock")):
        if out.exists():
            shutil.rmtree(work, ignore_errors=True)  # finished, killed before it could tidy up
            raise DataError(f"{out}: exists already; choose another folder or remove it")
        pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
        try:
            survey = survey_photos(photos, lambda done, total: report("reading", done, total))
            settings = {
                "max_image_size": max_image_size,
                "seed": seed,
                "pycolmap": pycolmap.__version__,
            }
            if _prepare(work, survey, settings):
                say(f"going on with the unfinished work in {work}")
            _tell(survey, say)
            result = _work(work, survey, Structure(
                database=work / "database.db",
                given=photos,
                photos=work / "scene/photos",
                max_image_size=max_image_size,
                threads=threads,
                seed=seed,
            ), report)  # fmt: skip
            os.replace(work / "scene", out)
        except DataError:
            shutil.rmtree(work, ignore_errors=True)
            raise
        shutil.rmtree(work)
    return Ingested(folder=out, registered=result[0], scene=result[1])


@contextmanager
def _alone(out: Path, lock: Path) -> Iterator[None]:
    """Be the only process that makes the scene; the lock file is gone afterwards, but for a kill."""
    busy = (
        f"{out}: another `bench ingest` is making it; wait for it to end, or choose another folder"
    )
    with locked(lock, busy=busy):
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def _prepare(work: Path, survey: Survey, settings: Mapping[str, object]) -> bool:
    """Make the working folder, or keep that of an equal job; whether it was kept."""
    files = {
        photo.name: [str(photo.path.resolve()), *_stamp(photo.path)] for photo in survey.photos
    }
    job = json.dumps({"settings": settings, "photos": files}, sort_keys=True)
    known = work / "job.json"
    if known.exists() and known.read_text() == job:
        return True
    shutil.rmtree(work, ignore_errors=True)
    for photo in survey.photos:
        copy = work / "scene/photos" / photo.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        # a link would let an edit of the scene reach the user's photos
        copy_upright(photo.path, copy)
    write_text(known, job)
    return False


def _stamp(path: Path) -> tuple[int, int]:
    stat = path.stat()
    return stat.st_size, stat.st_mtime_ns


def _tell(survey: Survey, say: Callable[[str], None]) -> None:
    for name, reason in survey.unreadable.items():
        say(f"{name}: left out: {reason}")
    if turned := sum(photo.turned for photo in survey.photos):
        say(
            f"{turned} of {len(survey.photos)} photos turned as their EXIF says, in the scene's copies"
        )
    if len(survey.lenses) > 1:
        kinds = "; ".join(
            f"{sum(photo.lens == lens for photo in survey.photos)} of {lens[0]} x {lens[1]} "
            f"({lens[2] or 'no EXIF'})"
            for lens in survey.lenses
        )
        say(f"photos of {len(survey.lenses)} cameras, one camera model each: {kinds}")


def _work(work: Path, survey: Survey, how: Structure, report: Report) -> tuple[int, SceneFile]:
    """Run the steps and write work/scene; returns the number of registered photos and the facts."""
    structure.extract(how, survey.photos, report)
    pairs, rule = structure.choose_pairs(how, survey.photos)
    structure.match(how, pairs, report)
    model, groups = structure.reconstruct(how, len(survey.photos), report)
    placed = {image.name for image in model.images.values() if image.has_pose}
    left_out = dict(survey.unreadable)
    best = structure.matched_photos(how)
    for photo in survey.photos:
        if photo.name not in placed:
            left_out[photo.name] = _reason(photo.name, groups, best)
    facts = {
        "made_by": f"bench ingest with pycolmap {pycolmap.__version__}",
        "pairs": f"{len(pairs)} ({rule})",
        "registered": f"{len(placed)} of {len(survey.photos) + len(survey.unreadable)}",
        "cameras": str(len(survey.lenses)),
        "turned": str(sum(photo.turned for photo in survey.photos)),
        "max_image_size": str(how.max_image_size),
        "seed": str(how.seed),
        "reprojection_error_px": f"{model.compute_mean_reprojection_error():.4f}",
    }
    aligned = _align(model, survey.photos, how.seed, facts)
    sparse = work / "scene/sparse/0"
    shutil.rmtree(sparse, ignore_errors=True)
    sparse.mkdir(parents=True)
    model.write_binary(sparse)
    scene = SceneFile(
        units="metres" if aligned else "sfm",
        up=(0.0, 0.0, 1.0) if aligned else None,
        left_out=left_out,
        facts=facts,
    )
    write_scene_file(work / "scene", scene)
    return len(placed), scene


def _reason(name: str, groups: dict[str, int], best: dict[str, int]) -> str:
    """Why a readable photo is not in the model."""
    if name in groups:
        return f"is in a group of {groups[name]} photos that does not join the others; add photos between"
    if name not in best:
        return "no features found; is it blank or blurred?"
    if best[name] < _FEW_MATCHES:
        return (
            f"shares at most {best[name]} points with any other photo, about {_FEW_MATCHES} are "
            "needed; it overlaps too little or is blurred"
        )
    return f"shares {best[name]} points with another photo but its position does not fit them"


def _align(
    model: pycolmap.Reconstruction, photos: Sequence[Photo], seed: int, facts: dict[str, str]
) -> bool:
    """Move the model to metres if GPS allows; what was done, or why not, goes into the facts."""
    images = {image.name: image for image in model.images.values() if image.has_pose}
    known = [(photo, photo.gps) for photo in photos if photo.gps is not None]
    if not known:
        facts["gps"] = "none of the photos has a position"
        return False
    metres, origin = local_metres(np.array([gps for _, gps in known]))
    rows = [i for i, (photo, _) in enumerate(known) if photo.name in images]
    poses = [images[known[i][0].name].cam_from_world() for i in rows]
    rotations = np.array([pose.rotation.matrix() for pose in poses]).reshape(-1, 3, 3)
    centres = np.array([pose.inverse().translation for pose in poses]).reshape(-1, 3)
    found = align(rotations, centres, metres[rows], seed)
    if not isinstance(found, Alignment):
        facts["gps"] = f"not used: {found}"
        return False
    model.transform(found.transform)
    facts["gps"] = f"{found.how} of {len(rows)} photos"
    facts["gps_origin"] = (
        f"latitude {origin[0]:.8f} longitude {origin[1]:.8f} altitude {origin[2]:.3f}"
    )
    facts["gps_residual_median_m"] = f"{np.median(found.residuals):.3f}"
    facts["gps_residual_max_m"] = f"{found.residuals.max():.3f}"
    return True
