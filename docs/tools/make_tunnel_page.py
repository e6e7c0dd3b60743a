"""Make docs/tunnel.md: python docs/tools/make_tunnel_page.py RUNS

Reads the records of `bench run tunnel --out RUNS` and writes docs/tunnel.json, docs/tunnel_pictures.json,
docs/images/tunnel/ and the page, with docs/tunnel_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from comparison_files import DOCS, Comparison, main
from depth_lines import draw_depths
from moment_lines import draw_moments
from picture_lines import draw_lines
from printed_tables import Line, Printed

from splatproof.metrics.protocol_files import load_protocol

TUNNEL = Comparison(
    suite="tunnel",
    title="The tunnel suite: DLG-GS, Scaffold-GS and exposure baselines",
    protocol="tunnel",
    scene="tunnel",
    units="cameras of the held-out stop",
    intro="""\
The scene is `tunnel`: a rock tunnel that a rig of six cameras drives through, lit by the rig's own lamps alone. One
stop of eight is held out with all its cameras. Protocols `tunnel`, `tunnel_half` and `tunnel_oracle` are one training,
shown in the light of the nearest training view, in one fitted to the left half of each photo (the right half is
scored), or in one fitted to all of it (one seed, never ranked). `tunnel_relit` shows views under lamps that stand elsewhere.
`tunnel/second` and `tunnel/third` are drives through other rock past other things: DLG-GS's claims on Scaffold-GS are judged by the mean
of the three tunnels, as its tables are.

- `3dgs`, `mip-splatting`, `absgs` and `scaffold-gs`; `@gain` and `@affine` learn an exposure of each photo: the baseline that appearance
  networks must beat.
- `dlg-gs`: adapted colours and depth constraints, with a depth prior (`~depth-oracle+noise`: true depth, warped,
  blurred and disturbed as networks do; `~depth-oracle`: true depth as it is; `~depth-sweep`: photos matched with their neighbours, no truth); `@dlaam`, `@vdjc` one of the two alone; `@ec`, `@mc` one of the two depth
  terms; `@gates` without attention; `@rgb` and `@learnt` factors in place of HVI's; `@no-weights` without the map;
  `@z` depth along the axis, as the prior has it, in place of the paper's distance to the camera; `@no-dropout` and
  `@no-volume` without these terms; `@fading` with depth constraints that end at a hundredth of their weights; `@affine` of any method learns an affine exposure.
""",
    printed=(
        Printed(
            paper="DLG-GS", table="1", title="its own tunnels (printed: mean of three)",
            metrics=("psnr", "ssim", "fps", "gpu_hours"), protocol="tunnel",
            lines=(
                Line(method="3DGS", row="3dgs"),
                Line(method="Scaffold-GS", row="scaffold-gs"),
                Line(method="NexusSplats", row="dlg-gs@learnt~depth-oracle+noise"),
                Line(method="DLG-GS", row="dlg-gs~depth-oracle+noise"),
            ),
        ),
        Printed(
            paper="DLG-GS", table="3", title="ablation (printed: mean of three tunnels)",
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

DLG = "dlg-gs~depth-oracle+noise"
LINES = {
    "relit": (
        "scaffold-gs/tunnel_relit/seed0/renders", f"{DLG}/tunnel_relit/seed0/renders",
        "scaffold-gs@affine/tunnel_relit_half/seed0/renders", f"{DLG}/tunnel_relit_half/seed0/renders",
    ),
    "second": tuple(
        f"second/{row}/tunnel/seed0/{kind}" for row in ("scaffold-gs", DLG) for kind in ("renders", "errors")
    ),
    "third": tuple(
        f"third/{row}/tunnel/seed0/{kind}"
        for row in ("scaffold-gs@double", "dlg-gs@double~depth-oracle+noise") for kind in ("renders", "errors")
    ),
}  # fmt: skip
"""Pictures: the lines of each, below the photos."""
DEPTHS = (
    "absgs/tunnel/seed0",
    "scaffold-gs@double/tunnel/seed1",
    "dlg-gs@dlaam-double/tunnel/seed0",
    "dlg-gs@vdjc-double~depth-oracle+noise/tunnel/seed0",
)
FADING = (
    "dlg-gs@double~depth-oracle/tunnel/seed0",
    "dlg-gs@z-double~depth-oracle+noise/tunnel/seed0",
    "dlg-gs@fading-double~depth-oracle+noise/tunnel/seed0",
)
"""Cases whose depth is drawn below the true one."""
STOPS = (
    "mip-splatting/tunnel/seed0",
    "absgs/tunnel/seed0",
    "scaffold-gs@double/tunnel/seed1",
    "dlg-gs@dlaam-double/tunnel/seed0",
    "dlg-gs@affine~depth-oracle+noise/tunnel/seed0",
    "dlg-gs~depth-sweep/tunnel/seed0",
)
"""Cases whose renders of consecutive stops are drawn below the photos."""


def _folders(tunnel: Path, cases: Sequence[str]) -> dict[str, Path]:
    """Folders of cases by row."""
    return {case.partition("/")[0]: tunnel / case for case in cases}


if __name__ == "__main__":
    main(TUNNEL)
    if len(sys.argv) > 1:
        images, tunnel = DOCS / "images" / "tunnel", Path(sys.argv[1]) / "tunnel" / "tunnel"
        for name, lines in LINES.items():
            draw_lines(images / f"{name}.jpg", tunnel, lines)
        rules = load_protocol("tunnel")
        draw_depths(images / "depth.jpg", "tunnel", rules, _folders(tunnel, DEPTHS))
        draw_depths(images / "fading.jpg", "tunnel", rules, _folders(tunnel, FADING))
        draw_moments(images / "stops.jpg", "tunnel", rules, _folders(tunnel, STOPS), "camera_0")
