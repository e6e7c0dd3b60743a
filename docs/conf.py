"""How Sphinx builds the site: `make docs`. Nothing is fetched."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "tools"))

project = "splatproof"
author = "the splatproof authors"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["tools", "*_findings.md"]
html_theme = "furo"
myst_heading_anchors = 4
suppress_warnings = []
