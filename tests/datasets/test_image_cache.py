import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from splatproof.base.errors import UsageError
from splatproof.datasets.image_cache import ImageCache, TensorCache
from splatproof.reference.types.camera import Camera
from splatproof.reference.types.scene import View

CAMERA = Camera(
    K=torch.eye(3, dtype=torch.float64),
    world_to_camera=torch.eye(4, dtype=torch.float64),
    width=8,
    height=4,
)
IMAGE_BYTES = 8 * 4 * 3 * 4


def view(i: int, loads: list[int] | None = None) -> View:
    def load() -> torch.Tensor:
        if loads is not None:
            loads.append(i)
        return torch.full((4, 8, 3), i / 5000)

    return View(name=f"{i}.png", camera=CAMERA, load=load)


def test_5000_views_stay_within_the_bound():
    cache = ImageCache(20 * IMAGE_BYTES + 5)
    views = [view(i) for i in range(5000)]
    for i, one in enumerate(views):
        assert cache.load(one)[0, 0, 0] == torch.tensor(i / 5000)
        assert cache.held <= 20 * IMAGE_BYTES + 5
    assert cache.held == 20 * IMAGE_BYTES


def test_the_least_recently_used_image_goes_first():
    loads: list[int] = []
    cache = ImageCache(2 * IMAGE_BYTES)
    a, b, c = (view(i, loads) for i in range(3))
    for one in (a, b, a, c, a, b):
        cache.load(one)
    assert loads == [0, 1, 2, 1]


@pytest.mark.parametrize("drops", [True, False])
def test_what_does_not_drop_finds_as_many_as_fit_in_every_round(drops):
    made: list[int] = []
    cache = pickle.loads(pickle.dumps(TensorCache(4 * 40, drops=drops)))
    draw = torch.Generator().manual_seed(0)
    for _ in range(5):
        for key in torch.randperm(40, generator=draw).tolist():
            value = cache.get(
                key, lambda key=key: made.append(key) or torch.full((10,), float(key))
            )
            assert float(value[0]) == key
            assert cache.held <= cache.limit
    assert (len(made) == 40 + 4 * 36) == (not drops)
    assert len(made) > 190 or not drops  # of 200, so fewer than 10 of 160 were found


@pytest.mark.parametrize("drops", [True, False])
def test_a_smaller_bound_lets_go_of_what_was_asked_for_longest_ago(drops):
    cache = TensorCache(4 * 40, drops=drops)
    for key in (0, 1, 2, 3, 0):
        cache.get(key, lambda: torch.zeros(10))
    cache.bound(2 * 40 + 39)
    assert (cache.held, len(cache)) == (2 * 40, 2)
    for key in (0, 3):
        cache.get(key, lambda: pytest.fail("it left"))
    cache.bound(0)
    assert (cache.held, len(cache)) == (0, 0)
    cache.bound(4 * 40)
    cache.get(5, lambda: torch.zeros(10))
    assert cache.held == 40


def test_views_of_one_name_are_not_mixed_up():
    cache = ImageCache(10 * IMAGE_BYTES)
    first, second = view(1), view(1)
    second = View(name=first.name, camera=CAMERA, load=lambda: torch.ones(4, 8, 3))
    assert not torch.equal(cache.load(first), cache.load(second))


@pytest.mark.parametrize("limit", [0, IMAGE_BYTES - 1])
def test_an_image_above_the_bound_is_returned_and_not_kept(limit):
    loads: list[int] = []
    cache = ImageCache(limit)
    one = view(3, loads)
    cache.load(one)
    cache.load(one)
    assert loads == [3, 3]
    assert cache.held == 0


def test_threads_never_pass_the_bound_and_share_one_load():
    loads: list[int] = []
    cache = ImageCache(7 * IMAGE_BYTES)
    views = [view(i, loads) for i in range(40)]
    most = []

    def work(seed: int) -> None:
        order = torch.randperm(40, generator=torch.Generator().manual_seed(seed)).tolist()
        for i in order:
            assert cache.load(views[i])[0, 0, 0] == torch.tensor(i / 5000)
            most.append(cache.held)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, range(8)))
    assert max(most) <= 7 * IMAGE_BYTES

    slow = TensorCache(1000)
    calls: list[int] = []
    start = threading.Barrier(4)

    def make() -> torch.Tensor:
        calls.append(1)
        time.sleep(0.05)
        return torch.zeros(3)

    def ask(_: int) -> None:
        start.wait()
        slow.get("key", make)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(ask, range(4)))
    assert len(calls) == 1


def test_a_failed_load_is_tried_again():
    cache = TensorCache(1000)

    def fail() -> torch.Tensor:
        raise OSError("gone")

    with pytest.raises(OSError, match="gone"):
        cache.get("key", fail)
    assert torch.equal(cache.get("key", lambda: torch.ones(2)), torch.ones(2))


def test_a_negative_bound_is_refused():
    with pytest.raises(UsageError, match="-1 bytes"):
        ImageCache(-1)
