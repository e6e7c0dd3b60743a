"""Archives that a stranger made: good ones unpack, evil ones leave nothing behind."""

import io
import stat
import tarfile
import zipfile

import pytest

from splatproof.base.errors import DataError, UsageError
from splatproof.datasets.archives import extract


def zip_of(path, members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in members:
            packed.writestr(name, content)
    return path


def tar_of(path, members):
    with tarfile.open(path, "w:gz") as packed:
        for member, content in members:
            info = tarfile.TarInfo(member) if isinstance(member, str) else member
            info.size = len(content)
            packed.addfile(info, io.BytesIO(content))
    return path


def link(name, target, kind=tarfile.SYMTYPE):
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, target
    return info


GOOD = [("scene/photos/a.png", b"abc"), ("scene/sparse/0/x.bin", b"12")]


@pytest.mark.parametrize("make", [zip_of, tar_of])
def test_a_good_archive_loses_its_only_folder(tmp_path, make):
    extract(make(tmp_path / "a", GOOD), tmp_path / "out")
    assert (tmp_path / "out/photos/a.png").read_bytes() == b"abc"
    assert (tmp_path / "out/sparse/0/x.bin").read_bytes() == b"12"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "out"]


@pytest.mark.parametrize("make", [zip_of, tar_of])
def test_several_roots_stay(tmp_path, make):
    extract(make(tmp_path / "a", [("x", b"1"), ("y/z", b"2")]), tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["x", "y"]


def test_a_tar_that_names_its_own_root(tmp_path):
    root = tarfile.TarInfo("./")
    root.type = tarfile.DIRTYPE
    extract(tar_of(tmp_path / "a", [(root, b""), ("./x", b"1"), ("./y", b"2")]), tmp_path / "out")
    assert (tmp_path / "out/x").read_bytes() == b"1"


EVIL_NAMES = ["../evil", "a/../../evil", "/tmp/evil", "C:\\evil", "..\\evil", "a/b/../../../evil"]


@pytest.mark.parametrize("make", [zip_of, tar_of])
@pytest.mark.parametrize("name", EVIL_NAMES)
def test_members_that_climb_out(tmp_path, make, name):
    archive = make(tmp_path / "a", [("good", b"1"), (name, b"evil")])
    assert_refused(archive, tmp_path, "would leave")


@pytest.mark.parametrize(
    "members",
    [
        [(link("out", "/etc"), b""), ("out/passwd", b"evil")],
        [(link("out", ".."), b""), ("out/evil", b"evil")],
        [(link("passwd", "/etc/passwd", tarfile.LNKTYPE), b"")],
        [(link("pipe", "", tarfile.FIFOTYPE), b"")],
        [(link("disk", "", tarfile.BLKTYPE), b"")],
    ],
)
def test_links_and_devices_in_a_tar(tmp_path, members):
    assert_refused(tar_of(tmp_path / "a", members), tmp_path, "link or device")


def test_a_symlink_in_a_zip(tmp_path):
    info = zipfile.ZipInfo("out")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    archive = zip_of(tmp_path / "a", [(info, b"/etc"), ("out/passwd", b"evil")])
    assert_refused(archive, tmp_path, "link or device")


@pytest.mark.parametrize("make", [zip_of, tar_of])
def test_a_bomb(tmp_path, make):
    archive = make(tmp_path / "a", [("zeros", bytes(3_000_000))])
    assert archive.stat().st_size < 100_000
    assert_refused(archive, tmp_path, "more than 1000000", limit=1_000_000)


@pytest.mark.parametrize("members", [[("a", b"1"), ("a", b"2")], [("a", b"1"), ("a/b", b"2")]])
def test_members_in_each_others_way(tmp_path, members):
    assert_refused(tar_of(tmp_path / "a", members), tmp_path, "twice|at once")


@pytest.mark.parametrize("make", [zip_of, tar_of])
@pytest.mark.parametrize("keep", [0.3, 0.9])
def test_a_cut_archive(tmp_path, make, keep):
    archive = make(tmp_path / "a", [("x", bytes(range(256)) * 40), ("y", b"1" * 5000)])
    archive.write_bytes(archive.read_bytes()[: int(keep * archive.stat().st_size)])
    assert_refused(archive, tmp_path, "damaged|neither")


def test_not_an_archive(tmp_path):
    (tmp_path / "a").write_bytes(b"<html>404</html>")
    assert_refused(tmp_path / "a", tmp_path, "neither a zip nor a tar")


def test_an_existing_folder_is_left_alone(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(UsageError, match="exists"):
        extract(zip_of(tmp_path / "a", GOOD), tmp_path / "out")


def assert_refused(archive, folder, match, **options):
    before = sorted(p.name for p in folder.iterdir())
    with pytest.raises(DataError, match=match) as caught:
        extract(archive, folder / "out", **options)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in folder.iterdir()) == before
