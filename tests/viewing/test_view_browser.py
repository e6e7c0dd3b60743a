"""The viewer in a real browser: frames arrive, and what is done by hand changes them."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch

from helpers import chromium
from helpers.viewer import serving
from splatproof.methods.contracts.reconstruction import Reconstruction
from splatproof.reference.types.render import RenderOutput
from splatproof.reference.types.scene import View
from splatproof.viewing.stage import Shown, Stage

pytestmark = pytest.mark.skipif(chromium.CHROMIUM is None, reason=chromium.ABSENT)
HOSTILE = "<img src=x onerror=alert(1)>"


@dataclass(frozen=True, kw_only=True, eq=False)
class Drifting:
    """A model that moves sideways by a tenth of a unit a second."""

    still: Any
    kind: str = "drifting"

    @property
    def primitives(self) -> int:
        return self.still.primitives

    def render(self, view: View, background: torch.Tensor | None = None) -> RenderOutput:
        assert view.time is not None
        pose = view.camera.world_to_camera.clone()
        pose[0, 3] += 0.1 * view.time
        moved = replace(view.camera, world_to_camera=pose)
        return self.still.render(replace(view, camera=moved), background)

    def store(self, folder):
        raise AssertionError("a page stores nothing")


@dataclass(frozen=True, kw_only=True)
class Page:
    """A tab on the viewer."""

    tab: Any

    def until(self, script: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + 30
        while not self.tab.evaluate(script):
            assert time.monotonic() < end, script
            self.tab.wait_for_timeout(20)

    def still(self) -> None:
        """Wait for the sharp frame of what is wished now."""
        self.until("splatproof.frames.rests()")

    def picture(self) -> list[int]:
        """Colours of a few rows of the picture, once it is still."""
        self.still()
        return self.tab.evaluate(
            """() => { const c = document.querySelector('canvas.picture'), all = [];
            const copy = Object.assign(document.createElement('canvas'), { width: c.width, height: c.height });
            const p = copy.getContext('2d', { willReadFrequently: true }); p.drawImage(c, 0, 0);
            for (const y of [0.4, 0.5, 0.6]) for (let i = 0; i < 24; i++)
              all.push(...p.getImageData(Math.floor(c.width * i / 24), Math.floor(c.height * y), 1, 1).data.slice(0, 3));
            return all; }"""
        )

    def middle(self) -> tuple[float, float]:
        box = self.tab.locator(".stage").bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag(self, dx: float, dy: float) -> None:
        x, y = self.middle()
        self.tab.mouse.move(x, y)
        self.tab.mouse.down()
        self.tab.mouse.move(x + dx / 2, y + dy / 2)
        self.tab.mouse.move(x + dx, y + dy)
        self.tab.mouse.up()


def apart(one: list[int], other: list[int]) -> float:
    """Mean difference of two pictures, of 255."""
    return sum(abs(a - b) for a, b in zip(one, other, strict=True)) / len(one)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    yield from chromium.started(tmp_path_factory.mktemp("profile"))


@pytest.fixture
def hostile(stage: Stage) -> Stage:
    """Two models, one with a hostile name, and a scene with a hostile name and moments."""
    scene = stage.scene
    assert scene
    views = tuple(
        replace(view, time=float(i), name=f"{HOSTILE}{view.name}")
        for i, view in enumerate(scene.views)
    )
    moving = Drifting(still=stage.models[0].model)
    assert isinstance(moving, Reconstruction)
    models = (Shown(name=HOSTILE, model=moving), stage.models[1])
    return Stage(models, replace(scene, views=views, name=HOSTILE), torch.zeros(3))


@pytest.fixture
def page(browser, hostile: Stage) -> Iterator[Page]:
    said, asked = [], []
    with serving(hostile) as port:
        tab = browser.new_page()
        tab.set_viewport_size({"width": 640, "height": 420})
        tab.on("console", lambda message: said.append(message.text))
        tab.on("pageerror", lambda error: said.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto(f"http://127.0.0.1:{port}/")
        found = Page(tab=tab)
        found.until("splatproof.frames?.shown")
        yield found
        tab.close()
    assert said == []
    assert [
        u for u in asked if not u.startswith((f"http://127.0.0.1:{port}/", "data:", "blob:"))
    ] == []


def test_a_drag_turns_and_the_wheel_comes_nearer(page: Page):
    start = page.picture()
    assert max(start) > 60
    page.drag(120, 10)
    turned = page.picture()
    assert apart(start, turned) > 3
    page.tab.mouse.wheel(0, -300)
    assert apart(turned, page.picture()) > 3
    page.tab.keyboard.press("r")
    assert apart(start, page.picture()) < 0.01


def test_fly_looks_around_from_where_one_stands(page: Page):
    page.still()
    eye = page.tab.evaluate("splatproof.camera.eye")
    page.tab.keyboard.press("f")
    page.drag(60, 0)
    assert page.tab.evaluate("splatproof.camera.eye") == pytest.approx(eye, abs=1e-9)
    page.tab.keyboard.down("w")
    page.until(f"Math.abs(splatproof.camera.eye[2] - {eye[2]}) > 0.05")
    page.tab.keyboard.up("w")


def test_one_stands_exactly_where_a_photo_was_taken(page: Page, hostile: Stage):
    assert hostile.scene
    for number, view in enumerate(hostile.scene.views):
        told = page.tab.evaluate(
            "i => { splatproof.camera.stand(splatproof.state.views[i]); return splatproof.camera.now(); }",
            number,
        )
        camera = view.camera
        assert told["eye"] == pytest.approx(camera.centre.tolist(), abs=1e-9)
        assert told["forward"] == pytest.approx(camera.rotation[2].tolist(), abs=1e-9)
        assert told["up"] == pytest.approx((-camera.rotation[1]).tolist(), abs=1e-9)


def test_a_camera_straight_down_keeps_its_upper_edge(page: Page):
    told = page.tab.evaluate(
        """() => { const view = structuredClone(splatproof.state.views[1]), u = splatproof.state.place.up;
        const right = [0.6, 0, 0.8], forward = u.map((x) => -x), V = splatproof.vector;
        view.rotation = [right, V.cross(forward, right), forward];
        splatproof.camera.stand(view); const b = splatproof.camera.now();
        return [b.right, b.forward]; }"""
    )
    assert told[0] == pytest.approx([0.6, 0, 0.8], abs=1e-9)


def test_a_click_on_a_camera_shows_its_photo_beside_the_render(page: Page):
    page.still()
    for _ in range(4):
        page.tab.keyboard.press("-")
    page.tab.mouse.move(*page.middle())
    page.tab.mouse.wheel(0, 700)
    page.still()
    places = page.tab.evaluate("splatproof.overlay.places()")
    assert len(places) == 6
    place = places[-1]
    page.tab.mouse.click(place["x"], place["y"])
    page.until("document.querySelector('.beside img.render')?.naturalWidth > 0")
    page.until("document.querySelector('.beside img.photo').naturalWidth > 0")
    shown = page.tab.evaluate("splatproof.beside.view")
    told = page.tab.locator(".beside figcaption").all_inner_texts()
    assert told[0].startswith(f"{HOSTILE}{shown}.png")
    assert "psnr" in told[1]
    page.tab.locator(".beside button", has_text="Next").click()
    page.until(f"splatproof.beside.view === {(shown + 1) % 6}")
    page.tab.keyboard.press("Escape")
    assert page.tab.locator(".beside").is_hidden()


def test_the_split_shows_two_models_and_moves(page: Page):
    one = page.picture()
    page.tab.keyboard.press("x")
    both = page.picture()
    half = 12 * 3
    left = lambda picture: picture[:half]
    right = lambda picture: picture[half : 2 * half]
    assert apart(left(one), left(both)) < 1
    assert apart(right(one), right(both)) > 5
    box = page.tab.locator(".divider").bounding_box()
    page.tab.mouse.move(box["x"] + 10, box["y"] + 40)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] - 190, box["y"] + 40)
    page.tab.mouse.up()
    assert float(page.tab.locator(".divider").get_attribute("aria-valuenow")) < 20
    assert apart(left(one), left(page.picture())) > 5
    page.tab.locator(".divider").focus()
    page.tab.keyboard.press("ArrowRight")
    page.until("splatproof.choice.split > 0.02")


def test_the_time_slider_moves_what_moves(page: Page):
    page.still()
    assert page.tab.evaluate("splatproof.state.times") == [0, 5]
    early = page.picture()
    page.tab.locator("input[aria-label='Time in seconds']").evaluate(
        "slider => { slider.value = 5; slider.dispatchEvent(new Event('input')); }"
    )
    assert apart(early, page.picture()) > 3


def test_modes_are_chosen_by_key_and_missing_ones_say_why(page: Page):
    colour = page.picture()
    page.tab.keyboard.press("2")
    assert apart(colour, page.picture()) > 5
    assert page.tab.locator("input[value=depth]").is_checked()
    blocks = page.tab.locator("label", has_text="Blocks")
    assert blocks.locator("input").is_disabled()
    assert "not trained in blocks" in blocks.get_attribute("title")
    page.tab.keyboard.press("3")
    assert page.tab.locator("input[value=depth]").is_checked()


def test_names_are_text_and_help_lists_the_keys(page: Page):
    assert page.tab.locator(".scene").inner_text() == HOSTILE
    assert page.tab.locator("img").count() == 0
    page.tab.keyboard.press("?")
    assert "light or dark" in page.tab.locator("dialog").inner_text()
    page.tab.keyboard.press("Escape")
    dark = "splatproof.dark()"
    page.tab.wait_for_function(
        "!document.querySelector('dialog')"
    )  # while it is there keys are its own
    before = page.tab.evaluate(dark)
    page.tab.keyboard.press("t")
    page.tab.wait_for_function(f"{dark} !== {str(before).lower()}")


def test_a_snapshot_that_comes_is_shown(page: Page, hostile: Stage):
    before = page.picture()
    page.tab.evaluate("splatproof.frames.wish(true)")
    hostile.models = (hostile.models[1], hostile.models[1])
    page.tab.evaluate("splatproof.frames.wish(true)")
    assert apart(before, page.picture()) > 5


def test_an_end_of_the_server_is_told(browser, stage: Stage):
    tab = browser.new_page()
    with serving(stage) as port:
        tab.goto(f"http://127.0.0.1:{port}/")
        Page(tab=tab).until("splatproof.frames?.shown")
    tab.evaluate("splatproof.frames.wish()")
    Page(tab=tab).until("document.querySelector('.trouble').textContent.includes('still running')")
    tab.close()
