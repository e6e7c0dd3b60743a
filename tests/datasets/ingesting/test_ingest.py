"""`ingest_photos` on self-made photos of known places, and every way photos can be unfit."""

import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from helpers.aerial_photos import (
    PLACES,
    aerial_photo,
    save_photo,
    texture,
    write_flight,
)
from helpers.real_scenes import real_scene
from splatproof.base import folders
from splatproof.base.errors import DataError, MissingError, UsageError
from splatproof.base.locks import locked
from splatproof.cli.ingest import ingest
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.ingesting.ingest import Ingested, ingest_photos
from splatproof.datasets.ingesting.structure import Structure, extract
from splatproof.datasets.ingesting.survey import survey_photos
from splatproof.reference.types.camera import project_points
from splatproof.reference.types.protocol import Protocol

PROTOCOL = Protocol(name="test", source="test", hold=3)


def run(photos: Path, out: Path, said: list[str] | None = None, **changes) -> Ingested:
    settings = {"max_image_size": 1600, "threads": 2, "seed": 0} | changes
    return ingest_photos(
        photos,
        out,
        report=lambda step, done, total: None,
        say=(said if said is not None else []).append,
        **settings,
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> tuple[Ingested, list[str]]:
    """A flight with everything that a real one has: damaged, foreign and differently sized photos."""
    root = tmp_path_factory.mktemp("flown")
    photos = write_flight(root / "photos", size=(320, 240))
    other = aerial_photo(texture(0), 4.0, -2.0, (240, 180))
    save_photo(photos / "small one.jpg", other, (4.0, -2.0, 40.0))
    save_photo(photos / "elsewhere.jpg", aerial_photo(texture(9), 0, 0, (320, 240)), (2, 3, 40.0))
    Image.new("RGB", (320, 240), (90, 120, 90)).save(photos / "blank.png")
    whole = (photos / "air_0.jpg").read_bytes()
    (photos / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    save_photo(
        photos / "tagged.tif", aerial_photo(texture(0), 2.0, -3.0, (320, 240)), (2, -3, 40.0)
    )
    (photos / "phone 1.HEIC").write_bytes(b"what only other programs read")
    (photos / "notes.txt").write_text("not a photo")
    said: list[str] = []
    return run(photos, root / "scene", said), said


def test_the_scene_opens_and_is_metric(flown):
    made, _ = flown
    scene = open_scene(made.folder, PROTOCOL)
    places = {f"air_{i}.jpg": place for i, place in enumerate(PLACES)}
    assert [view.name for view in scene.views] == [*sorted(places), "small_one.jpg", "tagged.tif"]
    assert scene.units == "metres"
    assert scene.up.tolist() == [0, 0, 1]
    for axis, name in ((0, "east"), (1, "north")):
        found = np.array([float(view.camera.centre[axis]) for view in scene.views[:6]])
        expected = np.array([places[view.name][axis] for view in scene.views[:6]])
        # EXIF keeps 1e-6 seconds = 3e-5 m; what is left is the reconstruction's own error
        assert np.abs((found - found[0]) - (expected - expected[0])).max() < 0.1, name
    assert {view.sensor for view in scene.views} == {"camera 1", "camera 3"}  # 2: the blank one
    points, depth = project_points(scene.views[4].camera, scene.points.positions)
    assert len(points) > 500
    assert (depth > 0).all()


def test_every_photo_is_accounted_for(flown):
    made, said = flown
    reasons = made.scene.left_out
    assert set(reasons) == {"blank.png", "cut.jpg", "elsewhere.jpg", "phone 1.HEIC"}
    assert "no features found" in reasons["blank.png"] or "at most 0 points" in reasons["blank.png"]
    assert "not a readable image" in reasons["cut.jpg"]
    assert "shares at most" in reasons["elsewhere.jpg"]
    assert reasons["phone 1.HEIC"] == ".heic is not read; convert it to JPEG or PNG"
    assert made.registered == 8
    assert made.scene.facts["registered"] == "8 of 12"
    assert dict(open_scene(made.folder, PROTOCOL).left_out) == reasons
    assert any(line.startswith("cut.jpg: left out: not a readable") for line in said)
    assert any("photos of 3 cameras, one camera model each: 1 of 240 x 180" in x for x in said)


def test_the_scenes_photos_are_copies_so_that_edits_never_reach_the_users_own(flown):
    folder = flown[0].folder
    own = {photo.stat().st_ino for photo in (folder.parent / "photos").iterdir()}
    assert not own & {photo.stat().st_ino for photo in (folder / "photos").iterdir()}


def test_the_command_names_the_one_that_comes_next(flown, tmp_path, monkeypatch, capfd):
    made = replace(flown[0], folder=tmp_path / "my scene")
    monkeypatch.setattr(f"{ingest_photos.__module__}.ingest_photos", lambda *args, **named: made)
    assert ingest(tmp_path, tmp_path / "my scene") == 0
    command = capfd.readouterr().err.splitlines()[-1]
    assert command == f"next: bench fit auto '{tmp_path / 'my scene'}' --out MODEL --seconds 60"


def test_nothing_but_the_scene_is_left(flown):
    made, _ = flown
    assert [path.name for path in made.folder.parent.iterdir() if path.name.startswith(".")] == []
    assert sorted(path.name for path in made.folder.iterdir()) == ["photos", "scene.toml", "sparse"]


def blank(folder: Path, count: int = 1, suffix: str = ".jpg") -> Path:
    folder.mkdir(parents=True)
    for i in range(count):
        Image.new("RGB", (64, 48), (i, 100, 200)).save(folder / f"flat_{i}{suffix}")
    return folder


def nothing(folder: Path) -> Path:
    folder.mkdir()
    (folder / "readme.txt").write_text("no photos")
    return folder


def damaged(folder: Path) -> Path:
    blank(folder, 3)
    for path in list(folder.iterdir())[1:]:
        path.write_bytes(b"no image")
    return folder


def foreign(folder: Path) -> Path:
    """Photos of a telephone."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(3):
        (folder / f"IMG_{i}.HEIC").write_bytes(b"what only other programs read")
    return folder


def deep(folder: Path) -> Path:
    folder.mkdir()
    for i in range(3):
        Image.new("I;16", (64, 48)).save(folder / f"deep_{i}.png")
    return folder


def twins(folder: Path) -> Path:
    blank(folder, 2)
    (folder / "flat_0.jpg").rename(folder / "a b.jpg")
    (folder / "flat_1.jpg").rename(folder / "a_b.jpg")
    return folder


def unrelated(folder: Path) -> Path:
    for i in range(2):
        save_photo(folder / f"p{i}.jpg", aerial_photo(texture(20 + i), 0, 0, (320, 240)))
    return folder


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda folder: folder, "no such folder; give the folder that has the photos"),
        (nothing, r"no photo found; looked for \.jpg, \.jpeg, \.png"),
        (foreign, r"no photo found; .*; IMG_0.HEIC and 2 more are not read; convert them to JPEG"),
        (
            lambda folder: foreign(blank(folder)),
            r"only one photo can be used \(IMG_0.HEIC and 2 more are not read; .* PNG\); structure",
        ),
        (blank, "only one photo can be used; structure from motion needs at least two"),
        (damaged, r"1 of 3 photos can be used \(flat_\d.jpg is damaged\)"),
        (deep, "0 of 3 photos can be used"),
        (twins, "its name becomes 'a_b.jpg', which another photo has"),
        (lambda folder: blank(folder, 3), "no two of 3 photos could be joined .no pair has common"),
        (unrelated, "no two of 2 photos could be joined .*; take photos that overlap by 60 to 80"),
    ],
    ids=[
        "no folder",
        "no photo",
        "HEIC",
        "one and HEIC",
        "one",
        "damaged",
        "16 bit",
        "twins",
        "blank",
        "unrelated",
    ],
)
def test_unfit_photos_are_refused_in_one_line_and_leave_nothing(tmp_path, capfd, make, fault):
    photos = make(tmp_path / "photos")
    with pytest.raises(DataError, match=fault) as caught:
        run(photos, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(photos))
    assert {path.name for path in tmp_path.iterdir()} <= {"photos"}
    assert capfd.readouterr().out == ""  # COLMAP writes into the process's own streams


def test_an_existing_folder_is_not_touched(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("keep")
    with pytest.raises(DataError, match="out: exists already; choose another folder or remove it"):
        run(blank(tmp_path / "photos", 2), out)
    assert (out / "mine").read_text() == "keep"


def test_two_processes_do_not_make_the_same_scene(tmp_path):
    """The second emptied the first one's folder, or wrote into its database, where COLMAP aborts."""
    out, work = tmp_path / "out", tmp_path / ".out.ingest"
    photos = blank(tmp_path / "photos", 2)
    work.mkdir()
    (work / "job.json").write_text("another's")
    with (
        locked(tmp_path / ".out.ingest.lock"),
        pytest.raises(UsageError, match="out: another `bench ingest` is making it; wait"),
    ):
        run(photos, out)
    assert (work / "job.json").read_text() == "another's"
    with pytest.raises(DataError, match="no two of 2 photos could be joined"):
        run(photos, out)
    assert {path.name for path in tmp_path.iterdir()} == {"photos"}


def test_a_full_disk_is_told_before_native_code_ends_the_process(tmp_path, monkeypatch):
    monkeypatch.setattr(folders, "RESERVE", 2**62)
    with pytest.raises(MissingError, match="MB are free.*; the same command continues where it"):
        run(blank(tmp_path / "photos", 2), tmp_path / "out")
    assert (tmp_path / ".out.ingest/job.json").exists()
    said: list[str] = []
    monkeypatch.undo()
    with pytest.raises(DataError, match="no two of 2 photos could be joined"):
        run(tmp_path / "photos", tmp_path / "out", said)
    assert said[0].startswith("going on with the unfinished work")


def test_an_impossible_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DataError, match="cannot be made here .*; choose another folder"):
        run(blank(tmp_path / "photos", 2), tmp_path / "file/out")


@pytest.mark.parametrize("changes", [{"max_image_size": 10}, {"threads": 0}])
def test_senseless_settings_are_refused(tmp_path, changes):
    with pytest.raises(DataError, match="expected at least 100 and 1"):
        run(blank(tmp_path / "photos", 2), tmp_path / "out", **changes)


def pose_table(folder: Path) -> dict[str, np.ndarray]:
    model = pycolmap.Reconstruction(folder / "sparse/0")
    return {image.name: image.cam_from_world().matrix() for image in model.images.values()}


def test_photos_have_numbers_by_name_before_their_features(tmp_path):
    """With several threads features are found in any order, and a scene depends on the numbers."""
    folder = write_flight(tmp_path / "photos", size=(120, 90))
    photos = survey_photos(folder, lambda done, total: None).photos
    work = Structure(
        database=tmp_path / "database.db", given=folder, photos=folder, max_image_size=1600,
        threads=2, seed=0,
    )  # fmt: skip
    seen = []

    def look(step: str, done: int, total: int) -> None:
        with pycolmap.Database.open(work.database) as database:
            seen.append({image.image_id: image.name for image in database.read_all_images()})

    extract(work, photos, look)
    assert seen == [dict(enumerate(sorted(photo.name for photo in photos), start=1))] * 2


@pytest.mark.slow
def test_one_seed_one_scene_whatever_the_threads(tmp_path):
    photos = write_flight(tmp_path / "photos", gps=False)
    first = run(photos, tmp_path / "a")
    second = run(photos, tmp_path / "b", threads=1)
    assert first.scene == second.scene
    assert first.scene.units == "sfm"
    assert first.scene.facts["gps"] == "none of the photos has a position"
    one, two = pose_table(first.folder), pose_table(second.folder)
    assert all(np.array_equal(one[name], two[name]) for name in one)


@pytest.mark.slow
@pytest.mark.real
def test_brighton_beach(tmp_path, capfd):
    photos = real_scene("brighton_beach") / "photos"
    start = time.process_time()
    assert ingest(photos, tmp_path / "scene", threads=2) == 0
    seconds = time.process_time() - start
    out, err = capfd.readouterr()
    next_one = f"bench fit auto {tmp_path / 'scene'} --out MODEL --seconds 60"
    assert err.splitlines()[-1] == f"next: {next_one}"
    assert out.splitlines() == [
        f"{tmp_path / 'scene'}: 18 of 18 photos registered, units: metres",
        "GPS: positions and altitudes of 18 photos",
    ]
    scene = open_scene(tmp_path / "scene", Protocol(name="test", source="test", width=250))
    assert len(scene.points) > 3500
    forward = [float(view.camera.rotation[2, 2]) for view in scene.views]
    assert max(forward) < -0.99  # nadir photos look down
    shipped = pose_table(real_scene("brighton_beach"))
    ours = pose_table(tmp_path / "scene")
    a, b = (
        np.stack([-table[name][:, :3].T @ table[name][:, 3] for name in sorted(shipped)])
        for table in (shipped, ours)
    )
    similarity = pycolmap.estimate_sim3d(a, b)
    assert similarity is not None
    moved = np.array([similarity * centre for centre in a])
    assert np.abs(moved - b).max() < 0.2  # metres, over a flight of 90 m
    assert seconds < 120  # of CPU: a minute on two cores, however busy the machine is
    shutil.rmtree(tmp_path / "scene")
