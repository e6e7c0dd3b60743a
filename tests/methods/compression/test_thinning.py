"""Fewer Gaussians: as many as asked for, none at share 0, and merging hides less than pruning."""

import pytest
import torch

from helpers.tiny_scene import random_gaussians, tiny_scene
from splatproof.base.errors import UsageError
from splatproof.methods.compression.thinning import neighbours, thinned
from splatproof.methods.models.explicit import ExplicitModel
from splatproof.methods.storage.visibility import visibility
from splatproof.reference.types.gaussians import Gaussians


def rng() -> torch.Generator:
    return torch.Generator().manual_seed(0)


@pytest.mark.parametrize("way", ["merge", "prune"])
def test_share_0_changes_nothing_and_others_leave_what_they_say(way):
    scene, model = tiny_scene(), random_gaussians(100, degree=1)
    same = thinned(model, scene.train_views, 0.0, generator=rng(), way=way)
    for name, values in vars(model).items():
        assert torch.equal(getattr(same, name), values)
    for share in (0.1, 0.8):
        found = thinned(model, scene.train_views, share, generator=rng(), way=way)
        assert len(found) == 100 - round(100 * share)
        assert all(values.isfinite().all() for values in vars(found).values())


def test_pruning_drops_those_of_the_least_weight():
    scene, model = tiny_scene(), random_gaussians(50, degree=0)
    weights = visibility(model, scene.train_views, generator=rng()).weights
    found = thinned(model, scene.train_views, 0.2, generator=rng(), way="prune")
    assert torch.equal(found.means, model.means[weights.argsort()[10:].sort().values])


def test_twins_are_merged_first_and_that_changes_images_less_than_pruning():
    scene, half = tiny_scene(), random_gaussians(60, degree=1)
    twice = Gaussians(**{name: torch.cat([values, values]) for name, values in vars(half).items()})
    view, black = scene.train_views[0], torch.zeros(3)

    def error(way) -> float:
        found = thinned(twice, scene.train_views, 0.5, generator=rng(), way=way)
        images = [ExplicitModel(model=m).render(view, black).colour for m in (found, twice)]
        return float((images[0] - images[1]).square().mean())

    found = thinned(twice, scene.train_views, 0.5, generator=rng())
    assert (torch.cdist(half.means.double(), found.means.double()).amin(dim=1) < 1e-5).all()
    assert error("merge") < 0.5 * error("prune")  # 0.37: splats are cut where alpha is below 1/255


@pytest.mark.parametrize("share", [-0.1, 0.95, float("nan")])
def test_other_shares_are_refused(share):
    with pytest.raises(UsageError, match="from 0 to 0.9"):
        thinned(random_gaussians(5, degree=0), tiny_scene().train_views, share, generator=rng())


def test_neighbours_are_pairs_of_two_each_once():
    pairs = neighbours(torch.zeros(30, 3))  # all at one place
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(torch.unique(pairs, dim=0)) == len(pairs)
    assert len(neighbours(torch.rand(1, 3))) == 0
    line = torch.arange(30.0)[:, None] * torch.tensor([1.0, 0, 0])
    assert [0, 1] in neighbours(line).tolist()
