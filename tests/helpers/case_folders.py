"""Synthetic case folders: what a run leaves on disk, without a run."""

import dataclasses
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore, Result
from splatproof.reference.types.result_json import result_to_json

NAMES = ("dji_0001.jpg", "dji_0009.jpg", "dji_0017.jpg", "dji_0025.jpg")


def result(
    *,
    scene: str = "town",
    method: str = "3dgs",
    seed: int = 0,
    psnr: float = 24.0,
    spread: float = 0.05,
    names: Sequence[str] = NAMES,
    protocol: Protocol | None = None,
    **changes: Any,
) -> Result:
    """A plausible result; the scores depend on scene, method and seed alone.

    Args:
        psnr: Mean around which the images and seeds scatter, in dB.
        spread: Standard deviation of the seeds, in dB; the images scatter by 1 dB, the same for
            every method and seed, as hard photos are hard for all.
        changes: Fields of the result that are to be other than drawn.
    """
    rules = protocol or Protocol(name="ours_250", source="ours", metrics=("psnr", "ssim_3dgs"))
    hard = generator(scene).normal(0, 1, len(names))
    rng = generator(scene, method, seed)
    shift = rng.normal(0, spread)
    scores = tuple(
        ImageScore(
            name=name,
            truth_sha256=hashlib.sha256(f"{scene}/{name}/{rules.name}".encode()).hexdigest(),
            valid_share=0.97,
            metrics={"psnr": value, "ssim_3dgs": 0.9 - 0.4 / max(value - 10, 1)},
        )
        for name, value in zip(names, psnr + hard + shift + rng.normal(0, 0.02, len(names)), strict=True)
    )  # fmt: skip
    curve = tuple(
        (step, {"loss": 0.2 * 0.5 ** (step / 400) + 0.05, "primitives": 2000.0 + 9 * step})
        for step in range(0, 2001, 100)
    )
    drawn = Result(
        suite="quick",
        scene=scene,
        method=method,
        seed=seed,
        protocol=rules.name,
        protocol_rules=dataclasses.asdict(rules),
        settings={"iterations": 2000, "sh_degree": 3, "densify": {"grad_threshold": 2e-4}},
        images=scores,
        metrics={
            name: float(np.mean([image.metrics[name] for image in scores]))
            for name in ("psnr", "ssim_3dgs")
        },
        stages={"load": 1.0, "init": 2.0, "train": 31.0 + seed, "score": 3.0, "save": 0.2},
        cpu_seconds=70.0,
        peak_memory_mb=812.0,
        primitives=20_000 + seed,
        bytes_on_disk=4_720_000,
        render_ms=12.5,
        split_sha256=hashlib.sha256(" ".join(names).encode()).hexdigest(),
        model_sha256=hashlib.sha256(f"{scene}{method}{seed}".encode()).hexdigest(),
        curve=curve,
        curve_seconds=tuple(0.5 + 0.1 * place**1.5 for place in range(len(curve))),
        environment={"python": "3.11.7", "torch": "2.13.0", "commit": "0123abc", "machine": "a"},
        scene_facts={"images": "20", "units": "metres"},
        left_out=(("dji_0003.jpg", "not registered: 4 matches"),),
    )
    return dataclasses.replace(drawn, **changes)


def write_case(out: Path, case: Result, height: int = 60, width: int = 80) -> Path:
    """Write the folder of a case: record, truth, renders, error maps and a model file."""
    seed = f"seed{case.seed}"
    folder = out / case.suite / case.scene / case.method / case.protocol / seed
    return fill_folder(folder, case, height, width)


def fill_folder(folder: Path, case: Result, height: int = 60, width: int = 80) -> Path:
    """Write record, truth, renders, error maps and a model file of a case into a folder."""
    seed = f"seed{case.seed}"
    for image in case.images:
        truth = photo(case.scene + image.name, height, width)
        noise = generator(case.method, seed).normal(0, 12, truth.shape)
        render = np.clip(truth + noise, 0, 255)
        pictures = {"truth": truth, "renders": render, "errors": np.abs(render - truth) * 4}
        for kind, pixels in pictures.items():
            path = folder / kind / f"{Path(image.name).stem}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), np.clip(pixels, 0, 255).astype(np.uint8))
    (folder / "model").mkdir(parents=True, exist_ok=True)
    (folder / "model" / "gaussians.npz").write_bytes(b"model")
    (folder / "record.json").write_text(result_to_json(case), encoding="utf-8")
    return folder


def photo(name: str, height: int, width: int) -> np.ndarray:
    """Smooth colours with edges, different for every name; float BGR in [0, 255]."""
    rng = generator(name)
    coarse = rng.uniform(40, 220, (4, 5, 3)).astype(np.float32)
    picture = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(6):
        corner = rng.integers(0, (width, height))
        size = rng.integers(4, max(5, width // 4), 2)
        colour = rng.uniform(0, 255, 3).tolist()
        cv2.rectangle(picture, tuple(corner.tolist()), tuple((corner + size).tolist()), colour, -1)
    return picture


def suite(out: Path, scenes: Sequence[str] = ("town", "beach"), seeds: int = 3) -> Iterator[Path]:
    """Folders of a whole small suite: two methods that differ and one that hardly does."""
    methods = {"3dgs": 24.0, "3dgs_mcmc": 24.01, "slow": 22.0}
    for scene in scenes:
        for method, psnr in methods.items():
            for seed in range(seeds):
                case = result(scene=scene, method=method, seed=seed, psnr=psnr)
                yield write_case(out, dataclasses.replace(case, suite_scenes=tuple(scenes)))


def generator(*names: object) -> np.random.Generator:
    """Random numbers that depend on the names alone."""
    key = hashlib.sha256(repr(names).encode()).digest()
    return np.random.default_rng(int.from_bytes(key[:8], "little"))
