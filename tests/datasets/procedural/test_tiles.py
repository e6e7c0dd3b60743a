"""A city that is built where a view looks is the city that stands in memory as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from splatproof.datasets.procedural import city, exporting, tiles
from splatproof.datasets.procedural import ray_images as frames
from splatproof.datasets.procedural.plan import Shot
from splatproof.datasets.procedural.world import Builder

BLOCKS = replace(
    city.PRESETS["small"], blocks=(2, 2), width=64, height=48, oblique=1, facade=1, cell=8.0,
    samples=1, altitude=40.0, tiles=1000,
)  # fmt: skip
SEED = 2


def picked(settings):
    """Plan of a city and a view of each sort."""
    plan = city.plan(SEED, settings)
    names = ("nadir_00002.png", "oblique_00000.png", "facade_00000.png")
    return plan, [next(s for s in plan.shots if s.name == name) for name in names]


def picture(plan, shot: Shot):
    stage = plan.stage(shot)
    return frames.take(
        stage.caster, stage.lighting, shot.camera, samples=plan.samples, seed=5,
        seeds=stage.object_seeds,
    )  # fmt: skip


@pytest.fixture(scope="module")
def unbounded():
    """Frames of the tiled city whose tiles are all kept."""
    plan, shots = picked(BLOCKS)
    return {shot.name: picture(plan, shot) for shot in shots}


@pytest.mark.slow  # half a minute of rays
def test_the_frames_do_not_depend_on_the_tiles_kept(unbounded):
    plan, shots = picked(replace(BLOCKS, tiles=2))
    for shot in reversed(shots):  # nor on the order of views
        frame = picture(plan, shot)
        for name in ("colour", "depth", "normal", "object"):
            assert np.array_equal(getattr(frame, name), getattr(unbounded[shot.name], name)), name
    assert isinstance(plan.stage, tiles.TiledStage)
    assert len(plan.stage.cache._built) == 2
    assert len(plan.stage._stages) == tiles.STAGES


@pytest.mark.slow
def test_a_view_sees_what_it_sees_of_the_whole_city(unbounded):
    plan, shots = city.plan(SEED, replace(BLOCKS, tiles=0)), picked(BLOCKS)[1]
    for shot in shots:
        whole, part = picture(plan, shot), unbounded[shot.name]
        # the same triangles; a ray along an edge may take either side
        assert (whole.object == part.object).mean() > 0.999
        same = whole.object == part.object
        np.testing.assert_allclose(whole.depth[same], part.depth[same], rtol=1e-5)
        # sky light is known at other places and looks one block far instead of everywhere
        gap = np.abs(whole.colour.astype(int) - part.colour)
        assert gap.mean() < 4, shot.name
        # the sun's shadows are the same: nothing changes by half of its brightness
        assert (gap.max(axis=2) > 60).mean() < 0.003


def test_a_view_holds_few_blocks_however_large_the_city_is():
    settings = city.PRESETS["large"]
    half = np.array(settings.blocks) * city.PITCH / 2
    sketch = tiles.Sketch(city.PITCH, (-half[0], -half[1]))
    for i in range(-3, settings.blocks[0] + 3):
        for j in range(-3, settings.blocks[1] + 3):
            x, y = (np.array([i, j]) + 0.5) * city.PITCH - half
            sketch.later("tree", list, x, y)
    most = {"nadir": 30, "oblique": 50, "facade": 50}
    for shot in city.shots(1, settings)[::11]:  # of each sort more than a dozen
        seen = tiles.looked_at(sketch, shot.camera, tiles.SPILL + tiles.SHADE)
        assert len(seen) <= most[shot.name.split("_")[0]], shot.name


@pytest.mark.slow
def test_everything_stands_within_reach_of_its_tile():
    sketch = tiles.Sketch(city.PITCH, (-84.0, -56.0))
    city.furnish(sketch, 1, city.draw_kinds(1, 3, 2), 40.0)
    for tile in sketch.notes:
        world = sketch.tile(tile)
        low = sketch.origin + np.array(tile) * city.PITCH
        assert (world.vertices[:, :2] > low - tiles.SPILL).all()
        assert (world.vertices[:, :2] < low + city.PITCH + tiles.SPILL).all()
        assert world.vertices[:, 2].min() > tiles.HEIGHTS[0]
        assert world.vertices[:, 2].max() < tiles.HEIGHTS[1]
    # and it is everything: the same objects with the same area as in the city built at once
    both = Builder()
    city.furnish(both, 1, city.draw_kinds(1, 3, 2), 40.0)
    whole, parts = both.build(), tiles.TileCache(sketch, 3).world(sorted(sketch.notes))
    assert parts.kinds == whole.kinds
    assert np.allclose(area(parts), area(whole))


def area(world):
    corner = world.vertices[world.faces]
    double = np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    return np.bincount(world.face_objects, double, minlength=len(world.kinds))


def test_a_tiled_city_is_made_and_goes_on_after_a_stop(tmp_path):
    few = (0.0, 0.0)  # of 51 views 11
    settings = replace(BLOCKS, blocks=(1, 1), tiles=12, overlap=few)

    def stop(done, total):
        if done == 4:
            raise KeyboardInterrupt

    plan = city.plan(SEED, settings)
    assert len(plan.shots) > 6
    with pytest.raises(KeyboardInterrupt):
        exporting.make_scene(plan, tmp_path / "city", stop)
    [part] = tmp_path.iterdir()
    there = {path: path.stat().st_mtime_ns for path in part.rglob("*.png")}
    assert 4 <= len(there) <= 4 + exporting.WORKERS
    told = []
    folder = exporting.make_scene(
        city.plan(SEED, settings), tmp_path / "city", lambda done, total: told.append((done, total))
    )
    assert told[0][0] == len(there)  # nothing that was whole is made again
    assert told[-1] == (2 * len(plan.shots),) * 2
    for path, when in there.items():
        assert (folder / path.relative_to(part)).stat().st_mtime_ns == when
    assert not (folder / exporting.CORNERS).exists()
