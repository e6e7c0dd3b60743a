"""Make docs/tunnel.md: python docs/tools/make_tunnel_page.py RUNS

Reads the records of `bench run tunnel --out RUNS` and writes docs/tunnel.json, docs/tunnel_pictures.json,
docs/images/tunnel/ and the page, with docs/tunnel_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from comparison_files import DOCS, Comparison, main
from printed_tables import Line, Printed
from strips import QUALITY, Image

TUNNEL = Comparison(
    suite="tunnel",
    title="The tunnel suite: DLG-GS, Scaffold-GS and exposure baselines",
    protocol="tunnel",
    scene="tunnel",
    intro="""\
The scene is `tunnel`: a rock tunnel that a rig of six cameras drives through, lit by the rig's own lamps alone. One
stop of eight is held out with all its cameras. Protocols `tunnel`, `tunnel_half` and `tunnel_oracle` are one training,
shown in the light of the nearest training view, in one fitted to the left half of each photo (the right half is
scored), or in one fitted to all of it (one seed, never ranked). `tunnel_relit` shows views under lamps that stand elsewhere.

- `3dgs` and `scaffold-gs`; `@gain` and `@affine` learn an exposure of each photo: the baseline that appearance
  networks must beat.
- `dlg-gs`: adapted colours and depth constraints, with a depth prior (`~depth-oracle+noise`: true depth, warped,
  blurred and disturbed as networks do); `@dlaam`, `@vdjc` one of the two alone; `@ec`, `@mc` one of the two depth
  terms; `@gates` without attention; `@rgb` and `@learnt` factors in place of HVI's; `@no-weights` without the map.
""",
    printed=(
        Printed(
            paper="DLG-GS", table="1", title="its own tunnels, mean of three",
            metrics=("psnr", "ssim", "fps", "gpu_hours"), protocol="tunnel",
            lines=(
                Line(method="3DGS", row="3dgs"),
                Line(method="Scaffold-GS", row="scaffold-gs"),
                Line(method="NexusSplats", row="dlg-gs@learnt~depth-oracle+noise"),
                Line(method="DLG-GS", row="dlg-gs~depth-oracle+noise"),
            ),
        ),
        Printed(
            paper="DLG-GS", table="3", title="ablation, mean of three tunnels",
            metrics=("psnr", "ssim"), protocol="tunnel",
            lines=(
                Line(method="DLG-GS", variant="Base (Scaffold-GS)", row="scaffold-gs"),
                Line(method="DLG-GS", variant="Only VDJC", row="dlg-gs@vdjc~depth-oracle+noise"),
                Line(method="DLG-GS", variant="Only DLAAM", row="dlg-gs@dlaam"),
                Line(method="DLG-GS", variant="full (DLAAM+VDJC)", row="dlg-gs~depth-oracle+noise"),
            ),
        ),
    ),
)  # fmt: skip

RELIT = (
    "scaffold-gs/tunnel_relit", "dlg-gs~depth-oracle+noise/tunnel_relit", "scaffold-gs@affine/tunnel_relit_half",
    "dlg-gs~depth-oracle+noise/tunnel_relit_half",
)  # fmt: skip
"""Rows and protocols of the picture of views under other lamps, below the photos."""
MOST = 5
"""Views of that picture."""


def draw_relit(runs: Path) -> None:
    """Write docs/images/tunnel/relit.jpg, where the runs have all of it: photos, then a line of renders each.

    Args:
        runs: Folder that `bench run tunnel --out` was given.
    """
    cases = [runs / "tunnel" / "tunnel" / row / "seed0" for row in RELIT]
    if not all((case / "renders").is_dir() for case in cases):
        return
    names = sorted(path.name for path in (cases[0] / "renders").iterdir())[:MOST]
    folders = [cases[0] / "truth", *(case / "renders" for case in cases)]
    lines = [np.hstack([_read(folder / name) for name in names]) for folder in folders]
    path = DOCS / "images" / "tunnel" / "relit.jpg"
    cv2.imwrite(str(path), np.vstack(lines), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def _read(path: Path) -> Image:
    image = cv2.imread(str(path))
    assert image is not None, path
    return np.asarray(image, dtype=np.uint8)


if __name__ == "__main__":
    main(TUNNEL)
    if len(sys.argv) > 1:
        draw_relit(Path(sys.argv[1]))
