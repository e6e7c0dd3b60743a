"""Make docs/street.md: python docs/tools/make_street_page.py RUNS

Reads the records of `bench run street --out RUNS` and writes docs/street.json, docs/street_pictures.json,
docs/images/street/ and the page, with docs/street_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

from comparison_files import Comparison, main
from printed_tables import Line, Printed

NOVEL = "image reconstruction"
STREET = Comparison(
    suite="street",
    title="The street suite: HDGS, PVG and static controls",
    protocol="street",
    intro="""\
The scene is `street`: a made drive of 12 moments with three cameras, four moving cars and seven people, and a
LiDAR; every 4th moment is held out. *moving* and *still* are PSNR over what truly moves and over the rest.

- `3dgs` and `scaffold-gs` know no time: what motion costs.
""",
    printed=(
        Printed(
            paper="HDGS", table="3", title="Waymo (SA), novel views, no boxes, 1280 x 1920",
            dataset="Waymo (SA)", without=NOVEL, metrics=("psnr", "ssim", "fps", "storage_mb"),
            lines=(
                Line(method="PVG", variant="box=none; 1280x1920*", row="pvg"),
                Line(method="HDGS", variant="box=none; 1280x1920*", row="hdgs"),
            ),
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    main(STREET)
