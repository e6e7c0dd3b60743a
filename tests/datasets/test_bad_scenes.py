"""Every broken scene gives one line that names the file and the fault; nothing hangs or aborts."""

import dataclasses
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from helpers.colmap_scenes import Flight, view_name, write_scene
from splatproof.base.errors import SplatproofError
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.datasets.photos import check_photo, read_photo
from splatproof.reference.types.protocol import Protocol

FLIGHT = Flight(views=3, points=30)
MODEL = "sparse/0"


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("good")
    return {
        "bin": write_scene(root / "bin", FLIGHT),
        "txt": write_scene(root / "txt", FLIGHT, text=True),
        "old": write_scene(root / "old", FLIGHT, rigs=False),
    }


def cut(name: str, size: int) -> Callable[[Path], None]:
    """Keep only the first bytes (negative: all but the last)."""

    def edit(scene: Path) -> None:
        path = scene / MODEL / name
        path.write_bytes(path.read_bytes()[:size])

    return edit


def patch(name: str, offset: int, layout: str, *values: float) -> Callable[[Path], None]:
    def edit(scene: Path) -> None:
        path = scene / MODEL / name
        data = bytearray(path.read_bytes())
        struct.pack_into(layout, data, offset, *values)
        path.write_bytes(data)

    return edit


def append(name: str, more: bytes) -> Callable[[Path], None]:
    def edit(scene: Path) -> None:
        with (scene / MODEL / name).open("ab") as file:
            file.write(more)

    return edit


def swap(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(scene: Path) -> None:
        path = scene / MODEL / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return edit


def write(name: str, content: str | bytes) -> Callable[[Path], None]:
    def edit(scene: Path) -> None:
        (scene / name).write_bytes(content if isinstance(content, bytes) else content.encode())

    return edit


def remove(name: str) -> Callable[[Path], None]:
    def edit(scene: Path) -> None:
        path = scene / name
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()

    return edit


def remodel(change: Callable[[pycolmap.Reconstruction], object]) -> Callable[[Path], None]:
    """Write the model again after a change through COLMAP."""

    def edit(scene: Path) -> None:
        model = pycolmap.Reconstruction(scene / MODEL)
        change(model)
        model.write_binary(scene / MODEL)

    return edit


def empty(scene: Path) -> None:
    shutil.rmtree(scene)
    scene.mkdir()


def no_points(model: pycolmap.Reconstruction) -> None:
    for number in list(model.points3D):
        model.delete_point3D(number)


def unregister(model: pycolmap.Reconstruction) -> None:
    for number in list(model.reg_frame_ids()):
        model.deregister_frame(number)


def same_names(model: pycolmap.Reconstruction) -> None:
    model.image(2).name = model.image(1).name


def resized_photo(scene: Path) -> None:
    Image.new("RGB", (96, 70)).save(scene / "photos" / view_name(1))


RULES = Protocol(name="rules", source="test", hold=2)
POINT_TRACK = 8 + 8 + 24 + 3 + 8 + 8
"""Offset of the first track element in points3D.bin."""
BAD: list[tuple[str, str, Callable[[Path], None], str]] = [
    (
        "cameras empty",
        "bin",
        cut("cameras.bin", 0),
        r"cameras.bin: ends at byte 0 inside its header",
    ),
    ("cameras header", "bin", cut("cameras.bin", 5), r"cameras.bin: ends at byte 5"),
    ("cameras cut", "bin", cut("cameras.bin", -3), r"cameras.bin: ends .* inside camera 1 of 1"),
    ("cameras long", "bin", append("cameras.bin", b"abc"), r"cameras.bin: 3 bytes are left behind"),
    (
        "huge count",
        "bin",
        patch("cameras.bin", 0, "<Q", 2**60),
        r"cameras.bin: .* camera 2 of 1152",
    ),
    (
        "model id",
        "bin",
        patch("cameras.bin", 12, "<i", 99),
        r"cameras.bin: unknown camera model 99",
    ),
    ("images cut", "bin", cut("images.bin", -7), r"images.bin: ends .* inside image 3 of 3"),
    (
        "images name",
        "bin",
        cut("images.bin", 8 + 64 + 3),
        r"images.bin: ends .* inside image 1 of 3",
    ),
    ("images count", "bin", patch("images.bin", 0, "<Q", 4), r"images.bin: .* image 4 of 4"),
    ("points cut", "bin", cut("points3D.bin", -1), r"points3D.bin: ends .* inside point"),
    ("points empty", "bin", cut("points3D.bin", 0), r"points3D.bin: ends at byte 0"),
    (
        "huge track",
        "bin",
        patch("points3D.bin", POINT_TRACK - 8, "<Q", 2**61),
        r"points3D.bin: ends .* inside point 1",
    ),
    ("rigs cut", "bin", cut("rigs.bin", -2), r"rigs.bin: ends .* inside rig 1 of 1"),
    ("frames cut", "bin", cut("frames.bin", 30), r"frames.bin: ends .* inside frame 1 of 3"),
    ("frames gone", "bin", remove(f"{MODEL}/frames.bin"), r"rigs.bin without its partner"),
    ("frame's rig", "bin", patch("frames.bin", 12, "<I", 5), r"COLMAP cannot read this model"),
    ("cameras gone", "bin", remove(f"{MODEL}/cameras.bin"), r"cameras.bin: missing"),
    ("points gone", "txt", remove(f"{MODEL}/points3D.txt"), r"points3D.txt: missing"),
    (
        "image's camera",
        "old",
        patch("images.bin", 8 + 4 + 56, "<I", 7),
        r"images.bin: image 'photo_00\d.png' has camera 7, which cameras.bin lacks; there are \[1\]",
    ),
    (
        "track's image",
        "bin",
        patch("points3D.bin", POINT_TRACK, "<I", 999),
        r"points3D.bin: the track of point \d+ has image 999, which images.bin lacks",
    ),
    (
        "track's 2D point",
        "bin",
        patch("points3D.bin", POINT_TRACK + 4, "<I", 12345),
        r"points3D.bin: the track of point \d+ has 2D point 12345 of image \d, which has only",
    ),
    (
        "double image id",
        "old",
        patch("images.bin", 8, "<I", 2),
        r"images.bin: id 2 occurs more than once",
    ),
    ("double name", "bin", remodel(same_names), r"images.bin: image name 'photo_000.png' occurs"),
    ("no points", "bin", remodel(no_points), r"points3D.bin: has no points"),
    ("none registered", "bin", remodel(unregister), r"images.bin: none of 0 images has a pose"),
    (
        "NaN pose",
        "old",
        patch("images.bin", 8 + 4, "<d", np.nan),
        r"pose of image .* length nan",
    ),
    (
        "NaN frame",
        "bin",
        patch("frames.bin", 8 + 8 + 32, "<d", np.nan),
        r"pose of image .* translation .nan",
    ),
    (
        "zero rotation",
        "bin",
        patch("frames.bin", 16, "<4d", 0, 0, 0, 0),
        r"pose of image .* length 0 ",
    ),
    (
        "NaN focal",
        "bin",
        patch("cameras.bin", 32, "<d", np.nan),
        r"cameras.bin: camera 1 has param",
    ),
    (
        "negative focal",
        "bin",
        patch("cameras.bin", 32, "<d", -70),
        r"cameras.bin: camera 1 has param",
    ),
    (
        "inf point",
        "bin",
        patch("points3D.bin", 16, "<d", np.inf),
        r"points3D.bin: point \d+ is not",
    ),
    (
        "folding lens",
        "bin",
        patch("cameras.bin", 56, "<d", -5.0),
        r"photo_000.png: .*(folds|rectangle)",
    ),
    (
        "text model name",
        "txt",
        swap("cameras.txt", "SIMPLE_RADIAL", "MAGIC"),
        r"cameras.txt: unknown camera model 'MAGIC'; known are SIMPLE_PINHOLE",
    ),
    (
        "text parameters",
        "txt",
        swap("cameras.txt", " 48 36", " 48"),
        r"cameras.txt: line 4: SIMPLE_RADIAL has 4 parameters, found 3",
    ),
    (
        "text garbage",
        "txt",
        write(f"{MODEL}/images.txt", "hello world\nfoo bar\n"),
        r"images.txt: line 1: has 2 fields, expected IMAGE_ID",
    ),
    (
        "text number",
        "txt",
        swap("images.txt", "1 photo_000.png", "one photo_000.png"),
        r"images.txt: line \d: found 'one' instead of a whole number",
    ),
    (
        "binary as text",
        "txt",
        write(f"{MODEL}/points3D.txt", bytes(range(256))),
        r"points3D.txt: is not text",
    ),
    (
        "text point",
        "txt",
        write(f"{MODEL}/points3D.txt", "1 2 x 3 4 5 6 7\n"),
        r"line 1: found 'x'",
    ),
    (
        "text track",
        "txt",
        write(f"{MODEL}/points3D.txt", "1 0 0 0 4 5 6 7 1\n"),
        r"line 1: the track",
    ),
    ("text frames", "txt", write(f"{MODEL}/frames.txt", "1 1 0.5\n"), r"frames.txt: line 1: has 3"),
    ("text images odd", "txt", append("images.txt", b"9 1 0 0 0 0 0 0 1 x.png"), r"expected two"),
    (
        "photo is text",
        "bin",
        write(f"photos/{view_name(1)}", "no image"),
        r"photo_001.png: not a read",
    ),
    ("photo's size", "bin", resized_photo, r"photo_001.png: photo is 96 x 70, .* says 96 x 72"),
    ("photos gone", "bin", remove("photos"), r"no photos; looked for the folder photos or images"),
    ("no model", "bin", remove(MODEL), r"no COLMAP model; looked for"),
    ("empty folder", "bin", empty, r"no scene found here; looked for colmap: .*bench ingest"),
    ("scene file", "bin", write("scene.toml", "units = "), r"scene.toml: not a TOML file"),
    (
        "scene units",
        "bin",
        write("scene.toml", "units = 'feet'"),
        r"scene.toml: units: .*found 'feet'",
    ),
    (
        "scene up",
        "bin",
        write("scene.toml", "up = [0, 0, 2]"),
        r"scene.toml: up is \[0.0, 0.0, 2.0\]",
    ),
    ("scene field", "bin", write("scene.toml", "color = 1"), r"scene.toml: unknown 'color'"),
    (
        "scene table",
        "bin",
        write("scene.toml", "[facts]\na = 1"),
        r"facts.a: .*string, found 1",
    ),
]


@pytest.mark.parametrize(
    ("kind", "edit", "fault"), [case[1:] for case in BAD], ids=[case[0] for case in BAD]
)
def test_a_broken_scene_is_refused_in_one_line(good, tmp_path, kind, edit, fault):
    scene = tmp_path / "scene"
    shutil.copytree(good[kind], scene)
    edit(scene)
    with pytest.raises(SplatproofError, match=fault) as caught:
        open_scene(scene, RULES)
    assert "\n" not in str(caught.value)
    assert "scene" in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("kind", ["bin", "txt", "old"])
def test_the_unbroken_scene_opens(good, kind):
    scene = open_scene(good[kind], RULES)
    assert [view.load().shape[2] for view in scene.views] == [3, 3, 3]


@pytest.mark.parametrize(
    ("rules", "fault"),
    [
        ({"width": 500}, r"photo_000.png: protocol rules: asks for 500 x .* never enlarged"),
        ({"factor": 0.5}, r"factor is 0.5"),
        ({"hold": 1}, r"bin.*: protocol rules: hold 1 leaves none of 3 views for training"),
        ({"hold": -1}, r"hold is -1"),
        ({"test_names": ("photo_9.png",)}, r"'photo_9.png' is not among the 3 .*photo_00"),
        ({"images": "images_4"}, r"looked for the folder images_4 \(protocol rules\)"),
    ],
)
def test_a_protocol_that_does_not_fit_is_refused(good, rules, fault):
    with pytest.raises(SplatproofError, match=fault):
        open_scene(good["bin"], dataclasses.replace(RULES, **rules))


def test_a_prescaled_folder_of_another_size_is_refused(good, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(good["bin"], scene)
    shutil.copytree(scene / "photos", scene / "images_2")  # full-size photos under that name
    shutil.copytree(scene / "photos", scene / "thirds")
    Image.new("RGB", (32, 24)).save(scene / "thirds" / view_name(0))
    for path in (scene / "images_2").iterdir():
        Image.new("RGB", (30, 36)).save(path)
    for name in ("images_2", "thirds"):
        with pytest.raises(SplatproofError, match=rf"{name}/photo_000.png: photo is 3"):
            open_scene(scene, dataclasses.replace(RULES, images=name))


def test_a_photo_that_breaks_after_opening_is_named_when_it_is_loaded(good, tmp_path):
    scene = tmp_path / "scene"
    shutil.copytree(good["bin"], scene)
    view = open_scene(scene, RULES).views[0]
    path = scene / "photos" / view.name
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SplatproofError, match=r"photo_000.png: not a readable image"):
        view.load()
    Image.new("RGB", (10, 10)).save(path)
    with pytest.raises(SplatproofError, match=r"photo is 10 x 10, its camera says 96 x 72"):
        view.load()


@pytest.mark.parametrize(
    ("mode", "fault"),
    [("RGBA", "transparent"), ("I;16", "expected 8-bit"), ("F", "expected 8-bit")],
)
def test_photos_that_are_not_8_bit_rgb_are_refused(tmp_path, mode, fault):
    path = tmp_path / ("photo.tif" if mode == "F" else "photo.png")
    Image.new(mode, (4, 3)).save(path)
    with pytest.raises(SplatproofError, match=fault):
        read_photo(path)


def test_a_photo_is_checked_as_it_is_read(tmp_path):
    """Transparent ones are refused where none may be, and only there."""
    path = tmp_path / "photo.png"
    Image.new("RGBA", (4, 3)).save(path)
    check_photo(path, transparent=True)
    with pytest.raises(SplatproofError, match="transparent"):
        check_photo(path)


def test_grey_palette_and_opaque_photos_are_read_exactly(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    for mode in ("L", "RGBA", "P"):
        Image.fromarray(grey).convert("RGBA" if mode == "RGBA" else "L").convert(mode).save(
            tmp_path / f"{mode}.png"
        )
        found = (read_photo(tmp_path / f"{mode}.png") * 255).round().numpy()
        assert (found == grey[..., None]).all()
