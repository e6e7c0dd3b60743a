"""Partitions with regions: every place has an owner, every block what it needs."""

import pytest
import torch

from helpers.city_scene import small_scene
from splatproof.base.errors import DataError, UsageError
from splatproof.methods.city.partition import MethodName, PartitionSettings, partition
from splatproof.methods.city.point_roles import CONTEXT, GHOST, LEFT_OUT, OWN, roles_of
from splatproof.methods.city.regions import nearest_region

SCENE = small_scene(120)
METHODS: tuple[MethodName, ...] = ("odbp", "blockgaussian", "vastgaussian", "citygaussian")


def cut(method: MethodName, blocks: int, **more):
    return partition(SCENE, blocks, PartitionSettings(method=method, **more))


@pytest.mark.parametrize("blocks", [1, 2, 4])
@pytest.mark.parametrize("method", METHODS)
def test_every_point_has_one_owner_and_every_block_all_that_it_owns(method, blocks):
    found = cut(method, blocks)
    assert len(found.views) == len(found.points) == len(found.regions) == blocks
    assert int(found.labels.min()) >= 0
    assert int(found.labels.max()) < blocks
    for block, (views, points) in enumerate(zip(found.views, found.points, strict=True)):
        assert not bool((~points & (found.labels == block)).any())
        assert not views[list(SCENE.test)].any()
    if blocks == 1:
        assert bool(found.points[0].all())
        assert bool(found.views[0][list(SCENE.train)].all())


@pytest.mark.parametrize("blocks", [1, 2, 4])
@pytest.mark.parametrize("method", METHODS)
def test_every_place_lies_in_a_core_however_far_away(method, blocks):
    regions = cut(method, blocks).regions
    generator = torch.Generator().manual_seed(0)
    for size in (1.0, 10.0, 1e4):
        places = size * torch.randn(500, 3, generator=generator, dtype=torch.float64)
        nearest = torch.stack([region.distance(places) for region in regions]).amin(dim=0)
        assert float(nearest.max()) <= 1 + 1e-9 * (size < 100)


@pytest.mark.parametrize("method", METHODS)
def test_regions_and_labels_agree(method):
    found = cut(method, 4)
    owner = nearest_region(found.regions, SCENE.points.positions)
    assert float((owner == found.labels).double().mean()) >= 0.95  # the rest: walls, mixed voxels


@pytest.mark.parametrize("method", ["odbp", "blockgaussian"])
def test_a_wider_margin_trains_more(method):
    narrow, wide = (cut(method, 2, margin=margin).points for margin in (0.0, 0.3))
    for before, after in zip(narrow, wide, strict=True):
        assert not bool((before & ~after).any())
    assert sum(int(p.sum()) for p in wide) > sum(int(p.sum()) for p in narrow)


def test_roles_of_points():
    found = cut("odbp", 2, margin=0.0)
    upright = SCENE.points.positions
    few = torch.zeros_like(found.views[0])
    few[1] = True
    own = found.labels == 0

    def roles(auxiliary):
        return roles_of(SCENE.points, own, few, found.labels, 0, upright, auxiliary)

    seen = torch.tensor(
        [bool((SCENE.points.track_views[a:b] == 1).any())
         for a, b in SCENE.points.track_starts.unfold(0, 2, 1).tolist()]
    )  # fmt: skip
    for auxiliary in ("none", "context", "ghosts", "both"):
        found_roles = roles(auxiliary)
        assert bool((found_roles[own] == OWN).all())
        assert not bool((found_roles[~own] == OWN).any())
    assert torch.equal(roles("context") == CONTEXT, seen & ~own)
    low, high = upright[own].amin(dim=0), upright[own].amax(dim=0)
    near = ((upright - (low + high) / 2).abs() <= 0.6 * (high - low)).all(dim=1)
    assert torch.equal(roles("ghosts") == GHOST, near & ~own)
    # what the views see is trained, wherever it lies
    assert torch.equal(roles("both") == CONTEXT, roles("context") == CONTEXT)
    assert torch.equal(roles("both") == GHOST, (roles("ghosts") == GHOST) & ~seen)
    assert bool((roles("none")[~own] == LEFT_OUT).all())
    shape = roles_of(SCENE.points, own, few, found.labels, 0, upright, "ghosts", near & seen)
    assert torch.equal(shape == GHOST, near & seen & ~own)


def test_scenes_and_numbers_that_cannot_be_cut_are_refused():
    with pytest.raises(UsageError, match="blocks"):
        cut("odbp", 0)
    with pytest.raises(DataError, match="121 blocks"):
        cut("odbp", 121)
    with pytest.raises(DataError, match="cameras"):
        cut("vastgaussian", 9)


@pytest.mark.parametrize(
    ("name", "value"), [("margin", -0.1), ("imbalance", 0.0), ("seeds", 0), ("voxel_size", -1.0),
                        ("view_share", 1.5), ("block_share", -0.1), ("change", 2.0)],
)  # fmt: skip
def test_settings_without_sense_are_refused(name, value):
    with pytest.raises(UsageError, match=f"partition.{name}"):
        PartitionSettings(**{name: value})
