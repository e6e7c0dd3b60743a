"""docs/data_sets.md names only what is there, and all of it."""

import re
from pathlib import Path

from splatproof.datasets.catalogue.opening import ADAPTERS
from splatproof.datasets.catalogue.registry import list_scenes
from splatproof.metrics.protocol_files import protocol_names
from splatproof.suites.published.rows import published_suites

PAGE = (Path(__file__).parents[3] / "docs" / "data_sets.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.split("|")[1:-1]] for line in PAGE.splitlines() if "|" in line
]


def test_every_layout_protocol_scene_and_suite_on_the_page_exists():
    names = {scene.name for scene in list_scenes() if scene.kind == "public"}
    layouts = {adapter.name for adapter in ADAPTERS}
    seen: set[str] = set()
    meant = {scene.name: set(scene.protocols) for scene in list_scenes()}
    for _, scenes, layout, protocols, _ in ROWS[2:]:
        sets = re.findall(r"`([^`]+)/\*`", scenes)
        for one in sets:
            found = {name for name in names if name.startswith(f"{one}/")}
            assert found, one
            seen |= found
            for name in found:
                assert meant[name] == set(re.findall(r"`([^`]+)`", protocols))
        assert any(name in layout for name in layouts)
        assert set(re.findall(r"`([^`]+)`", protocols)) <= set(protocol_names())
    assert seen == names
    assert all(re.search(rf"\b{name}\b", PAGE) for name in layouts)
    assert all(suite in PAGE for suite in published_suites())
