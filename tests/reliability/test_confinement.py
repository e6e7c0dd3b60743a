"""What a stranger's file names: nothing outside its own folder is read, written or removed."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pycolmap
import pytest

from helpers.adapter_checks import fixtures, protocol
from helpers.colmap_scenes import Flight, view_name, write_scene
from splatproof.api import fitting
from splatproof.api.scenes import open_scene as api_open_scene
from splatproof.base.errors import DataError, SplatproofError, UsageError
from splatproof.base.inside import allowing_outside, outside_is_allowed
from splatproof.cli import flags
from splatproof.datasets.catalogue import registry
from splatproof.datasets.catalogue.opening import open_scene
from splatproof.metrics.protocol_files import load_protocol, protocol_from_rules


def edited_json(name: str, change: Callable[[dict, str], object]) -> Callable[[Path, str], None]:
    def edit(scene: Path, path: str) -> None:
        data = json.loads((scene / name).read_text())
        change(data, path)
        (scene / name).write_text(json.dumps(data))

    return edit


def file_path(data: dict, path: str) -> None:
    data["frames"][0]["file_path"] = path


def file_path_without_suffix(data: dict, path: str) -> None:
    data["frames"][0]["file_path"] = path.removesuffix(".png")


def mask_path(data: dict, path: str) -> None:
    data["frames"][0]["mask_path"] = path


def ply_path(data: dict, path: str) -> None:
    data["ply_file_path"] = path


def image_name(scene: Path, path: str) -> None:
    model = pycolmap.Reconstruction(scene / "sparse/0")
    model.image(1).name = path
    model.write_binary(scene / "sparse/0")


@dataclass(frozen=True)
class Door:
    """A place in a scene's files that names a file."""

    write: Callable[[Path], object]
    """Writes a scene."""
    name: Callable[[Path, str], None]
    """Puts a name there."""
    photo: str
    """A file that is good enough to be read there."""
    base: str = "."
    """Folder that names are relative to."""
    inside: str = "."
    """The scene's folder in what was written."""
    reads_points: bool = False


def tourist(folder: Path) -> None:
    fixtures("photo_tourism").tourism(folder, ["train", "test", "train", "", "train", "test"])


def colmap(folder: Path) -> None:
    write_scene(folder, Flight(views=3, points=30))


ADAPTERS, CITY, LLFF = fixtures("adapters"), fixtures("matrix_city"), fixtures("llff")
TRAIN = "transforms_train.json"
DOORS = {
    "colmap": Door(colmap, image_name, f"photos/{view_name(0)}", base="photos"),
    "nerfstudio": Door(
        ADAPTERS.nerfstudio, edited_json("transforms.json", file_path), "images/0.png"
    ),
    "mask": Door(ADAPTERS.nerfstudio, edited_json("transforms.json", mask_path), "images/0.png"),
    "points": Door(
        ADAPTERS.nerfstudio,
        edited_json("transforms.json", ply_path),
        "images/0.png",
        reads_points=True,
    ),
    "blender": Door(
        ADAPTERS.blender, edited_json(TRAIN, file_path_without_suffix), "train/r_0.png"
    ),
    "matrixcity": Door(
        CITY.city,
        edited_json(TRAIN, file_path),
        "train/block_1/0000.png",
        base="pose/block_A",
        inside="pose/block_A",
    ),
}


@pytest.mark.parametrize("way", ["absolute", "climbing", "link"])
@pytest.mark.parametrize("name", DOORS)
def test_a_scenes_files_name_nothing_outside_its_folder(tmp_path, name, way):
    door = DOORS[name]
    whole = tmp_path / "scene"
    door.write(whole)
    private = tmp_path / "private.png"
    shutil.copy(whole / door.photo, private)
    scene, base = whole / door.inside, whole / door.base
    up = "/".join([".."] * (1 + len(base.relative_to(whole).parts)))
    path = {"absolute": str(private), "climbing": f"{up}/private.png", "link": "link.png"}[way]
    if way == "link":
        (base / "link.png").symlink_to(private)
    door.name(scene, path)
    with pytest.raises(DataError, match=r"'.*' leads out of .*; put the file there, or .*outside"):
        open_scene(scene, protocol(hold=2))
    if not door.reads_points:  # a photo is no file of points, asked for or not
        api_open_scene(scene, protocol=protocol(hold=2), allow_outside=True)


@pytest.mark.parametrize("name", ["", ".", "/", "..", "a/", "photos/.."])
def test_images_of_a_model_that_have_no_names_of_files(tmp_path, name):
    colmap(tmp_path / "scene")
    image_name(tmp_path / "scene", name)
    with pytest.raises(DataError, match="name of a file|leads out|folder itself"):
        open_scene(tmp_path / "scene", protocol(hold=2))


LISTED = {
    "photo": (LLFF.llff, "images/img_0001.JPG"),
    "poses": (LLFF.llff, "poses_bounds.npy"),
    "sky": (colmap, f"sky/{Path(view_name(0)).with_suffix('.png')}"),
    "depth": (colmap, f"depth/{Path(view_name(0)).with_suffix('.npz')}"),
}


@pytest.mark.parametrize("kind", LISTED)
def test_files_that_an_adapter_lists_are_no_links_out_of_the_scene(tmp_path, kind):
    write, name = LISTED[kind]
    write(tmp_path / "scene")
    file, private = tmp_path / "scene" / name, tmp_path / "private"
    if file.exists():
        file.rename(private)
    else:
        private.write_bytes(b"")  # nobody reads it before it is asked for
        file.parent.mkdir()
    file.symlink_to(private)
    with pytest.raises(DataError, match=rf"{file.name}: is a link that leads out of .*/scene;"):
        open_scene(tmp_path / "scene", protocol(hold=2))
    api_open_scene(tmp_path / "scene", protocol=protocol(hold=2), allow_outside=True)


@pytest.mark.parametrize("trusted", [False, True])
def test_a_fit_trusts_a_scene_when_it_is_asked(tmp_path, monkeypatch, trusted):
    colmap(tmp_path / "scene")
    photo = tmp_path / "scene/photos" / view_name(0)
    photo.rename(tmp_path / "private.png")
    photo.symlink_to(tmp_path / "private.png")

    def run(*_: object, **__: object) -> None:
        raise SplatproofError(f"trained, trusted: {outside_is_allowed()}")

    monkeypatch.setattr(fitting, "run_alone", run)
    said = "trained, trusted: True" if trusted else "leads out of"
    with pytest.raises(SplatproofError, match=said):
        fitting.fit("3dgs", tmp_path / "scene", out=tmp_path / "out", allow_outside=trusted)


def test_folders_of_a_scene_may_be_links(tmp_path):
    colmap(tmp_path / "scene")
    (tmp_path / "scene/photos").rename(tmp_path / "photos")
    (tmp_path / "scene/photos").symlink_to(tmp_path / "photos")
    assert len(open_scene(tmp_path / "scene", protocol(hold=2)).views) == 3


ENTRY = 'kind = "made"\nlicence = "x"\nsource = "x"\nabout = "x"\nworld = "courtyard"\n'


@pytest.mark.parametrize(
    "text",
    [
        f'["a/../../../../escaped"]\n{ENTRY}preset = "small"',
        f'["/absolute"]\n{ENTRY}',
        f'[""]\n{ENTRY}',
        f'["a\\u0000b"]\n{ENTRY}',
        f'[set]\nscenes = ["../../escaped"]\n{ENTRY}',
        f'[set]\nscenes = "letters"\n{ENTRY}',
        f"[set]\nscenes = [1]\n{ENTRY}",
        f'[a]\nfolders = ["../../.."]\n{ENTRY}',
        f'[a]\nfolders = ["/etc"]\n{ENTRY}',
        f'[a]\npart = "../.."\n{ENTRY}',
        f'[a]\n{ENTRY}[a.files]\n"../../secret" = "00"',
    ],
)
def test_a_registry_names_nothing_outside_its_root(tmp_path, monkeypatch, text):
    (tmp_path / "registry.toml").write_text(text)
    monkeypatch.setenv("SPLATPROOF_DATA", str(tmp_path))
    with pytest.raises(DataError, match=r"registry\.toml: .*(cannot be a name|list of names)"):
        registry.list_scenes()


RULES: dict[str, object] = {"source": "test"}


@pytest.mark.parametrize("name", ["..", ".", "", "a/b", "../a", "a\0"])
def test_the_name_of_a_protocol_is_one_folder(name):
    with pytest.raises(UsageError, match="expected (letters|one name)"):
        protocol_from_rules(name, dict(RULES), "rules.toml")


def test_a_protocol_file_whose_name_would_climb(tmp_path):
    path = tmp_path / "...toml"
    path.write_text('source = "test"')
    with pytest.raises(UsageError, match=r"'\.\.' cannot be a name"):
        load_protocol(path)


@pytest.mark.parametrize("key", ["images", "test_folder"])
@pytest.mark.parametrize("folder", ["..", "../other", "/etc", "a\0"])
def test_the_folders_of_a_protocol_are_in_the_scene(key, folder):
    with pytest.raises(UsageError, match=rf"rules\.toml: {key}: .* cannot be a name"):
        protocol_from_rules("rules", RULES | {key: folder}, "rules.toml")


def test_the_option_holds_while_its_command_runs():
    def command() -> bool:
        return outside_is_allowed()

    asked = flags.with_flags(command, plugins=False, scenes=True)
    for allowed in (True, False):
        assert asked(json=False, quiet=False, allow_outside=allowed) is allowed
    with allowing_outside(True):
        assert flags.with_flags(command, plugins=False)(json=False, quiet=False) is False
