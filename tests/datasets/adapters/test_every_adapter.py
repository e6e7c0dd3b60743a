"""Every adapter, every file of its fixture: missing, cut short, emptied or rubbish, it is named or not needed."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData, PlyElement

from helpers.adapter_checks import fixtures, protocol
from helpers.colmap_scenes import Flight, write_scene
from helpers.posed_scenes import POINTS
from splatproof.base.errors import DataError
from splatproof.cli import main
from splatproof.datasets.catalogue.opening import ADAPTERS, open_scene
from splatproof.datasets.depth_maps import depth_path
from splatproof.datasets.view_times import Moment, sky_path, write_moments


@dataclass(frozen=True)
class Fixture:
    """A fixture of a layout, and which of its files may be missing."""

    write: Callable[[Path], object]
    """Writes the layout below a folder."""
    inside: str = "."
    """The scene's folder in what was written."""
    optional: str = r"$^"
    """Pattern of the files without which the scene opens: with fewer masks or sweeps, or with the views
    of this file named in left_out."""
    unread: str = r"$^"
    """Pattern of the files that are not read at all."""
    adapter: str = ""
    """Name of the adapter where it is not that of the fixture."""
    counted: str = r"$^"
    """Pattern of the files that have no name of their own in the layout, only a place in a row: what is
    said is how many there are, and where."""


def _rich_nerfstudio(folder: Path) -> None:
    """With points and masks."""
    fixtures("adapters").nerfstudio(folder)
    cloud = np.array([tuple(p) for p in POINTS], dtype=[(axis, "f4") for axis in "xyz"])
    PlyData([PlyElement.describe(cloud, "vertex")]).write(folder / "sparse_pc.ply")
    path = folder / "transforms.json"
    data = json.loads(path.read_text()) | {"ply_file_path": "sparse_pc.ply"}
    for frame in data["frames"]:
        frame["mask_path"] = f"masks/{Path(frame['file_path']).name}"
        (folder / "masks").mkdir(exist_ok=True)
        Image.new("L", (96, 72), 255).save(folder / frame["mask_path"])
    path.write_text(json.dumps(data))


def _driven(folder: Path) -> None:
    """A COLMAP model with moments and what may lie beside: LiDAR, depth, masks of sky and movers."""
    write_scene(folder, Flight(model="PINHOLE", params=[70, 72, 47, 37]))
    names = [path.name for path in sorted((folder / "photos").iterdir())]
    moments = {name: Moment(time=0.1 * i, sensor="front") for i, name in enumerate(names)}
    write_moments(folder, moments)
    for part in ("depth", "sky", "masks", "moving/vehicles", "moving/people", "lidar"):
        (folder / part).mkdir(parents=True)
    for name, moment in moments.items():
        np.savez(depth_path(folder, name), depth=np.full((72, 96), 4, np.float32))
        masks = [folder / "masks" / f"{name}.png", *moving_masks_of(folder, name)]
        for mask in (sky_path(folder, name), *masks):
            Image.new("L", (96, 72), 255).save(mask)
        file = folder / "lidar" / f"{Path(name).stem}.npz"
        np.savez(file, points=np.ones((5, 3)), origin=np.zeros(3), time=moment.time)


def moving_masks_of(folder: Path, name: str) -> list[Path]:
    """Paths of the masks of what moves of a photo."""
    return [folder / "moving" / kind / name for kind in ("vehicles", "people")]


def _tourism(folder: Path) -> None:
    fixtures("photo_tourism").tourism(folder, ["train", "test", "train", "", "train", "test"])


def _tracking(folder: Path) -> None:
    boxes = fixtures("kitti_boxes")
    lines = [boxes.label(i, 0, "Car", *boxes.place(i)) for i in range(boxes.FRAMES)]
    boxes.tracking(folder, lines)


FIXTURES = {
    "colmap": Fixture(partial(write_scene, flight=Flight()), optional="photos/"),  # as nerfstudio
    "colmap, driven": Fixture(
        _driven, optional=r"photos/|lidar/|depth/|sky/|masks/|views\.json", adapter="colmap"
    ),
    "photo-tourism": Fixture(_tourism, unread=r"photo_003\.png", counted=r"gate\.tsv"),
    "nerfstudio": Fixture(_rich_nerfstudio, optional="images/"),  # what is there is opened
    "matrixcity": Fixture(
        fixtures("matrix_city").city, optional=r"/transforms\.json", unread="pose/"
    ),
    "blender": Fixture(fixtures("adapters").blender, unread=r"val/|_val\.json"),
    "mega-nerf": Fixture(fixtures("adapters").mega_nerf, optional=r"mappings\.txt|coordinates\.pt"),
    "llff": Fixture(fixtures("llff").llff, unread="images_2/", counted="images/"),
    "kitti-raw": Fixture(
        fixtures("kitti_boxes").tracklets,
        inside="2011_09_26_drive_0001_sync",
        optional=r"\.bin|tracklet_labels",
        counted="image_02/data",
    ),
    "kitti-tracking": Fixture(
        _tracking,
        inside="image_02/0001",
        optional=r"\.bin|sky_03|label_02",
        counted="image_02/",
    ),
    "drivestudio": Fixture(
        fixtures("waymo").drivestudio,
        optional=r"\.bin|sky_masks|ego_pose/00[03]",  # the first or the last frame
        unread="dynamic_masks/all",
    ),
    "pvg": Fixture(fixtures("waymo").pvg, optional=r"\.bin|sky_|calib/014500[03]"),
    "levir-nvs": Fixture(fixtures("adapters").levir_nvs, optional="Cams/"),
}
"""Name of the adapter: its fixture."""


def files_of(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def written(tmp_path: Path, name: str) -> tuple[Fixture, Path]:
    """The fixture of an adapter, and the folder below which it was written."""
    root = tmp_path / "written"
    root.mkdir()
    FIXTURES[name].write(root)
    return FIXTURES[name], root


def use(folder: Path) -> None:
    """Open the scene and read all that its views have."""
    scene = open_scene(folder, protocol(hold=2))
    for view in scene.views:
        view.load()
        for read in (
            view.load_mask, view.load_sky, view.load_sweep, view.load_depth, view.load_moving,
        ):  # fmt: skip
            if read is not None:
                read()


def fault(folder: Path) -> str:
    """What is said against the scene; "" if nothing. Any other exception fails the test."""
    try:
        use(folder)
    except DataError as error:
        return str(error)
    return ""


def test_every_adapter_has_a_fixture_here():
    known = {fixture.adapter or name for name, fixture in FIXTURES.items()}
    assert known == {adapter.name for adapter in ADAPTERS}


DAMAGES: dict[str, Callable[[Path], object]] = {
    "missing": Path.unlink,
    "empty": lambda path: path.write_bytes(b""),
    "cut": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "rubbish": lambda path: path.write_bytes(b"\x00\xff rubbish\n" * 3),
}


def rows_of(files: list[Path]) -> list[list[Path]]:
    """The files of each kind in each folder; what lies between the ends of a row is read as they are."""
    kinds: dict[tuple[Path, str], list[Path]] = {}
    for path in files:
        kind = re.sub(r"\d+", "#", path.name)
        kinds.setdefault((path.parent, kind), []).append(path)
    return list(kinds.values())


def every_damage(files: list[Path]) -> list[tuple[Path, str]]:
    """All files, each damaged in all ways."""
    return [(path, damage) for path in files for damage in DAMAGES]


def a_few(files: list[Path]) -> list[tuple[Path, str]]:
    """Of each row of files both ends go missing, its first is emptied and cut, its last is rubbish.

    Where in its row a file lies decides what is said when it is not there, not what is said of its content.
    """
    damages: list[tuple[Path, str]] = []
    for row in rows_of(files):
        damages += [(path, "missing") for path in dict.fromkeys((row[0], row[-1]))]
        damages += [(row[0], "empty"), (row[0], "cut"), (row[-1], "rubbish")]
    return damages


@pytest.mark.parametrize("chosen", [a_few, pytest.param(every_damage, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", FIXTURES)
def test_a_damaged_file_is_named_in_one_line(tmp_path, name, chosen):
    fixture, root = written(tmp_path, name)
    scene = open_scene(root / fixture.inside, protocol(hold=2))
    assert scene.facts["adapter"] == (fixture.adapter or name)
    assert fault(root / fixture.inside) == ""
    for path, damage in chosen(files_of(root)):
        kept = path.read_bytes()
        relative = path.relative_to(root).as_posix()
        DAMAGES[damage](path)
        said = fault(root / fixture.inside)
        assert "\n" not in said
        assert len(said) < 1000
        if said:
            counted = damage == "missing" and re.search(fixture.counted, relative)
            named = str(path.parent) if counted else path.stem
            assert named in said, f"{relative} {damage}: {said}"
        elif not re.search(fixture.unread, relative):
            silent = {
                "cut": True,  # half of a table may be whole enough
                "missing": bool(re.search(fixture.optional, relative)),
                "empty": "label_02" in relative,  # nothing was labelled
            }
            assert silent.get(damage), f"{relative} {damage}: nothing was said"
        path.write_bytes(kept)
    assert fault(root / fixture.inside) == ""


@pytest.mark.parametrize("name", FIXTURES)
def test_the_command_ends_with_2_and_one_line(tmp_path, capsys, name):
    fixture, root = written(tmp_path, name)
    victim = photo_of(root, fixture)
    victim.write_bytes(b"rubbish")
    out = tmp_path / "out"
    assert main(["fit", "3dgs", str(root / fixture.inside), "--out", str(out)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-1].startswith("bench: ")
    assert str(victim.name) in lines[-1]
    assert not (out / "model").exists()


@pytest.mark.parametrize("name", FIXTURES)
def test_a_photo_too_many_is_left_out_and_said(tmp_path, name):
    fixture, root = written(tmp_path, name)
    scene = open_scene(root / fixture.inside, protocol(hold=2))
    photo = photo_of(root, fixture)
    extra = photo.with_name(f"9{photo.name}")
    shutil.copy(photo, extra)
    if re.search(fixture.counted, photo.relative_to(root).as_posix()):
        assert str(photo.parent) in fault(root / fixture.inside)  # too many for the rows
        return
    more = open_scene(root / fixture.inside, protocol(hold=2))
    assert [view.name for view in more.views] == [view.name for view in scene.views]
    assert any(Path(left).name == extra.name for left, _ in more.left_out), more.left_out


def photo_of(root: Path, fixture: Fixture) -> Path:
    """The photo of the first view."""
    name = Path(open_scene(root / fixture.inside, protocol(hold=2)).views[0].name).name
    found = [path for path in files_of(root) if path.name == name]
    return next(
        path for path in found if not re.search(r"masks|sky|moving|images_2", str(path.parent))
    )
