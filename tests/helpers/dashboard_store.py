"""A small store with everything that the dashboard shows: two commits, hostile names, a failed case."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from helpers import case_folders
from helpers.generated_store import record_alone
from splatproof.reference.types.result import Result

HOSTILE = "<img src=x onerror=alert(1)>'\"& \u202eevil"
"""A variant that is markup, has both quotes and turns the direction of writing."""
COMMITS = ("1111111aaa", "2222222bbb")
GAIN = 0.8
"""dB that method 3dgs gains from the first commit to the second."""


def cases() -> Iterator[Result]:
    """Every result of the store, from the oldest to the newest."""
    scenes = ("town", "beach")
    for commit, gain in zip(COMMITS, (0.0, GAIN), strict=True):
        for scene in scenes:
            for method, psnr in {"3dgs": 24.0 + gain, "slow": 22.0, "hidden": 23.0}.items():
                for seed in range(3):
                    made = case_folders.result(
                        scene=scene, method="slow" if method == "hidden" else method, seed=seed,
                        psnr=psnr,
                    )  # fmt: skip
                    own = made.environment | {"commit": commit}
                    curve = tuple((k, v | {"gaussians": v["primitives"]}) for k, v in made.curve)
                    yield dataclasses.replace(
                        made, suite_scenes=scenes, environment=own, curve=curve,
                        variant=HOSTILE if method == "hidden" else "",
                        settings=made.settings | ({"note": HOSTILE} if method == "hidden" else {}),
                        render_ms={"3dgs": 12.5, "slow": 30.0, "hidden": 21.0}[method],
                    )  # fmt: skip
    failed = case_folders.result(method="broken")
    yield dataclasses.replace(failed, error="out of memory", images=(), metrics={}, curve=())


def write(folder: Path, case: Result) -> None:
    """Write a case's files; pictures of the newest alone."""
    if case.environment["commit"] == COMMITS[1]:
        case_folders.fill_folder(folder, case, height=36, width=48)
    else:
        record_alone(folder, case)
