"""Names that come from files lead nowhere but into their folder."""

import os

import pytest

from helpers.talking_workers import tell_trust
from splatproof.base.errors import DataError, UsageError
from splatproof.base.inside import allowing_outside, checked_name, inside, outside_is_allowed
from splatproof.base.processes import Worker

BAD = ["", "/", "/etc/passwd", "..", ".", "a/../../b", "a//b", "a/", "./a", "a\0b", "a\nb", "\ud800",
       "n" * 256, "é" * 128]  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_names_that_become_folders_stay_below(name):
    with pytest.raises(DataError, match=r"^here\.toml: .{1,120} cannot be a name") as caught:
        checked_name(name, "here.toml")
    str(caught.value).encode()


@pytest.mark.parametrize(
    "name", ["a", "mill19/rubble", "...", "..a", "a b", "é" * 127, "写真/１.png"]
)
def test_names_that_are_fine(name, tmp_path):
    assert checked_name(name, "here.toml") == name
    assert inside(tmp_path, name, "here.toml") == tmp_path / name


def test_one_name_alone():
    with pytest.raises(UsageError, match="'a/b' has a '/'; expected one name"):
        checked_name("a/b", "here.toml", UsageError, nested=False)


@pytest.fixture
def scene(tmp_path):
    """A scene folder with a file, and one beside it."""
    (tmp_path / "scene" / "images").mkdir(parents=True)
    for name in ("private.png", "scene/images/a.png"):
        (tmp_path / name).write_bytes(b"")
    return tmp_path / "scene"


def outside(scene):
    (scene / "link.png").symlink_to("../private.png")
    (scene / "away").symlink_to("..")
    other = scene.parent / "private.png"
    return [str(other), "../private.png", "images/../../private.png", "link.png", "away/private.png",
            "../scene2/a.png", "/dev/zero"]  # fmt: skip


def test_what_leads_out_is_refused_unless_asked(scene):
    for name in outside(scene):
        with pytest.raises(DataError, match=r"frame 3: '.*' leads out of .*; .* --allow-outside"):
            inside(scene, name, "frame 3")
        with allowing_outside(True):
            assert inside(scene, name, "frame 3") == scene / name
    assert not outside_is_allowed()


def test_what_stays_inside_is_not_refused(scene):
    (scene / "images" / "link.png").symlink_to("a.png")
    for name in (
        "images/a.png",
        "./images/a.png",
        "images/../images/a.png",
        "images/link.png",
        "gone",
    ):
        assert inside(scene, name, "here") == scene / name
    assert inside(scene / "images", "../images/a.png", "here", within=scene)
    linked = scene.parent / "linked"
    linked.symlink_to(scene)
    assert inside(linked, "images/a.png", "here") == linked / "images/a.png"


@pytest.mark.parametrize("name", ["", ".", "/", "images/", "a\0b", "images/..", "\ud800.png"])
@pytest.mark.parametrize("allowed", [True, False])
def test_names_of_no_file(scene, name, allowed):
    said = "is no name of a file|is the folder itself"
    with allowing_outside(allowed), pytest.raises(DataError, match=rf"^here: .* ({said})"):
        inside(scene, name, "here")


def test_links_in_a_circle(scene):
    (scene / "a").symlink_to("b")
    (scene / "b").symlink_to("a")
    with pytest.raises(DataError, match="^here: 'a"):
        inside(scene, os.path.join("a", "c.png"), "here")


@pytest.mark.parametrize("allowed", [True, False])
def test_workers_trust_what_is_trusted_here(allowed):
    with allowing_outside(allowed), Worker(tell_trust) as worker:
        assert worker.receive() is allowed
