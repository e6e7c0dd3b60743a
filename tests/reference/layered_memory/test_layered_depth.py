import itertools

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.testing import assert_close

from splatproof.reference.layered_memory import layered_depth as ldi
from splatproof.reference.types.camera import Camera, project_points

D = torch.float64


def camera(x: float = 0.0, width: int = 6, height: int = 5) -> Camera:
    pose = torch.eye(4, dtype=D)
    pose[0, 3] = -x
    intrinsics = torch.tensor([[6.0, 0, 3.0], [0, 6.0, 2.5], [0, 0, 1]], dtype=D)
    return Camera(K=intrinsics, world_to_camera=pose, width=width, height=height)


def samples(n: int, seed: int, view: Camera) -> tuple[Tensor, Tensor]:
    """Points on the rays through a few pixels, at depths that often collide."""
    g = torch.Generator().manual_seed(seed)
    pixel = torch.randint(0, 3, (n, 2), generator=g) + torch.rand(n, 2, generator=g, dtype=D)
    z = 1 + torch.rand(n, 1, generator=g, dtype=D)
    ray = torch.cat([pixel, torch.ones(n, 1, dtype=D)], dim=1) @ torch.linalg.inv(view.K).T
    return ray * z, torch.rand(n, 3, generator=g, dtype=D)


def layers_by_loop(positions: Tensor, view: Camera, eps: float) -> dict[int, list[list[float]]]:
    """Each pixel on its own: sort, then merge the closest pair until none is within eps."""
    at, z = project_points(view, positions)
    pixels: dict[int, list[list[float]]] = {}
    for (x, y), depth in zip(at.tolist(), z.tolist(), strict=True):
        if 0 <= x < view.width and 0 <= y < view.height and depth > view.near:
            pixels.setdefault(int(y) * view.width + int(x), []).append([depth, 1])
    for layers in pixels.values():
        layers.sort()
        while len(layers) > 1:
            gaps = [b[0] - a[0] for a, b in itertools.pairwise(layers)]
            i = gaps.index(min(gaps))
            if gaps[i] > eps:
                break
            (a, m), (b, n) = layers[i], layers[i + 1]
            layers[i : i + 2] = [[(m * a + n * b) / (m + n), m + n]]
    return pixels


@settings(max_examples=50)
@given(n=st.integers(0, 40), seed=st.integers(0, 2**16), eps=st.floats(0.001, 0.5))
def test_matches_closest_pair_first_in_every_pixel(n, seed, eps):
    view = camera()
    memory = ldi.insert(ldi.empty(view, eps, 100), *samples(n, seed, view))
    want = layers_by_loop(samples(n, seed, view)[0], view, eps)
    got: dict[int, list[list[float]]] = {}
    for pixel, depth, count in zip(
        memory.pixels.tolist(), memory.depths.tolist(), memory.counts.tolist(), strict=True
    ):
        got.setdefault(pixel, []).append([depth, count])
    assert sorted(got) == sorted(want)
    for pixel, layers in want.items():
        assert got[pixel] == [pytest.approx(layer, abs=1e-12) for layer in layers]


@settings(max_examples=50)
@given(
    sizes=st.lists(st.integers(0, 20), max_size=4),
    seed=st.integers(0, 2**16),
    eps=st.floats(0.001, 0.5),
    cap=st.integers(1, 4),
)
def test_invariants_hold_after_every_batch(sizes, seed, eps, cap):
    view = camera()
    memory, total = ldi.empty(view, eps, cap), 0
    for k, n in enumerate(sizes):
        memory = ldi.insert(memory, *samples(n, seed + k, view))
        total += n
        same = memory.pixels[1:] == memory.pixels[:-1]
        assert (memory.depths[1:] - memory.depths[:-1])[same].gt(eps).all()
        assert int(memory.counts.sum()) == total  # samples are conserved, under the cap too
        assert len(memory) <= total
        assert total == 0 or int(torch.bincount(memory.pixels).max()) <= cap
        assert_close(project_points(view, memory.positions)[1], memory.depths)


@given(n=st.integers(1, 30), seed=st.integers(0, 2**16))
def test_order_inside_a_batch_does_not_matter(n, seed):
    view = camera()
    positions, colours = samples(n, seed, view)
    shuffle = torch.randperm(n, generator=torch.Generator().manual_seed(seed))
    a = ldi.insert(ldi.empty(view, 0.1), positions, colours)
    b = ldi.insert(ldi.empty(view, 0.1), positions[shuffle], colours[shuffle])
    assert_close(a.depths, b.depths, atol=1e-12, rtol=0)
    assert_close(a.colours, b.colours, atol=1e-12, rtol=0)
    assert_close(a.counts, b.counts)


def test_inserting_the_layers_again_changes_only_counts():
    view = camera()
    once = ldi.insert(ldi.empty(view, 0.05), *samples(25, 4, view))
    twice = ldi.insert(once, once.positions, once.colours)
    assert_close(twice.depths, once.depths, atol=1e-12, rtol=0)
    assert_close(twice.positions, once.positions, atol=1e-12, rtol=0)
    assert_close(twice.counts, once.counts + 1)


def test_a_chain_of_close_depths_by_hand():
    # 1.0 and 1.1 are closest and merge to 1.05; 1.25 is then 0.2 away: no merge within 0.15.
    z = torch.tensor([1.0, 1.1, 1.25], dtype=D)
    rays = torch.tensor([[0.0, 0, 1]], dtype=D) * z[:, None]
    memory = ldi.insert(ldi.empty(camera(), 0.15), rays, torch.zeros(3, 3, dtype=D))
    assert memory.depths.tolist() == pytest.approx([1.05, 1.25])
    assert memory.counts.tolist() == [2, 1]


def test_the_cap_merges_the_closest_and_says_so():
    z = torch.tensor([1.0, 2.0, 2.5, 4.0], dtype=D)
    rays = torch.tensor([[0.0, 0, 1]], dtype=D) * z[:, None]
    memory = ldi.insert(ldi.empty(camera(), 0.1, 3), rays, torch.zeros(4, 3, dtype=D))
    assert memory.depths.tolist() == pytest.approx([1.0, 2.25, 4.0])
    assert memory.forced == 1


def test_of_equal_gaps_the_cap_merges_the_first_of_each_pixel():
    """Two pixels; in each the first two layers are as near as the next two are."""
    z = torch.tensor([1.0, 2.0, 4.0, 5.0, 8.0], dtype=D)
    rays = torch.cat([torch.tensor([[x, 0.0, 1]], dtype=D) * z[:, None] for x in (0.0, 0.2)])
    memory = ldi.insert(ldi.empty(camera(), 0.1, 4), rays, torch.zeros(10, 3, dtype=D))
    assert len(memory.pixels.unique()) == 2
    assert memory.depths.tolist() == pytest.approx([1.5, 4, 5, 8] * 2)
    assert memory.forced == 2


@pytest.mark.parametrize("z", [0.0, -1.0, 0.01])
def test_samples_that_the_reference_camera_cannot_see_are_ignored(z):
    memory = ldi.insert(
        ldi.empty(camera(), 0.1), torch.tensor([[0.0, 0, z]]).to(D), torch.zeros(1, 3, dtype=D)
    )
    assert len(memory) == 0
    assert memory.unseen == 1


def test_merged_colours_and_places_are_means_over_their_samples():
    """Three samples in two batches: 1 + 1, then + 1, weighted by what each side holds."""
    places = torch.tensor([[0.0, 0, 1.0], [0.1, 0, 1.1], [0.0, 0.05, 1.02]], dtype=D)
    tints = torch.tensor([[0.0, 0.3, 0.9], [1.0, 0.3, 0.3], [0.2, 0.9, 0.0]], dtype=D)
    memory = ldi.insert(ldi.empty(camera(), 0.2), places[:2], tints[:2])
    assert_close(memory.colours, tints[:2].mean(dim=0, keepdim=True))
    memory = ldi.insert(memory, places[2:], tints[2:])
    assert memory.counts.tolist() == [3]
    assert_close(memory.colours, tints.mean(dim=0, keepdim=True))
    assert_close(memory.positions, places.mean(dim=0, keepdim=True))


@pytest.mark.parametrize(("eps", "cap"), [(0.0, 8), (-1.0, 8), (float("nan"), 8), (0.1, 0)])
def test_senseless_settings_are_refused(eps, cap):
    with pytest.raises(ValueError, match="merge_distance"):
        ldi.empty(camera(), eps, cap)
