"""Make docs/street.md: python docs/tools/make_street_page.py RUNS

Reads the records of `bench run street --out RUNS` and writes docs/street.json, docs/street_pictures.json,
docs/images/street/ and the page, with docs/street_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

import sys
from pathlib import Path

from comparison_files import DOCS, Comparison, main
from moment_lines import draw_moments
from picture_lines import draw_lines
from printed_tables import Line, Printed

from splatproof.metrics.protocol_files import load_protocol

NOVEL = "image reconstruction"
STREET = Comparison(
    suite="street",
    title="The street suite: HDGS, PVG and static controls",
    protocol="street",
    scene="street",
    units="views of held-out moments",
    intro="""\
The scene is `street`: a made drive of 12 moments with three cameras, four moving cars and seven people, and a
LiDAR; every 4th moment is held out. *moving* and *still* are PSNR over what truly moves and over the rest.

`street/second` and `street/third` are drives past other houses, cars and people: pvg against 3dgs and hdgs against pvg are judged by the
mean of the three. Protocol `street_lane_shift` trains on all moments and shows two of them from 1.5 m to the right and
2 and 3.5 m to the left, where a car in the next lane would be.

- `3dgs`, `mip-splatting`, `absgs` and `scaffold-gs` know no time: what motion costs. They have no sky and no LiDAR either.
- `pvg`: Gaussians that swing and fade; `@no-lidar` reads no sweep, `@no-sky` learns no sky, `@no-time-growth` adds none in time.
- `@affine`: an exposure of each photo, where all photos of this drive have the same.
- `hdgs`: anchors in three layers that move, K = 12 Gaussians an initial anchor; `@n2`, `@n4` layers, `-leaf` with
  K = 6 for each anchor of the last layer, `-even` that from 20,000, 5,000 and 2,500 anchors (`@n5`), as many Gaussians as three
  layers start from; `@ice-off`, `@conv`, `@no-mod`, `@no-gate` parts of the consistency step; `@no-lds` without local
  depth supervision; `@gds` with the ranks of a depth prior (`~depth-oracle+noise`: true depth, warped, blurred and
  disturbed as networks do; `~depth-lidar`: sweeps, completed; `~depth-own`: our network; `~depth-sweep`: matched photos); `@uniform` growing; `@no-ur` keeps anchors out of view; `@static`: layer 0 does not move;
  `@no-lidar` lacks the LiDAR's term and still starts from sweeps, `@no-sweeps` reads none, as `pvg@no-lidar`; `@no-sky` learns no sky;
  `@no-smoothing` draws every step at its photo's own time; `@24k` starts from at most 24,000 anchors in place of 10,000.
  `@ours`: two layers of at most 36,000 anchors with six Gaussians each, a sky that pixels mostly covered do not teach, other rates of
  scales and offsets; chosen on a drive that is in no table. `@ours-...` are these settings without a part (`-ice-off`, ...), with a prior's ranks
  (`-gds`), with as many Gaussians shared out by three or four layers (`-n3`, `-n4`), and with twice the steps (`-double`, beside `pvg@double`).
  All other rows have the papers' sky.
""",
    printed=(
        Printed(
            paper="HDGS", table="3", title="Waymo (SA), novel views, no boxes, 1280 x 1920",
            dataset="Waymo (SA)", without=NOVEL, metrics=("psnr", "ssim", "fps", "storage_mb"), protocol="street",
            lines=(
                Line(method="PVG", variant="box=none; 1280x1920*", row="pvg"),
                Line(method="HDGS", variant="box=none; 1280x1920*", row="hdgs@gds~depth-oracle+noise"),
            ),
        ),
        Printed(
            paper="HDGS", table="5", title="ablation, scene not stated",
            metrics=("psnr", "ssim", "storage_mb"), protocol="street",
            lines=(
                Line(method="HDGS", variant="full", row="hdgs@gds~depth-oracle+noise"),
                Line(method="HDGS", variant="w/o GDS", row="hdgs"),
                Line(method="HDGS", variant="w/o ICE", row="hdgs@ice-off"),
                Line(method="HDGS", variant="w/o LDS", row="hdgs@no-lds"),
                Line(method="HDGS", variant="w/o GDG", row="hdgs@uniform"),
                Line(method="HDGS", variant="w/o UR", row="hdgs@no-ur"),
            ),
        ),
        Printed(
            paper="HDGS", table="8", title="layers, scene not stated",
            metrics=("psnr", "fps", "storage_mb"), protocol="street",
            lines=(
                Line(method="HDGS", variant="N=2", row="hdgs@n2"),
                Line(method="HDGS", variant="N=3", row="hdgs"),
                Line(method="HDGS", variant="N=4", row="hdgs@n4"),
            ),
        ),
    ),
)  # fmt: skip

SHOWN = tuple(
    f"{row}/street/seed0/{kind}" for row in ("pvg", "hdgs") for kind in ("renders", "errors")
)
"""Lines of a picture of another drive, below the photos."""
MOMENTS = {
    "moments": ("3dgs", "mip-splatting", "absgs", "scaffold-gs", "pvg", "hdgs", "hdgs@ours"),
    "moments_parts": (
        "3dgs@affine", "scaffold-gs@affine", "pvg@affine", "pvg@no-time-growth", "hdgs@affine", "hdgs@no-sky",
        "hdgs@n5-even",
    ),
}  # fmt: skip
"""Strips of consecutive moments: the rows of each."""

if __name__ == "__main__":
    main(STREET)
    if len(sys.argv) > 1:
        images, street = DOCS / "images" / "street", Path(sys.argv[1]) / "street" / "street"
        for name in ("second", "third"):
            draw_lines(images / f"{name}.jpg", street / name, SHOWN)
        lanes = [
            f"{row}/street_lane_shift/seed0/renders" for row in ("3dgs", "pvg", "hdgs", "hdgs@ours")
        ]
        draw_lines(images / "lanes.jpg", street, lanes)
        for name, shown in MOMENTS.items():
            folders = {row: street / row / "street" / "seed0" for row in shown}
            draw_moments(images / f"{name}.jpg", "street", load_protocol("street"), folders, "left")
