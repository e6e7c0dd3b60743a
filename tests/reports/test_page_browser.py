"""The page in a real browser: it shows, slides and sorts, and asks the network for nothing."""

import datetime
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers import chromium
from splatproof.reports.leaderboard import build_tables
from splatproof.reports.page import render_page
from splatproof.reports.store import StoredResult

pytestmark = pytest.mark.skipif(chromium.CHROMIUM is None, reason=chromium.ABSENT)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    yield from chromium.started(tmp_path_factory.mktemp("profile"))


@pytest.fixture(scope="module")
def file(stored: list[StoredResult], tmp_path_factory: pytest.TempPathFactory) -> Path:
    tables = build_tables([one.result for one in stored])
    text = render_page(tables, stored, stored[0].uri, datetime.datetime.now(datetime.UTC))
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def opened(browser, file: Path) -> Iterator:
    """The page, and the control that nothing was logged or asked for while the test used it."""
    tab = browser.new_page()
    said, asked = [], []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(file.as_uri())
    yield tab
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [file.as_uri()]
    tab.close()


def widths(tab) -> list[int]:
    """Natural widths of the visible pictures, once all have been decoded."""
    return tab.evaluate(
        """async () => {
            const shown = [...document.images].filter((image) => image.src && !image.hidden);
            await Promise.all(shown.map((image) => image.decode()));
            return shown.map((image) => image.naturalWidth);
        }"""
    )


def test_every_picture_shows(opened):
    assert widths(opened) == [80] * 2 * 5  # two scenes; the slider has two, three stand below
    names = opened.locator("select.image").first.locator("option").all_text_contents()
    assert len(names) == 4
    sources = set()
    for name in names:
        opened.locator("select.image").first.select_option(name)
        assert set(widths(opened)) == {80}
        sources.add(opened.locator("img.over").first.get_attribute("src"))
    assert len(sources) == 4


def test_the_slider_moves_by_mouse_and_by_keyboard(opened):
    stage = opened.locator(".stage").first

    def cut() -> str:
        return stage.evaluate("stage => getComputedStyle(stage.querySelector('.over')).clipPath")

    stage.scroll_into_view_if_needed()
    middle, box = cut(), stage.bounding_box()
    opened.mouse.click(box["x"] + 0.2 * box["width"], box["y"] + 0.5 * box["height"])
    left = cut()
    assert middle != left
    assert 15 <= int(stage.locator("input").input_value()) <= 25
    stage.locator("input").focus()
    opened.keyboard.press("End")
    assert cut() not in (middle, left)
    assert stage.locator("input").input_value() == "100"


def test_truth_can_be_set_against_the_error_map_and_another_method(opened):
    box = opened.locator(".compare").first
    under = box.locator("img.under")
    before = under.get_attribute("src")
    box.locator("select.against").select_option("error map")
    error = under.get_attribute("src")
    assert under.get_attribute("alt").startswith("Error map of dji_0001.jpg")
    box.locator("select.row").select_option("slow")
    assert len({before, error, under.get_attribute("src")}) == 3
    assert opened.locator(".own:visible caption").first.inner_text().startswith("slow")
    assert "psnr" in box.locator(".slider figcaption").inner_text()


def test_the_arrow_buttons_go_round(opened):
    image = opened.locator("select.image").first
    opened.locator("button.previous").first.click()
    assert image.input_value() == "dji_0025.jpg"
    opened.locator("button.next").first.click()
    assert image.input_value() == "dji_0001.jpg"


def test_the_table_sorts_both_ways_by_number_and_by_keyboard(opened):
    table = opened.locator(".sortable:visible").first

    def column(number: int) -> list[str]:
        return table.locator(f"tbody tr > :nth-child({number})").all_inner_texts()

    names, scores = column(1), [float(text) for text in column(2)]
    assert scores != sorted(scores)  # else sorting could not be seen
    button = table.locator("thead button").nth(1)
    button.click()
    assert [float(text) for text in column(2)] == sorted(scores)
    assert table.locator("thead th").nth(1).get_attribute("aria-sort") == "ascending"
    button.focus()
    opened.keyboard.press("Enter")
    assert [float(text) for text in column(2)] == sorted(scores, reverse=True)
    table.locator("thead button").first.click()
    assert column(1) == sorted(names)


def test_a_name_in_the_table_picks_the_image(opened):
    opened.locator(".sortable:visible button.show").nth(2).click()
    assert opened.locator("select.image").first.input_value() == "dji_0017.jpg"
    assert opened.locator("tr.current:visible").first.inner_text().startswith("dji_0017.jpg")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_need_not_scroll_sideways_and_text_has_contrast(opened, scheme: str):
    opened.emulate_media(color_scheme=scheme)
    opened.set_viewport_size({"width": 360, "height": 740})
    assert opened.evaluate("document.documentElement.scrollWidth") == 360
    ratios = opened.evaluate(CONTRAST)
    # WCAG 2.2, 1.4.3: 4.5 for text of this size
    assert {name: ratio for name, ratio in ratios.items() if ratio < 4.5} == {}


CONTRAST = """() => {
    const light = (text) => {
        const [r, g, b] = text.match(/[\\d.]+/g).map((v) => {
            const c = v / 255;
            return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
        });
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const page = light(getComputedStyle(document.body).backgroundColor);
    const found = {};
    for (const name of ["body", ".meta", "td", "tr.unranked td", "a", "summary", ".show"]) {
        const element = document.querySelector(name);
        if (!element) continue;
        const [low, high] = [page, light(getComputedStyle(element).color)].sort((a, b) => a - b);
        found[name] = (high + 0.05) / (low + 0.05);
    }
    return found;
}"""


def test_everything_that_can_be_used_has_a_name(opened):
    nameless = opened.evaluate(
        """() => [...document.querySelectorAll("button, select, input, [role]")]
            .filter((one) => !(one.getAttribute("aria-label") || one.textContent.trim()
                || one.closest("label")?.textContent.trim()))
            .map((one) => one.outerHTML.slice(0, 80))"""
    )
    assert nameless == []
    assert opened.evaluate("[...document.images].filter((i) => i.src && !i.alt).length") == 0


def test_the_watch_on_requests_sees_one(browser, tmp_path: Path):
    """The control: a page that does ask for something else is seen."""
    (tmp_path / "bad.html").write_text('<script>console.log("x")</script><img src="other.png">')
    tab, said, asked = browser.new_page(), [], []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto((tmp_path / "bad.html").as_uri())
    assert "x" in said
    assert len(asked) == 2
    tab.close()
