"""The page itself: its HTML, styles and scripts, which are the same for every store."""

import functools
from importlib.resources import files
from pathlib import Path

STATIC = Path(__file__).parent / "static"
SCRIPTS = (
    "core", "format", "route", "known", "parts", "virtual", "keys", "theme", "zoom", "board", "runs",
    "images", "row", "run", "history", "compare", "claims", "plots", "viewer", "main",
)  # fmt: skip
"""Names of the scripts in the order in which they are loaded: plain scripts, since modules do not load
from disk."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; base-uri 'none'; form-action 'none'"
)
"""Content-Security-Policy: nothing from elsewhere, and no script but files. Plotly styles its own parts
inline and makes pictures of plots from blobs."""


@functools.cache
def page() -> str:
    """The HTML document."""
    tags = "\n".join(f'<script src="app/{name}.js"></script>' for name in SCRIPTS)
    text = (STATIC / "index.html").read_text("utf-8")
    return text.replace("POLICY", POLICY).replace("SCRIPTS", tags)


def app_file(name: str) -> bytes | None:
    """A file of the page by its name below app/; None where there is none of that name."""
    if name == "plotly.min.js":
        # the Python package is only the carrier of the browser's library; it is not imported
        return (Path(str(files("plotly"))) / "package_data" / name).read_bytes()
    return (STATIC / name).read_bytes() if name in app_names() else None


def app_names() -> list[str]:
    """Names of all files below app/ but Plotly's."""
    return ["style.css", *(f"{name}.js" for name in SCRIPTS)]
