"""The site: a page for every metric and method, links that lead somewhere, a build without a warning."""

import dataclasses
import re
import subprocess
import sys
from pathlib import Path

import pytest
from house_docstrings import as_rest
from make_reference_pages import DOCS, page_name, pages, words
from run_tutorial import PAGE, blocks, outputs
from setting_tables import field_docs, setting_rows

import splatproof as sp
from helpers.guides import BLOCK
from splatproof.methods.registry import METHODS
from splatproof.metrics.registry import BUILT_IN
from splatproof.metrics.scene_registry import SCENE_METRICS

LINK = re.compile(r"(?<!`)\[[^\]]*\]\(([^)\s]+)\)")
MADE = pages({})
"""The generated pages by their path below docs/."""


def written_pages() -> dict[str, str]:
    """The pages that are in the repository and on the site."""
    found = [*DOCS.glob("*.md"), *(DOCS / "guides").glob("*.md")]
    texts = {str(path.relative_to(DOCS)): path.read_text() for path in found}
    return {name: text for name, text in texts.items() if not name.endswith("_findings.md")}


def broken_links(name: str, text: str, known: dict[str, str]) -> list[str]:
    """Targets of a page that neither are among the pages nor exist, and anchors that no heading has."""
    bad = []
    for target in LINK.findall(re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        place, _, anchor = target.partition("#")
        if "://" in target:
            continue
        path = (DOCS / name).parent / place if place else DOCS / name
        inside = path.resolve().relative_to(DOCS.parent)
        page = str(inside.relative_to("docs")) if inside.parts[0] == "docs" else ""
        if (
            page not in known
            and not path.exists()
            or anchor
            and page in known
            and anchor not in anchors(known[page])
        ):
            bad.append(target)
    return bad


def anchors(text: str) -> set[str]:
    """What headings are called in links."""
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_every_metric_and_method_has_a_page_and_no_words_are_left_over():
    assert set(words("metrics")) == set(BUILT_IN)
    assert set(words("methods")) == set(METHODS)
    for name, metric in BUILT_IN.items():
        page = MADE[f"metrics/{page_name(name)}.md"]
        assert metric.source in page
        assert page.count("\n- ") + page.startswith("- ") >= 1
    for name, method in METHODS.items():
        page = MADE[f"methods/{page_name(name)}.md"]
        for field in dataclasses.fields(method.settings):
            assert re.search(rf"`--{field.name.replace('_', '-')}[`.]", page), field.name


@pytest.mark.parametrize("name", SCENE_METRICS)
def test_every_metric_of_a_scene_is_in_one_family(name):
    assert MADE["metrics/scene.md"].count(f"| `{name}` |") == 1


@pytest.mark.parametrize("method", METHODS)
def test_every_setting_is_described(method):
    assert not [name for name, _, text in setting_rows(METHODS[method].settings) if not text]


def test_a_setting_is_described_by_the_class_that_says_it_last():
    kind = METHODS["mip-splatting"].settings
    assert "2D Mip filter" in field_docs(kind)["antialiased"]
    assert "paper: 0.2" in field_docs(kind)["dssim"]


def test_every_link_leads_somewhere():
    known = written_pages() | MADE
    bad = {name: broken_links(name, text, known) for name, text in known.items()}
    assert not {name: found for name, found in bad.items() if found}


@pytest.mark.parametrize(
    "link", ["[x](nowhere.md)", "[x](api.md#nothing)", "[x](../tests/none.py)", "[x](guides/no.md)"]
)
def test_a_broken_link_is_seen(link):
    assert broken_links("index.md", f"See {link}.", written_pages())


def test_every_written_page_is_in_the_contents():
    listed = set()
    for name, text in (written_pages() | MADE).items():
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", text, re.DOTALL):
            entries = [line for line in tree.splitlines() if line and not line.startswith(":")]
            places = [((DOCS / name).parent / entry).resolve() for entry in entries]
            listed |= {f"{place.relative_to(DOCS)}.md" for place in places}
    assert listed == set(written_pages() | MADE) - {"index.md"}


def test_the_api_page_shows_everything_that_is_exported():
    page = (DOCS / "api.md").read_text()
    for name in set(dir(sp)) - {"metrics", "__version__"}:
        assert re.search(rf"::.*\.{name}$", page, re.MULTILINE), name
    for name in BUILT_IN:
        assert re.search(rf":members:.*\b{name}\b", page), name


def test_docstrings_become_fields_and_code():
    text = [
        "Blend: a * b.",
        "",
        "Args:",
        "    x: In `[0, 1]`,",
        "        or_ None.",
        "Returns: |x|.",
    ]
    assert as_rest(text) == [
        "Blend: a \\* b.", "", ":param x: In ``[0, 1]``,", "    or\\_ None.", "",
        ":returns: \\|x\\|.", "",
    ]  # fmt: skip


def test_the_tutorials_blocks_have_what_they_printed():
    page = PAGE.read_text()
    found = blocks(page)
    assert len(found) == page.count("```python") >= 4
    assert all(printed for code, printed in found if "print" in code)
    assert len(BLOCK.findall(page)) == 2 * len(found)


@pytest.mark.slow  # two fits
def test_the_tutorial_prints_what_it_shows(tmp_path: Path, monkeypatch):
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    page = PAGE.read_text()

    def shape(text: str) -> str:
        return re.sub(r"\s+", " ", re.sub(r"\d+(\.\d+)?", "N", text))

    printed = list(outputs(page, tmp_path))
    assert [shape(text) for text in printed] == [shape(text) for _, text in blocks(page)]
    assert (tmp_path / "tutorial.png").is_file()


@pytest.mark.slow  # draws plots, imports everything
def test_the_site_builds_without_a_warning(tmp_path: Path):
    pytest.importorskip("sphinx", reason="pip install -e '.[docs]'")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in written_pages() | MADE:
        assert (tmp_path / name).with_suffix(".html").is_file()
    page = (tmp_path / "api.html").read_text()
    fetched = re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=\"https?://", page)
    assert not fetched
