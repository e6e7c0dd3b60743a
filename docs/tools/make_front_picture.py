"""The README's picture: leaderboard and slider of a report page, photographed in headless Chromium.

make bench && python docs/tools/make_front_picture.py runs/report.html
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import FloatRect, sync_playwright

from splatproof.base.errors import MissingError

PICTURE = Path(__file__).parents[1] / "images" / "front.jpg"
SCENE = "courtyard"
"""The scene that is shown: one that anybody has."""
WIDTH = 1000
"""Pixels of the page; wide tables scroll below it."""
BELOW = 12
"""Pixels that are left below the slider."""


def chromium() -> str:
    """Path of the browser. Raises: MissingError where there is no Chromium."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        raise MissingError("no Chromium on the PATH; on Debian: apt-get install chromium")
    return browser


def make(page: Path, picture: Path) -> None:
    """Photograph SCENE on a page, from its heading to the slider.

    Args:
        page: What `bench report` wrote.
        picture: JPEG that is written.
    Raises: MissingError where there is no Chromium.
    """
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        tab = opened.new_page(viewport={"width": WIDTH, "height": 2000}, device_scale_factor=1.5)
        tab.goto(page.resolve().as_uri())
        tab.wait_for_load_state("networkidle")
        scene = tab.locator("section.scene").filter(has=tab.locator("h2", has_text=SCENE)).first
        scene.locator("details").first.evaluate("one => { one.open = true }")
        scene.locator(
            ".slider"
        ).first.scroll_into_view_if_needed()  # pictures load when they are near
        tab.evaluate("scrollTo(0, 0)")
        tab.wait_for_load_state("networkidle")
        first, last = (
            scene.locator("h2").first.bounding_box(),
            scene.locator(".slider").first.bounding_box(),
        )
        assert first is not None
        assert last is not None
        top, end = first["y"] - BELOW, last["y"] + last["height"] + BELOW
        clip: FloatRect = {"x": 0, "y": top, "width": WIDTH, "height": end - top}
        tab.screenshot(path=picture, type="jpeg", quality=85, clip=clip, full_page=True)
        opened.close()


if __name__ == "__main__":
    make(Path(sys.argv[1]), PICTURE)
