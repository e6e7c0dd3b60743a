"""Make docs/anchors.md: python docs/tools/make_anchors_page.py RUNS

Reads the records of `bench run anchors --out RUNS` and writes docs/anchors.json, docs/anchors_pictures.json,
docs/images/anchors/ and the page, with docs/anchors_findings.md in it, which is written by hand. Without
RUNS the page is made again from the committed files.
"""

from comparison_files import Comparison, main

ANCHORS = Comparison(
    suite="anchors",
    title="The anchors suite: Scaffold-GS beside 3DGS where nothing moves",
    protocol="default",
    scene="courtyard",
    intro="""\
The scenes are `courtyard`, which splatproof makes itself, and drone photos of a beach, both without motion and without
change of light. Both methods are trained for about as many processor seconds on one thread each, as the tables show;
opacities are never reset, for runs are shorter than the pause between two resets of the release. Protocols
`quarter_seen` and `brighton_quarter` hold out one photo of four, `quarter_seen` only of those that show what training
photos show too: trainings of their own, with more photos to judge by. `courtyard/second` and `courtyard/third` are the
same farm with other trees, tones and small things, seen from other places: what is judged on `quarter_seen` is the mean of the three.
""",
    printed=(),
)

if __name__ == "__main__":
    main(ANCHORS)
