"""What single choices gained where suite auto fixed them otherwise: the figures by which a plan says what it expects.

Each is of few scenes and mostly of one seed: what to hope for, and no promise. A test holds them against the rows that
docs/auto.md is made of.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Contest:
    """Method auto against a row of its suite that has one choice fixed."""

    row: str
    """Name of that row."""
    gains: dict[tuple[str, str], float]
    """Decibels of test PSNR that auto has more than the row, in as many seconds, by scene and protocol: mean over
    the seeds that both have."""

    def __str__(self) -> str:
        """From the least gain to the largest, and on how many scenes."""
        # no gain has a sign: what rounds to -0.0 is +0.0
        low, high = (round(f(self.gains.values()), 1) + 0.0 for f in (min, max))
        scenes = {scene for scene, _ in self.gains}
        if len(self.gains) == 1:
            return f"{low:+.1f} dB on {next(iter(scenes))} (docs/auto.md)"
        return f"{low:+.1f} to {high:+.1f} dB on {len(scenes)} scenes (docs/auto.md)"


MATCHED = Contest(row="auto@sparse-points", gains={
    ("brighton_beach", "brighton_250"): 1.45, ("city", "default"): 0.11,
})  # fmt: skip
"""Points of matched photos, where the plan has them."""
UNMATCHED = Contest(row="auto@matched", gains={
    ("courtyard", "default"): -0.57, ("tunnel", "default"): -0.65,
})  # fmt: skip
"""No matched points, where the plan has none."""
COMPLETED = Contest(row="auto@explicit", gains={
    ("brighton_beach", "photos_sparse_6"): -0.57, ("caliterra", "photos_sparse_6"): 0.19,
    ("seneca", "photos_sparse_6"): -0.35, ("aerial-sparse/town", "aerial_sparse_3"): 0.29,
})  # fmt: skip
"""Completed depths, where the plan has them: it has them against PSNR, see docs/auto.md."""
EXPLICIT = Contest(row="auto@completed", gains={
    ("courtyard", "photos_sparse_6"): 0.42, ("aerial-sparse/town", "aerial_sparse_7"): 0.64,
})  # fmt: skip
"""No completed depths from few photos, where the plan has none."""
MOVING = Contest(row="auto@still", gains={("street", "default"): 0.19})
"""Gaussians that move."""
SHRUNK = Contest(row="auto@full-size", gains={
    ("caliterra", "city_400"): 0.09, ("courtyard", "default"): 0.04, ("city", "default"): -0.25,
})  # fmt: skip
"""Photos that are small at first, where the plan has them so."""
GROWING = Contest(row="auto@fewer", gains={
    ("brighton_beach", "brighton_250"): -0.17, ("caliterra", "city_400"): 0.56,
    ("courtyard", "default"): 1.24, ("tunnel", "default"): -0.50,
})  # fmt: skip
"""Gaussians that are split from a pull of 4e-4 on, not 8e-4."""
BOUNDED = Contest(row="auto@unbounded", gains={
    ("brighton_beach", "brighton_250"): -0.04, ("caliterra", "city_400"): -0.37,
    ("courtyard", "default"): -0.16, ("city", "default"): -0.02, ("tunnel", "default"): -0.32,
})  # fmt: skip
"""A bound on scales."""
FADING = Contest(row="auto@no-opacity-term", gains={
    ("brighton_beach", "brighton_250"): 0.34, ("caliterra", "city_400"): 0.06,
    ("courtyard", "default"): 0.36, ("city", "default"): 0.44, ("tunnel", "default"): -0.41,
})  # fmt: skip
"""The opacity term."""
UNEXPOSED = Contest(row="auto@gains", gains={
    ("brighton_beach", "brighton_250"): -0.42, ("caliterra", "city_400"): 0.82,
    ("courtyard", "default"): 0.16, ("tunnel", "default"): 3.81,
})  # fmt: skip
"""No gain for each photo."""
DROPPING = Contest(row="auto@no-dropout", gains={
    ("brighton_beach", "brighton_250"): 0.84, ("brighton_beach", "brighton_500"): 0.64,
    ("courtyard", "default"): 0.57,
})  # fmt: skip
"""Dropout, where few photos are looked at 130 to 250 times."""
UNLEARNT = Contest(row="auto@as-few-photos", gains={
    ("city", "default"): 0.32, ("tunnel", "default"): 0.44,
})  # fmt: skip
"""What is planned of photos too many to be learnt by heart, where a minute looks at each 150 to 250 times."""
CONTESTS = (
    MATCHED, UNMATCHED, COMPLETED, EXPLICIT, MOVING, SHRUNK, GROWING, BOUNDED, FADING, UNEXPOSED, DROPPING, UNLEARNT,
)  # fmt: skip
"""All of them."""

NO_DROPOUT = "+0.3 dB on caliterra, +0.5 on seneca (docs/auto.md)"
"""No dropout, where photos are looked at 15 to 50 times: rows of an earlier plan, which had it there (three seeds, and two)."""
QUICKER = "+0.6 dB on seneca, +0.6 dB on caliterra (docs/minute.md)"
"""Four times the release's rates, and the bounds on shape that these need, where a minute looks at photos 13 and 34 times: row
`auto@release-rates` of suite minute, three seeds."""
SPLIT = "+0.3 dB on caliterra (docs/minute.md)"
"""Large Gaussians that are split by absolute gradients, where a minute looks at photos 34 times: row `auto@signed-split` of suite
minute, three seeds."""
FLATTENED = "-0.4 to +0.4 dB on 7 scenes, and less fog from beside (docs/auto.md)"
"""Gaussians that are flattened along rays (held-out training photos, one to three seeds)."""
FULL_SIZE = "+0.6 dB on brighton_beach at 250 px"
"""Full size from the first step against a start at a quarter, where that leaves less than 80 pixels (one seed)."""
MCMC_SECONDS = (1.4, 1.7)
"""Seconds of as many steps under density control mcmc, as a multiple of those under the usual one (docs/minute.md)."""
ANCHORS = "-0.9 to +2.3 dB over scaffold-gs on 8 scenes (docs/auto.md)"
"""Gaussians without anchors: method scaffold-gs on one fold of held-out training photos, one seed, a minute each."""
BESIDE = "+0.1 to +0.3 dB in as many seconds, on 2 scenes"
"""300 points drawn beside fewer than 12, see `splatproof.methods.auto.points` (held-out training photos, one seed)."""
