"""Make docs/tunnel.md: python docs/tools/make_tunnel_page.py RUNS

Reads the records of `bench run tunnel --out RUNS` and writes docs/tunnel.json, docs/tunnel_pictures.json,
docs/images/tunnel/ and the page, with docs/tunnel_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

from comparison_files import Comparison, main
from printed_tables import Line, Printed

TUNNEL = Comparison(
    suite="tunnel",
    title="The tunnel suite: DLG-GS, Scaffold-GS and exposure baselines",
    protocol="tunnel",
    intro="""\
The scene is `tunnel`: a rock tunnel that a rig of six cameras drives through, lit by the rig's own lamps alone. One
stop of eight is held out with all its cameras. Protocols `tunnel`, `tunnel_half` and `tunnel_oracle` are one training,
shown in the light of the nearest training view, in one fitted to the left half of each photo (the right half is
scored), or in one fitted to all of it (never ranked).
""",
    printed=(
        Printed(
            paper="DLG-GS", table="1", title="its own tunnels, mean of three",
            metrics=("psnr", "ssim", "fps"), protocol="tunnel",
            lines=(
                Line(method="3DGS", row="3dgs"),
                Line(method="Scaffold-GS", row="scaffold-gs"),
                Line(method="DLG-GS", row="dlg-gs"),
            ),
        ),
    ),
)  # fmt: skip

if __name__ == "__main__":
    main(TUNNEL)
