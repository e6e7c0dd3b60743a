"""Make docs/unseen.md: python docs/tools/make_unseen_page.py RUNS

Reads the records of `bench run unseen --out RUNS` and writes docs/unseen.json, docs/unseen_pictures.json,
docs/images/unseen/ and the page, with docs/unseen_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

from comparison_files import Comparison, main
from printed_tables import Line, Printed

UNSEEN = Comparison(
    suite="unseen",
    title="The unseen suite: a city from above, looked at from where nobody flew",
    protocol="unseen",
    scene="city",
    earlier={"refine.clean.largest_scale": 50.0},  # rows in blocks are not refined here, and so not cleaned
    intro="""\
The scene is `city` at its small size: photographed from a high flight that looks straight down. Protocol `unseen` trains on all of
it and holds out low oblique views and facades that no photo shows; `default` holds out every 8th view from above. `city/medium`
has five times the blocks, 143 photos and 48 views that no photo shows, all 320 pixels wide (protocol `city_unseen`). Real flights
(`caliterra`, `seneca`, protocol `city_400`: every 8th photo held out) show what it costs or gains where photos look; nobody photographed them from beside.

- `3dgs`: the release's method.
- `dpgs`: points of matched photos at its start, and side views from a spiral (one around the whole city; the paper has one
  around each block, as `dpgs-partition@whole` here) in its second half, refined by warping the
  photo that sees most of them; `@own` by our small network, trained on cities and on aerial-sparse worlds, of other seeds
  (**in domain**: the same kind of world); `@unrefined` not at all, so it trains on its own renders. What the render has no surface for
  (sky, holes) is left alone; `@fill` trains on what the warp puts there. `@di` has the points alone, `@ds` the side views alone, `@none` neither.
  `@di-true` is `@di` with the true depth for matches: a bound on all matchers; `@di-own` has those of our own network.
- `@di-tuned` is `@di` with method auto's bound on scales and opacity term, `@di-quick` learns everything but positions and opacities four
  times as fast as well, as method auto does where photos are looked at seldom; `@di-quick-flat` flattens what is thick along photos' rays
  (`thickest`), `@di-quick-bounded` also bounds scales more narrowly on start points (`widest_at_points`), which is auto's plan.
- Rows whose names end in `double` have twice the steps, `half` half of them (in blocks, of the coarse model too).
- `citygaussian`, `vastgaussian`, `blockgaussian` and `dpgs-partition` (blocks of equal load): four blocks after a coarse model;
  `dpgs-partition@whole` is DPGS whole, with matched points and side views of each block. They were recorded before the processes of
  blocks were counted, and have no processor seconds or peak memory.
""",
    printed=(
        Printed(
            paper="DPGS", table="7", title="ablation", metrics=("psnr",), protocol="unseen",
            lines=(
                Line(method="DPGS", variant="w/o DI, w/o DS", row="dpgs@none-double"),
                Line(method="DPGS", variant="DI only", row="dpgs@di-double"),
                Line(method="DPGS", variant="DS only", row="dpgs@ds-double"),
                Line(method="DPGS", variant="DI+DS (full)", row="dpgs@double"),
            ),
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    main(UNSEEN)
