"""The dashboard's files: what stands at each path, and that no path leads elsewhere."""

import json
import shutil
import threading
from pathlib import Path
from typing import Any

import pytest

from helpers.dashboard_store import COMMITS
from splatproof.base.errors import DataError, UsageError
from splatproof.reports.claims.claim import Claim
from splatproof.reports.dashboard import assets
from splatproof.reports.dashboard import site as site_module
from splatproof.reports.dashboard.cache import Cache
from splatproof.reports.dashboard.index import Progress
from splatproof.reports.dashboard.listing import list_runs
from splatproof.reports.dashboard.numbers import script, short
from splatproof.reports.dashboard.site import Site
from splatproof.reports.dashboard.static_site import MARK, build_site
from splatproof.reports.mlflow_client import open_client


def data(site: Site, name: str) -> Any:
    """What a data file hands to the page."""
    found = site.read(f"data/{name}.js")
    assert found is not None
    return handed(found[0].decode())[1]


def handed(text: str) -> tuple[str, Any]:
    """Name and data of a call of splatproof.take."""
    call = "splatproof.take("
    assert text.startswith(call)
    name, content = json.loads(f"[{text.strip()[len(call) : -2]}]")
    return name, json.loads(content)


def test_data_is_handed_over_whole():
    value = {"a": ["</script>", "\u2028", "\u202e", '"', None, 1.5]}
    assert handed(script("x/y", value)) == ("x/y", value)


def test_numbers_keep_six_digits_and_say_what_is_none():
    assert [short(v) for v in (1.23456789, 3.0, float("nan"), float("inf"), None)] == [
        1.23457, 3, None, "Infinity", None,
    ]  # fmt: skip


def test_every_name_of_the_index_leads_to_its_file(site: Site):
    index = data(site, "index")
    runs = index["runs"]
    for name in [
        *(f"data/run/{run}.js" for run in runs["run"]),
        *(f"record/{run}.json" for run in runs["run"]),
        *(f"data/table/{table['id']}.js" for table in runs["tables"]),
        *(
            f"data/history/{one}.js"
            for one in runs["texts"]["series"]["known"]
            if one in site.state.series
        ),
    ]:
        assert site.read(name), name
    sides = [side["id"] for side in index["sides"] if side["kind"] == "row"]
    assert site.read(f"data/compare/{sides[0]}~{sides[1]}.js")


def test_images_are_those_of_the_records(site: Site):
    images = data(site, "images")
    count = sum(len(images["lists"][place]) for place in images["list"])
    assert count == 72
    assert all(len(column) == count for column in images["values"].values())
    summary = site.state.runs[images["run"][0]]
    own = list(summary.numbers.images.values())
    assert images["values"]["psnr"][: len(own)] == pytest.approx([i["psnr"] for i in own], rel=1e-5)


def test_history_says_what_changed_and_where(site: Site):
    gained = next(k for k, v in site.state.series.items() if v[0].numbers.row == "3dgs")
    found = data(site, f"history/{gained}")
    assert [version["commit"] for version in found["versions"]] == list(COMMITS)
    assert found["versions"][1]["changed"] == [["commit", [["commit", COMMITS[0], COMMITS[1]]]]]
    assert [change["verdict"] for change in found["changes"]["psnr"]] == ["better"]
    same = next(k for k, v in site.state.series.items() if v[0].numbers.row == "slow")
    verdicts = [
        c["verdict"] for own in data(site, f"history/{same}")["changes"].values() for c in own
    ]
    assert set(verdicts) <= {"equal", "not judged"}


def test_claims_are_judged_by_the_stores_runs(store_uri: str):
    said = Claim(
        paper="p", text="t", suite="quick", row="3dgs", other="slow", metric="psnr", printed=2.0
    )
    elsewhere = Claim(paper="p", text="t", suite="other", row="3dgs", other="slow", metric="psnr")
    claims = data(Site(store_uri, Cache(None), [said, elsewhere]), "claims")["claims"]
    assert len(claims) == 1
    assert claims[0]["verdict"] == "holds"
    assert [link["scene"] for link in claims[0]["links"]] == ["beach", "town"]
    assert all(link["sides"] and len(link["runs"]) == 2 for link in claims[0]["links"])


@pytest.mark.parametrize(
    "path",
    [
        "../conftest.py", "app/../site.py", "app/site.py", "app/index.html", "picture/x/render/dji_0001.png",
        "picture/RUN/model/gaussians.png", "picture/RUN/render/../../../../mlflow.png",
        "picture/RUN/render/..%2frecord.png", "picture/RUN/render/absent.png", "record/RUN/record.json",
        "record/../RUN.json", "data/run/.js", "data/compare/a~b.js", "data/index", "thumb/RUN/x/dji_0001.jpg",
        "data/table/../index.js", "/etc/passwd", "//etc/passwd", "record/.json", "\0", "data/\0.js",
    ],
)  # fmt: skip
def test_no_other_path_leads_anywhere(site: Site, path: str):
    run = site.state.index.shown[-1].run
    assert site.read(path.replace("RUN", run)) is None


def test_pictures_come_as_they_are_and_small(site: Site):
    run = next(one for one in site.state.index.shown if one.numbers.images).run
    for kind in ("render", "truth", "error"):
        png = site.read(f"picture/{run}/{kind}/dji_0001.png")
        assert png is not None
        assert png[0].startswith(b"\x89PNG")
        assert png[1] == "image/png"
    small = site.read(f"thumb/{run}/render/dji_0001.jpg")
    assert small is not None
    assert small[0].startswith(b"\xff\xd8")


def test_no_password_is_shown(store_uri: str):
    site = Site(store_uri, Cache(None), ())
    site.uri = "http://user:secret@host:5000/path"
    text = json.dumps(site.index_data("static", "jpg", {}, ""))
    assert "secret" not in text
    assert "http://host:5000/path" in text


def test_scripts_never_make_markup_of_text():
    for name in assets.SCRIPTS:
        text = (assets.app_file(f"{name}.js") or b"").decode()
        for banned in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
            assert banned not in text, name
    assert {path.stem for path in assets.STATIC.glob("*.js")} == set(assets.SCRIPTS)


def test_a_static_build_replaces_its_own_folder_and_no_other(site: Site, tmp_path: Path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(UsageError, match="holds something else"):
        build_site(site, tmp_path, 0.0)
    assert (tmp_path / "mine.txt").exists()
    folder = tmp_path / "page"
    built = build_site(site, folder, 0.0)
    assert not (folder / "picture").exists()
    assert "have no pictures here" in built.left_out
    (folder / "old").write_text("of an earlier build")
    build_site(site, folder, 0.0)
    assert not (folder / "old").exists()
    assert (folder / MARK).exists()
    _, index = handed((folder / "data" / "index.js").read_text("utf-8"))
    assert index["site"]["left_out"] == built.left_out
    assert index["site"]["pictures"] == {}


def test_a_budget_of_pictures_is_kept_and_spread(site: Site, tmp_path: Path):
    whole = build_site(site, tmp_path / "all", 50.0)
    pictures = [p for p in (tmp_path / "all").rglob("*.jpg")]
    size = sum(path.stat().st_size for path in pictures)
    assert "have no pictures" not in whole.left_out
    build_site(site, tmp_path / "half", size / 2 / 2**20)
    kept = sum(path.stat().st_size for path in (tmp_path / "half").rglob("*.jpg"))
    most = 4 * max(path.stat().st_size for path in pictures)  # an image is written whole
    assert size / 2 <= kept <= size / 2 + most
    _, index = handed((tmp_path / "half" / "data" / "index.js").read_text("utf-8"))
    assert {0, 3} <= {place for own in index["site"]["pictures"].values() for place in own}


def test_a_page_does_not_wait_for_a_long_reading_and_says_so(
    store_uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    shutil.copy(Path(store_uri.removeprefix("sqlite:///")), tmp_path / "mlflow.db")
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    site, go = Site(uri, Cache(None), ()), threading.Event()
    true = site._read

    def slow(progress: Progress) -> Any:
        assert go.wait(30)
        return true(progress)

    monkeypatch.setattr(site, "_read", slow)
    monkeypatch.setattr(site_module, "PATIENCE", 0.01)
    before = data(site, "index")
    open_client(uri).delete_run(list_runs(uri)[0].run)
    meanwhile = data(site, "index")
    assert (before["site"]["reading"], meanwhile["site"]["reading"]) == (False, True)
    assert meanwhile["runs"] == before["runs"]
    go.set()
    monkeypatch.setattr(site_module, "PATIENCE", 30)
    after = data(site, "index")
    assert not after["site"]["reading"]
    assert len(after["runs"]["run"]) == len(before["runs"]["run"]) - 1


def test_a_failed_reading_is_told_and_tried_again(
    store_uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    shutil.copy(Path(store_uri.removeprefix("sqlite:///")), tmp_path / "mlflow.db")
    uri = f"sqlite:///{tmp_path}/mlflow.db"
    site = Site(uri, Cache(None), ())

    def broken(progress: Progress) -> Any:
        raise DataError("record.json: damaged")

    open_client(uri).delete_run(list_runs(uri)[0].run)
    with monkeypatch.context() as patch:
        patch.setattr(site, "_read", broken)
        with pytest.raises(DataError, match="damaged"):
            site.read("data/index.js")
    assert not data(site, "index")["site"]["reading"]
