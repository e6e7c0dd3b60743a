"""The gallery knows every component and draws."""

from pathlib import Path

import cv2
import numpy as np

from splatproof.suites.gallery import anchoring, memory, pictures

ROOT = Path(__file__).parents[2]
SHARED = {"__init__", "checked", "scene", "gaussians", "render", "protocol", "result", "result_json",
          "agreement", "discontinuities", "frustum", "ground_frame"}  # fmt: skip
"""Types and tools that are no component of their own."""


def test_every_reference_module_is_on_the_page():
    shown = {module for component in pictures.COMPONENTS for module in component.modules}
    there = {
        path.relative_to(ROOT).with_suffix("").as_posix()
        for path in (ROOT / "reference").rglob("*.py") if path.stem not in SHARED
    }  # fmt: skip
    assert len(there) > 30
    assert there <= shown
    assert all((ROOT / f"{module}.py").exists() for module in shown)


def test_the_page_in_docs_is_the_one_that_the_code_makes():
    assert (ROOT / "docs/components.md").read_text() == pictures.page("images/components")


def test_every_picture_of_the_page_is_there():
    for component in pictures.COMPONENTS:
        for picture in component.pictures:
            assert (ROOT / f"docs/images/components/{picture.file}.png").exists()


def test_pictures_show_something(tmp_path):
    from splatproof.datasets.catalogue.opening import open_scene
    from splatproof.metrics.protocol_files import load_protocol

    scene = open_scene("courtyard", load_protocol("quick"))
    for draw in (anchoring.draw_hierarchy, memory.draw_spiral, anchoring.draw_support):
        path = tmp_path / "picture.png"
        draw(scene, path)
        image = cv2.imread(str(path))
        assert image is not None
        assert image.shape[1] > 1000
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 100
