"""The dashboard in a real browser: every view, by mouse and keys, served and from disk."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from helpers import chromium
from helpers.dashboard_store import COMMITS, HOSTILE
from splatproof.reports.dashboard.site import Site
from splatproof.reports.dashboard.static_site import build_site

pytestmark = pytest.mark.skipif(chromium.CHROMIUM is None, reason=chromium.ABSENT)

# The page follows a link only once the browser says that it changed; until then the view before it stands.
FOLLOW = """link => new Promise((done) => {
  if (location.hash === link) return done();
  document.addEventListener("splatproof:shown", () => done(), { once: true });
  location.hash = link;
})"""


@dataclass(frozen=True, kw_only=True)
class Page:
    """A tab on the dashboard, and what it said and asked for."""

    tab: Any
    base: str
    said: list[str]
    asked: list[str]

    def go(self, link: str) -> None:
        """Open a link of the page and wait until its view stands."""
        self.tab.evaluate(FOLLOW, link)
        view = link.removeprefix("#/").split("?")[0]
        self.tab.locator(f"main.is-{view}").wait_for()

    def texts(self, selector: str) -> list[str]:
        """Texts of all elements that fit, once there is one."""
        self.tab.locator(selector).first.wait_for()
        return self.tab.locator(selector).all_inner_texts()

    def until(self, script: str) -> None:
        """Wait until an expression is true; Playwright's own way is refused by the page's policy."""
        end = time.monotonic() + 20
        while not self.tab.evaluate(script):
            assert time.monotonic() < end, script
            self.tab.wait_for_timeout(20)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    yield from chromium.started(tmp_path_factory.mktemp("profile"))


@pytest.fixture(scope="module")
def built(site: Site, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("static")
    build_site(site, folder, 50.0)
    return f"{folder.as_uri()}/index.html"


def opened(browser, base: str) -> Iterator[Page]:
    """The page, and the control that nothing was said or asked for from elsewhere while it was used."""
    page = Page(tab=browser.new_page(), base=base, said=[], asked=[])
    page.tab.set_viewport_size({"width": 1280, "height": 800})
    page.tab.on("console", lambda message: page.said.append(message.text))
    page.tab.on("pageerror", lambda error: page.said.append(str(error)))
    page.tab.on("request", lambda request: page.asked.append(request.url))
    page.tab.goto(base)
    page.tab.locator("main.is-board .row").first.wait_for()
    yield page
    page.tab.close()
    assert page.said == []
    here = base.removesuffix("index.html")
    assert [u for u in page.asked if not u.startswith((here, "data:", "blob:"))] == []


@pytest.fixture
def page(browser, port: int) -> Iterator[Page]:
    yield from opened(browser, f"http://127.0.0.1:{port}/")


@pytest.fixture
def from_disk(browser, built: str) -> Iterator[Page]:
    yield from opened(browser, built)


def labels(page: Page) -> list[str]:
    return page.texts("main.is-board .row .label")


def test_the_leaderboard_filters_and_says_so_in_the_link(page: Page):
    assert len(labels(page)) == 3 * 3 + 2  # the failed row has no scene but town
    assert page.texts("output.count") == ["11 rows · 3 tables"]
    page.tab.locator("select[name=scene]").select_option("beach")
    assert page.texts(".table-head h2 a") == ["beach"]
    page.tab.keyboard.press("Escape")
    page.tab.keyboard.press("/")
    page.tab.keyboard.type("slow town")
    page.tab.locator("select[name=scene]").select_option("")
    page.until("document.querySelector('output.count').textContent.startsWith('2 ')")
    assert set(page.texts(".table-head h2 a")) == {"town"}
    assert "q=slow+town" in page.tab.url
    page.tab.reload()
    assert len(labels(page)) == 2  # the link is the view


def test_unranked_rows_say_why(page: Page):
    notes = page.texts(".unranked small")
    assert notes == [
        "no mean: lacks beach, town",
        "unranked: 0 seeds; seed 0 failed: out of memory",
    ]


def test_the_leaderboard_sorts_both_ways_and_speed_stands_beside_the_error(page: Page):
    page.go("#/board?scene=town")
    heads = [text.replace("\n", " ") for text in page.texts(".heads [role=columnheader]")]
    assert heads[2].startswith("psnr [dB]")
    assert heads[4].replace("\u00a0", " ") == "render [ms] ↓"
    names = labels(page)
    assert names[0] == "3dgs"
    sort = page.tab.locator(".heads button", has_text="render")
    sort.click()
    assert labels(page)[0] == "3dgs"  # the fastest
    page.tab.locator(".heads button", has_text="render").click()
    assert labels(page)[:3] == ["slow", names[1], "3dgs"]
    assert page.tab.locator("[aria-sort=descending]").inner_text().startswith("render")


def test_a_number_leads_to_its_runs_its_record_and_the_command(page: Page):
    page.go("#/board?scene=town")
    page.tab.locator(".row .label", has_text="slow").last.click()
    page.tab.locator("main.is-row").wait_for()
    assert page.texts(".command code")[0] == "bench run quick --only 'town/slow/ours_250/seed*'"
    assert "worse" in page.texts(".verdict")
    page.tab.locator("tbody a", has_text="seed 1").click()
    page.tab.locator("main.is-run").wait_for()
    assert page.texts(".command code") == ["bench run quick --only town/slow/ours_250/seed1"]
    with page.tab.expect_popup() as popup:
        page.tab.locator(".actions a", has_text="record.json").click()
    record = popup.value
    record.wait_for_load_state()
    assert '"seed": 1' in record.content()
    record.close()


def test_the_rows_images_are_listed_and_open_in_the_viewer(page: Page):
    page.go("#/board?scene=beach")
    page.tab.locator(".row .label").first.click()
    page.tab.locator("a.pictured").first.click()
    page.tab.locator("main.is-view .both img").first.wait_for()
    widths = page.tab.evaluate(
        """async () => { const all = [...document.querySelectorAll('.both img')];
            await Promise.all(all.map((i) => i.decode())); return all.map((i) => i.naturalWidth); }"""
    )
    assert widths == [48, 48]


def viewer(page: Page) -> None:
    table = page.tab.evaluate("splatproof.known.runs.tables.find((t) => t.scene === 'town').id")
    page.go(f"#/view?t={table}")
    page.tab.locator(".both img").first.wait_for()


def current(page: Page) -> str:
    return page.tab.locator(".which bdi").inner_text()


def test_the_split_moves_by_mouse_and_keys(page: Page):
    viewer(page)
    box = page.tab.locator(".both").bounding_box()

    def cut() -> float:
        return float(page.tab.locator("input.cut").input_value())

    assert cut() == 50
    page.tab.mouse.click(box["x"] + 0.2 * box["width"], box["y"] + 0.5 * box["height"])
    assert 18 < cut() < 22
    clipped = page.tab.locator(".over").evaluate("one => getComputedStyle(one).clipPath")
    assert "0px" in clipped
    page.tab.keyboard.press("]")
    assert 23 < cut() < 27


def test_the_viewer_goes_through_images_by_keys_flips_and_shows_errors(page: Page):
    viewer(page)
    assert current(page) == "dji_0001.jpg"
    page.tab.keyboard.press("ArrowRight")
    assert current(page) == "dji_0009.jpg"
    page.tab.keyboard.press("ArrowLeft")
    page.tab.keyboard.press("ArrowLeft")
    assert current(page) == "dji_0025.jpg"
    page.tab.keyboard.press("f")
    flipped = page.tab.locator(".stage.flip .pane:not(.ahead) img")
    flipped.wait_for()
    first = flipped.get_attribute("src")
    page.tab.keyboard.press("f")
    assert flipped.get_attribute("src") != first
    assert "/truth/" in first + flipped.get_attribute("src")
    page.tab.keyboard.press("3")
    assert page.tab.locator(".stage.side .pane").count() == 2
    page.tab.keyboard.press("4")
    assert "/error/" in page.tab.locator(".stage.error img").get_attribute("src")
    assert "mode=error" in page.tab.url


def test_zoom_is_shared_by_both_panes(page: Page):
    viewer(page)
    page.tab.keyboard.press("3")
    box = page.tab.locator(".pane").first.bounding_box()
    page.tab.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 4)
    page.tab.mouse.wheel(0, -600)
    zooms = "[...document.querySelectorAll('.pane')].map((p) => [p.style.getPropertyValue('--zoom'), p.style.getPropertyValue('--x')].join())"
    page.until(f"{zooms}[0].startsWith('4')")
    assert len(set(page.tab.evaluate(zooms))) == 1
    before = page.tab.evaluate(zooms)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + box["width"] / 8, box["y"] + box["height"] / 4)
    page.tab.mouse.up()
    assert page.tab.evaluate(zooms) != before
    page.tab.keyboard.press("0")
    assert page.tab.evaluate(zooms) == ["1,0%", "1,0%"]


def test_images_sort_by_the_difference_of_two_runs(page: Page):
    viewer(page)
    runs = page.tab.evaluate(
        """splatproof.known.runs.tables.find((t) => t.scene === 'town').rows
            .filter((r) => r.runs.length).map((r) => r.runs[0])"""
    )
    page.tab.locator("select[name=a]").select_option(runs[0])
    page.tab.locator("select[name=b]").select_option(runs[1])
    page.tab.locator("select[name=by]").select_option("psnr-difference")
    page.tab.locator(".entry small", has_text="psnr −").first.wait_for()
    shown = [float(t.split()[-1].replace("−", "-")) for t in page.texts(".entry small")]
    assert shown == sorted(shown)
    assert all(value < 0 for value in shown)  # A is the better one
    assert "bad" in page.tab.locator(".caption .score").last.get_attribute("class")


def test_comparing_says_better_and_what_changed(page: Page):
    sides = page.tab.evaluate(
        "[...splatproof.known.sides.values()].filter((s) => s.kind === 'version' && s.label === '3dgs').map((s) => [s.commit, s.id])"
    )
    by_commit = dict(sides)
    page.go(f"#/compare?a={by_commit[COMMITS[0]]}&b={by_commit[COMMITS[1]]}")
    assert {"better"} < set(page.texts("tbody .verdict")) <= {"better", "equal", "not judged"}
    assert COMMITS[1] in "".join(page.texts("main td"))
    page.tab.locator("a.button", has_text="Swap").click()
    page.until("document.querySelector('tbody .verdict')?.textContent === 'worse'")


def test_history_has_a_change_point_where_it_changed(page: Page):
    page.go("#/history")
    page.tab.locator("select[name=row]").select_option("3dgs")
    page.tab.locator(".row .label").first.click()
    page.tab.locator("table .verdict.better").wait_for()
    assert "+0.80" in page.texts("table")[0]
    page.tab.locator(".js-plotly-plot .scatterlayer .point").first.wait_for()


def test_a_point_of_a_plot_leads_to_its_row(page: Page):
    table = page.tab.evaluate("splatproof.known.runs.tables.find((t) => t.scene === 'town').id")
    page.go(f"#/plots?t={table}")
    page.tab.locator(".js-plotly-plot").nth(1).wait_for()
    point = page.tab.locator(".js-plotly-plot").first.locator(".point").first
    point.wait_for()
    box = point.bounding_box()
    page.tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.tab.locator("main.is-row").wait_for()


KEY_BEFORE_CLOSE_IS_HEARD = """() => {
  document.querySelector("dialog[open]").close();  // its event comes later: the dialog still stands, closed
  document.dispatchEvent(new KeyboardEvent("keydown", { key: "j" }));
}"""


def test_keys_reach_everything(page: Page):
    page.tab.keyboard.press("?")
    assert page.tab.locator("dialog[open]").count() == 1
    page.tab.keyboard.press("Escape")
    assert page.tab.locator("dialog[open]").count() == 0
    page.tab.keyboard.press("?")
    page.tab.evaluate(KEY_BEFORE_CLOSE_IS_HEARD)
    assert page.tab.locator(".item.current").count() == 1
    page.tab.keyboard.press("j")
    page.tab.keyboard.press("k")
    assert page.tab.locator(".item.current .label").inner_text() == "3dgs"
    page.tab.keyboard.press("Enter")
    page.tab.locator("main.is-row").wait_for()
    page.tab.keyboard.press("g")
    page.tab.keyboard.press("i")
    page.tab.locator("main.is-images").wait_for()
    assert page.texts("output.count") == ["72 images"]


def test_dark_mode_follows_the_system_and_the_switch(page: Page):
    def light() -> bool:
        colour = page.tab.evaluate("getComputedStyle(document.body).backgroundColor")
        return colour == "rgb(255, 255, 255)"

    page.tab.emulate_media(color_scheme="dark")
    assert not light()
    page.tab.locator(".switch").click()
    assert light()
    page.tab.reload()
    page.tab.locator(".row").first.wait_for()
    assert light()
    page.tab.keyboard.press("t")
    assert not light()
    page.tab.evaluate("localStorage.clear()")


@pytest.mark.parametrize(
    "view", ["board", "runs", "images", "history", "compare", "claims", "plots", "view"]
)
def test_a_phone_need_not_scroll_sideways(page: Page, view: str):
    page.tab.set_viewport_size({"width": 360, "height": 740})
    page.go(f"#/{view}")
    page.tab.wait_for_timeout(60)
    wide = page.tab.evaluate(
        "[document.documentElement.scrollWidth, document.querySelector('main').scrollWidth]"
    )
    assert wide == [360, 360]


def test_names_are_text_whatever_they_hold(page: Page):
    page.go("#/board?scene=town")
    assert HOSTILE in "".join(page.tab.locator(".row .label").all_text_contents())
    page.tab.locator(".row .label", has_text="onerror").click()
    page.tab.locator("main.is-row h2", has_text="Settings").wait_for()
    assert HOSTILE in page.tab.locator("h1").text_content()
    assert page.tab.evaluate("document.querySelectorAll('img[src=x], [onerror]').length") == 0


def test_everything_that_can_be_used_has_a_name(page: Page):
    for view in ("board", "view", "compare", "plots"):
        page.go(f"#/{view}")
        nameless = page.tab.evaluate(
            """() => [...document.querySelectorAll("button, select, input, a, [role=grid], [role=listbox]")]
                .filter((one) => !(one.getAttribute("aria-label") || one.textContent.trim()
                    || one.querySelector("img") || one.closest("label")?.textContent.trim()))
                .map((one) => one.outerHTML.slice(0, 80))"""
        )
        assert nameless == []


def test_the_static_page_has_the_same_from_disk(from_disk: Page):
    assert len(labels(from_disk)) == 11
    viewer(from_disk)
    assert (
        from_disk.tab.locator(".both img").first.evaluate(
            "async (i) => { await i.decode(); return i.naturalWidth; }"
        )
        == 48
    )
    from_disk.go("#/history")
    from_disk.tab.locator(".row .label", has_text="3dgs").first.click()
    from_disk.tab.locator("table .verdict.better").wait_for()
    from_disk.tab.locator("td a", has_text="compare").first.click()
    from_disk.tab.locator("main.is-compare").wait_for()
    assert {"better"} < set(from_disk.texts("tbody .verdict")) <= {"better", "equal", "not judged"}
    from_disk.go("#/plots")
    from_disk.tab.locator(".js-plotly-plot .point").first.wait_for()


def test_the_watch_on_requests_sees_one(browser, built: str):
    """The control: a page that asks for something else is seen, and its policy refuses the answer."""
    watched = opened(browser, built)
    page = next(watched)
    page.tab.evaluate(
        "new Promise((done) => { const i = new Image(); i.onerror = done; i.src = 'http://127.0.0.1:9/x.png'; })"
    )
    with pytest.raises(AssertionError):
        next(watched)
