"""Make docs/sparse.md: python docs/tools/make_sparse_page.py RUNS

Reads the records of `bench run sparse --out RUNS` and writes docs/sparse.json, docs/sparse_pictures.json,
docs/images/sparse/ and the page, with docs/sparse_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

import json
import sys

from comparison_files import DOCS, Comparison, main
from printed_tables import Line, Printed
from views_plot import draw_views

from splatproof.reports.measured import Measured

SPARSE = Comparison(
    suite="sparse",
    title="The sparse suite: few views from the air",
    protocol="aerial_sparse_3",
    scene="aerial-sparse/houses",
    intro="""\
Eight made aerial scenes from 3, 5, 7 and 9 views and three real flights from 3, 6 and 9 photos spread over them;
sparse points are triangulated from the training views alone, at given poses, and few come out of three. So every row
starts from points matched between the training photos besides (DPGS's initialisation); `@sfm` does without. Where nothing
comes out, 10,000 are drawn at random.

- `3dgs`: the release's method, with no idea that views are few.
- `auto`: the control, ours: 3dgs as method auto plans it, told not to complete depths (which it would here), 3,000 steps, from the
  same matched points, with a random background, a fifth of the Gaussians hidden at the end, a pull on opacities, and
  bounds on number and scale.
- `fsgs` without a depth prior: unpooling and its density control. `~depth-own`: its depth term on our own network's
  prior, which was trained on other kinds of worlds (**out of domain** in every scene of this suite; records say so in
  `depth_prior_domain`); `~depth-oracle+noise` and `~depth-oracle`: true depth, disturbed or not, as bounds, of `stratosplat` too.
- `dropgaussian`: a growing share of Gaussians hidden in each step.
- `cor-gs`: two fields that prune and regularise each other.
- `stratosplat`: depths completed photo by photo under a layered memory, virtual Gaussians on planes beside explicit ones;
  edges of the photo say where depth may change. `@own`: completed, as in the paper, from what a network says, here a small one of ours that is
  given photo and matched points; it was trained on such worlds of other seeds (**in domain** on made scenes, out of domain on the
  real flights; records say so in `completion network`). `@own-explicit` without virtual Gaussians, `@own-regularised` with what `@regularised` has;
  `@explicit` without these, `@explicit-independent` each photo by itself, `@explicit-dense` from matched points;
  `@accumulate` keeps every completed depth. `@dropout` and `@regularised` are ours: a fifth of the explicit Gaussians
  hidden at the end; half of them, and a random background.
- `~pose-noise-L1` to `L3`: the training cameras turned by 0.5, 1 or 2 degrees and shifted by 0.1, 0.2 or 0.5 % of the extent.
""",
    printed=(
        Printed(
            paper="StratoSplat", table="1", title="LEVIR-NVS, three views, mean of 16 scenes",
            dataset="LEVIR-NVS", metrics=("psnr",), protocol="aerial_sparse_3",
            lines=(
                Line(method="3DGS", variant="3 views", row="3dgs@sfm"),
                Line(method="FSGS", variant="3 views", row="fsgs~depth-own"),
            ),
        ),
    ),
)  # fmt: skip

NAMES = ("3dgs", "fsgs", "dropgaussian", "cor-gs", "auto", "stratosplat@own")
"""Rows whose gain by more views is drawn."""
VIEWS = {number: f"aerial_sparse_{number}" for number in (3, 5, 7, 9)}
SCENES = tuple(f"aerial-sparse/{name}" for name in ("houses", "church", "mountain", "stadium"))
"""Scenes that the rows were run on from every number of views."""

if __name__ == "__main__":
    main(SPARSE)
    if len(sys.argv) > 1:
        rows = [Measured(**row) for row in json.loads((DOCS / "sparse.json").read_text("utf-8"))]
        draw_views(DOCS / "images" / "sparse" / "views.png", rows, NAMES, VIEWS, SCENES)
