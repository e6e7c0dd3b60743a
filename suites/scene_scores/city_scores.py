"""What a model of blocks is scored on beyond any other: its seams and how its blocks shared the work."""

from dataclasses import replace
from pathlib import Path

from splatproof.methods.city.ground import ground
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.partition import edge_cut
from splatproof.methods.city.regions import nearest_region
from splatproof.reference.types.protocol import Protocol
from splatproof.reference.types.result import ImageScore
from splatproof.reference.types.scene import Scene
from splatproof.suites.scene_scores.block_balance import (
    balance_metrics,
    fewest_densifications,
    four_machine_seconds,
    over_hard_cut,
    retention,
)
from splatproof.suites.scene_scores.seams import score_seams


def peak_name(stage: str) -> str:
    """What metrics call the peak memory of a stage, among those of a city's stages and "score"."""
    return f"{stage}_peak_mb"


def city_scores(
    scene: Scene,
    model: CityModel,
    protocol: Protocol,
    images: tuple[ImageScore, ...],
    folder: Path,
) -> tuple[tuple[ImageScore, ...], dict[str, float]]:
    """The images' scores with their seam metrics, and the scene's: seams, balance, seconds on four machines,
    densifications, retention, what the merge adds, edge cut, packed bytes, peak memory of the stages.

    The scene's seam metrics pool the seam pixels of all test views, as the paper defines them; they
    are not means of the images' values, of which those without a seam pixel are nan.

    Args:
        scene: The scene, with its test views.
        model: The model, which knows its blocks.
        protocol: The rules that the test views are scored by.
        images: Scores of the test views that every method has.
        folder: Folder of the case, where `score_seams` writes pictures.
    """
    views, whole = score_seams(scene, model, protocol, model.backend, folder)
    scored = tuple(replace(one, metrics=one.metrics | views[one.name]) for one in images)
    if model.packed is not None:
        whole["packed_bytes"] = float(len(model.packed))
    blocks = model.block_facts
    whole |= balance_metrics(blocks) | fewest_densifications(blocks) | retention(blocks)
    whole |= over_hard_cut(blocks)
    whole |= {peak_name(stage): peak for stage, peak in model.stage_peak_mb.items()}
    whole |= four_machine_seconds(
        model.stage_seconds, model.stage_cpu_seconds, blocks, model.refine_alone
    )
    if len(model.regions) > 1 and len(scene.points):
        owners = nearest_region(model.regions, scene.points.positions)
        whole["edge_cut"] = float(edge_cut(ground(scene), owners, len(model.regions)))
    return scored, whole
