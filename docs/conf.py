"""How Sphinx builds the site: `make docs`. Nothing is fetched, and every warning is an error there."""

import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "tools"))

from house_docstrings import as_rest
from make_reference_pages import write_pages
from metric_plots import draw

project = "splatproof"
html_title = "splatproof"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["tools", "words", "*_findings.md"]
html_theme = "furo"
html_show_sphinx = False
html_copy_source = False
html_show_search_summary = False  # a page opened from disk may not read the others
html_show_copyright = False
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
add_module_names = False


def _docstring(
    _app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    lines[:] = as_rest(lines)


def setup(app: Any) -> None:
    """Write the generated pages, and let autodoc read our docstrings."""
    write_pages(draw(HERE / "metrics"))
    app.connect("autodoc-process-docstring", _docstring)
