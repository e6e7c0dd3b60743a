"""Makes a planned scene on disk: view by view, resumable, whole or not at all."""

import io
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float

from splatproof.base.errors import DataError, UsageError
from splatproof.base.files import remove_partial_files, write_bytes
from splatproof.base.locks import locked_folder
from splatproof.datasets import moving_masks as moving
from splatproof.datasets.colmap_library import pycolmap
from splatproof.datasets.depth_maps import depth_path
from splatproof.datasets.procedural import sfm
from splatproof.datasets.procedural.plan import Plan, Shot, content_hash
from splatproof.datasets.procedural.ray_images import Frame, take
from splatproof.datasets.scene_file import SceneFile, read_scene_file, write_scene_file
from splatproof.datasets.view_times import Moment, sky_path, write_moments
from splatproof.reference.types.camera import Camera

WORKERS = 2
"""Views made at a time; each is single-threaded, so that nothing waits for busy cores."""
CORNERS = ".corners"
"""Folder of what detectors find in each view; there while a scene is being made."""
Report = Callable[[int, int], None]
"""Told (steps done, steps in all); a view is made in one step and matched in another."""


def make_scene(plan: Plan, folder: Path, report: Report = lambda done, total: None) -> Path:
    """Make a plan's scene as a COLMAP scene folder with depth.

    Views go to a hidden folder beside `folder`, which a later call with the same plan continues;
    it takes its name when all is there. A second process waits for the first.

    Args:
        plan: What to make.
        folder: Must not exist, or be this very scene already.
        report: Told the progress; a stopped call loses the views that were in work, one a worker.

    Raises: UsageError if something else is in `folder`.
    """
    name = content_hash(plan.world, plan.settings, plan.seed)
    if folder.exists():
        return _this(folder, name)
    work = folder.with_name(f".{folder.name}.{name}.part")
    work.mkdir(parents=True, exist_ok=True)
    with locked_folder(work):
        if folder.exists():  # made by another process, whose folder `work` was
            with suppress(OSError):
                work.rmdir()  # one of our own, where it had ended before we made it
            return _this(folder, name)
        _make(plan, work, name, report)
        os.replace(work, folder)
    return folder


def _this(folder: Path, name: str) -> Path:
    """The folder. Raises: UsageError if it is not the scene of that name."""
    if _content(folder) == name:
        return folder
    raise UsageError(f"{folder}: exists and is not this scene; choose another folder")


def _make(plan: Plan, work: Path, name: str, report: Report) -> None:
    """Make what is not there yet of a plan's scene."""
    remove_partial_files(work)
    threads = torch.get_num_threads()
    try:
        _make_views(plan, work, report)
    finally:
        torch.set_num_threads(threads)
    if plan.extras is not None:
        plan.extras(work)
    done = len(plan.shots)

    def matched() -> None:
        nonlocal done
        done += 1
        report(done, 2 * len(plan.shots))

    base = None
    for group in sorted({shot.group for shot in plan.shots}):  # "" comes first
        shots = [shot for shot in plan.shots if shot.group == group]
        if base is None:
            found = _sparse(plan, work, group, shots, matched)
            sparse, base = found[0], found if group == "" else None
        else:
            depths = _depths(work / group, shots, matched)
            sparse = sfm.observed(*base, [shot.camera for shot in shots], depths)
        _write_model(work / group, shots, sparse)
        if plan.driven:
            moments = {shot.name: Moment(time=shot.time, sensor=shot.sensor) for shot in shots}
            write_moments(work / group, moments)
        _write_facts(plan, work / group, shots, name)
    if not (work / "scene.toml").exists():  # all views are in groups: the folder says what they are
        _write_facts(plan, work, plan.shots, name)
    shutil.rmtree(work / CORNERS, ignore_errors=True)


def _content(folder: Path) -> str:
    """Content hash of a made scene, "" for any other folder."""
    return read_scene_file(folder).facts.get("content", "") if folder.is_dir() else ""


def _make_views(plan: Plan, work: Path, report: Report) -> None:
    """Ray-cast the views that are not there yet."""
    groups = {shot.group for shot in plan.shots}
    own = {""} if "" in groups else groups
    """Groups that get points of their own."""

    def one(index: int) -> None:
        shot = plan.shots[index]
        stage = plan.stage(shot)
        frame = take(
            stage.caster, stage.lighting, shot.camera, samples=plan.samples,
            seed=plan.seed * 1_000_003 + index, exposure=stage.exposure, seeds=stage.object_seeds,
        )  # fmt: skip
        if shot.group in own:
            _write_corners(work, shot, _corners(plan, shot, frame))
        if plan.movable:
            _write_masks(plan, work, shot, frame)
        _write_frame(work / shot.group, shot.name, frame)

    missing = [i for i, shot in enumerate(plan.shots)
               if not depth_path(work / shot.group, shot.name).exists()]  # fmt: skip
    done = len(plan.shots) - len(missing)
    report(done, 2 * len(plan.shots))
    with ThreadPoolExecutor(WORKERS, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        futures = [pool.submit(one, index) for index in missing]
        try:
            for future in as_completed(futures):
                future.result()
                done += 1
                report(done, 2 * len(plan.shots))
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _corners(plan: Plan, shot: Shot, frame: Frame) -> sfm.Corners:
    """Corners of a view on things that stand still."""
    kinds = plan.kinds_of(shot.group)
    fixed = np.array([kind not in plan.movable and kind != "sky" for kind in kinds])
    # with the precision in which normals are kept
    kept = replace(frame, normal=frame.normal.astype(np.float16).astype(np.float32))
    return sfm.corners(shot.camera, kept, plan.features, fixed[frame.object])


def _corner_path(work: Path, shot: Shot) -> Path:
    return work / CORNERS / shot.group / f"{Path(shot.name).stem}.npz"


def _write_corners(work: Path, shot: Shot, found: sfm.Corners) -> None:
    """Keep a view's corners beside the views."""
    buffer = io.BytesIO()
    np.savez(buffer, **{field.name: getattr(found, field.name) for field in fields(found)})
    write_bytes(_corner_path(work, shot), buffer.getvalue())


def _read_corners(work: Path, shot: Shot) -> sfm.Corners:
    """What `_write_corners` wrote."""
    with np.load(_corner_path(work, shot), allow_pickle=False) as arrays:
        return sfm.Corners(**{field.name: arrays[field.name] for field in fields(sfm.Corners)})


def _depths(
    folder: Path, shots: Sequence[Shot], told: Callable[[], None]
) -> Iterator[Float[np.ndarray, "_ _"]]:
    """Depth of each view in turn; `told` is called after each."""
    for shot in shots:
        with np.load(depth_path(folder, shot.name), allow_pickle=False) as arrays:
            yield arrays["depth"]
        told()


def _write_frame(folder: Path, name: str, frame: Frame) -> None:
    """Write photos/<name> and depth/<stem>.npz (depth, normal, object), the latter last."""
    encoded, png = cv2.imencode(".png", cv2.cvtColor(frame.colour, cv2.COLOR_RGB2BGR))
    assert encoded
    write_bytes(folder / "photos" / name, png.tobytes())
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, depth=frame.depth, normal=frame.normal.astype(np.float16), object=frame.object
    )
    write_bytes(depth_path(folder, name), buffer.getvalue())


def _write_masks(plan: Plan, work: Path, shot: Shot, frame: Frame) -> None:
    """Write what a view sees through pixels' centres as PNGs, 255 there and 0 elsewhere.

    sky/<stem>.png, and moving/<kind>/<stem>.png for each kind of things that move.
    """
    kinds = np.array(plan.kinds_of(shot.group))[frame.object]
    scene = work / shot.group
    flags = {sky_path(scene, shot.name): frame.object == 0}
    for mask in moving.KINDS:
        movers = [kind for kind, shown in plan.movable.items() if shown == mask]
        path = scene / moving.FOLDER / mask / Path(shot.name).with_suffix(".png")
        flags[path] = np.isin(kinds, movers)
    for path, flag in flags.items():
        encoded, png = cv2.imencode(".png", np.where(flag, 255, 0).astype(np.uint8))
        assert encoded
        write_bytes(path, png.tobytes())


def read_frame(folder: Path, name: str) -> Frame:
    """Read a made view's picture and truth; normals have the precision of float16.

    Args:
        folder: The scene's folder, or that of a group of views inside it.
        name: Name of the photo.
    Raises: DataError if the photo cannot be read.
    """
    path = folder / "photos" / name
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise DataError(f"{path}: not a readable image; make the scene again")
    with np.load(depth_path(folder, name), allow_pickle=False) as arrays:
        return Frame(
            colour=cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), depth=arrays["depth"],
            normal=arrays["normal"].astype(np.float32), object=arrays["object"],
        )  # fmt: skip


def _sparse(
    plan: Plan, work: Path, group: str, shots: Sequence[Shot], told: Callable[[], None]
) -> tuple[sfm.Sparse, sfm.Corners]:
    """Imitated points of views, and the true places that they come from."""
    found = [_read_corners(work, shot) for shot in shots]
    places = sfm.merged(found, float(shots[0].camera.K[0, 0]))
    depths = _depths(work / group, shots, told)
    cameras = [shot.camera for shot in shots]
    sightings = [
        sfm.seen(places, camera, depth) for camera, depth in zip(cameras, depths, strict=True)
    ]
    return sfm.imitate(places, cameras, sightings, plan.seed), places


def _write_model(folder: Path, shots: Sequence[Shot], sparse: sfm.Sparse) -> None:
    """Write sparse/0 with true poses."""
    target = folder / "sparse" / "0"
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    cameras = [shot.camera for shot in shots]
    _colmap_model([shot.name for shot in shots], cameras, sparse).write_binary(target)


def _colmap_model(
    names: Sequence[str], cameras: Sequence[Camera], sparse: sfm.Sparse
) -> pycolmap.Reconstruction:
    """The COLMAP model of pinhole views and points; views of equal intrinsics share a camera."""
    model = pycolmap.Reconstruction()
    kinds: dict[tuple, int] = {}
    order = np.argsort(sparse.view, kind="stable")
    starts = np.searchsorted(sparse.view[order], np.arange(len(cameras) + 1))
    place = np.empty(len(order), dtype=int)
    for index, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        K = camera.K.numpy()
        key = (camera.width, camera.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        if key not in kinds:
            kinds[key] = len(kinds) + 1
            made = pycolmap.Camera(model="PINHOLE", width=key[0], height=key[1],
                                   params=list(key[2:]), camera_id=kinds[key])  # fmt: skip
            model.add_camera_with_trivial_rig(made)
        mine = order[starts[index] : starts[index + 1]]
        place[mine] = np.arange(len(mine))
        pose = camera.world_to_camera.numpy()
        image = pycolmap.Image(
            name=name, camera_id=kinds[key], image_id=index + 1, keypoints=sparse.pixel[mine]
        )
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    ends = np.searchsorted(sparse.point, np.arange(len(sparse.positions) + 1))
    for point in range(len(sparse.positions)):
        rows = range(ends[point], ends[point + 1])
        track = pycolmap.Track(
            [pycolmap.TrackElement(int(sparse.view[r]) + 1, int(place[r])) for r in rows]
        )
        identity = model.add_point3D(sparse.positions[point], track, sparse.colours[point])
        model.points3D[identity].error = float(sparse.errors[point])
    return model


def _write_facts(plan: Plan, folder: Path, shots: Sequence[Shot], name: str) -> None:
    """Write scene.toml."""
    camera = shots[0].camera
    chosen = {f"world_{key}": str(value) for key, value in plan.settings.items()}
    facts = {
        "made_by": "splatproof",
        "world": plan.world,
        "seed": str(plan.seed),
        "content": name,
        "camera": f"pinhole {camera.width} x {camera.height}, focal {float(camera.K[0, 0]):g} px",
        "truth": "ray-cast; depth/*.npz: depth (z, metres), normal (world), object (id)",
        "objects": ",".join(plan.kinds_of(shots[0].group)),
    }
    file = SceneFile(units="metres", up=(0.0, 0.0, 1.0), facts=facts | chosen | dict(plan.facts))
    write_scene_file(folder, file)
