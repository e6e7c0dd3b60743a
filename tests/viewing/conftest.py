"""A stage whose photos are pictures of its own model, and a model in blocks; nothing is trained."""

from dataclasses import replace

import pytest
import torch

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.methods.city.model import CityModel
from splatproof.methods.city.regions import GroundRegion
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.models.exposure import ExposedGaussians, Exposures
from splatproof.reference.types.scene import Scene
from splatproof.viewing.stage import Shown, Stage

POINTS = 40


@pytest.fixture(scope="session")
def scene() -> Scene:
    return tiny_scene(points=POINTS)


@pytest.fixture(scope="session")
def truth() -> ExplicitModel:
    """What the photos of the scene show."""
    return ExplicitModel(model=random_gaussians(POINTS))


@pytest.fixture(scope="session")
def city(truth: ExplicitModel) -> CityModel:
    """The same Gaussians in two blocks, left and right of x = 0."""
    frame = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64)
    regions = tuple(
        GroundRegion(frame=frame, corners=torch.tensor([[low, -1.0], [low + 1, 1.0]]).double())
        for low in (-1.0, 0.0)
    )
    blocks = (truth.model.means[:, 0] > 0).long()
    return CityModel(
        model=truth.model, blocks=blocks, distances=torch.zeros(POINTS), block_facts=(),
        regions=regions,
    )  # fmt: skip


@pytest.fixture(scope="session")
def lit(truth: ExplicitModel, scene: Scene) -> ExposedGaussians:
    """The same Gaussians, which know that the first training photo is twice as bright."""
    raw = torch.zeros(len(scene.train), 3)
    raw[0] = 1.0
    photos = tuple(view.name for view in scene.train_views)
    return ExposedGaussians(
        model=truth.model, exposures=Exposures(kind="gain", photos=photos, raw=raw)
    )


@pytest.fixture
def stage(truth: ExplicitModel, city: CityModel, scene: Scene) -> Stage:
    wrong = replace(truth.model, sh=-truth.model.sh)
    return Stage(
        (
            Shown(name="truth", model=truth),
            Shown(name="wrong", model=ExplicitModel(model=wrong)),
            Shown(name="city", model=city),
        ),
        scene,
        torch.zeros(3),
    )
