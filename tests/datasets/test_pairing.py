import numpy as np
import pytest

from splatproof.datasets import pairing


def test_exhaustive_and_following():
    assert pairing.exhaustive(4) == {(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)}
    assert pairing.following(3) == {(0, 1), (0, 2), (1, 2)}
    assert len(pairing.following(100)) == 5 * 100 - 15
    assert (3, 8) in pairing.following(100)
    assert (3, 9) not in pairing.following(100)


def test_nearest_by_brute_force(monkeypatch):
    monkeypatch.setattr(pairing, "NEIGHBOURS", 4)
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 100, (25, 2))
    of = [2 * i for i in range(25)]  # photos in between have no GPS
    expected = set()
    for a in range(25):
        order = np.argsort(np.linalg.norm(positions - positions[a], axis=1))
        expected |= {tuple(sorted((of[a], of[int(b)]))) for b in order[1:5]}
    assert pairing.nearest(positions, of) == expected


@pytest.mark.parametrize("count", [1, 2, 3])
def test_nearest_of_very_few(count):
    positions = np.arange(2.0 * count).reshape(count, 2)
    assert pairing.nearest(positions, list(range(count))) == pairing.exhaustive(count)


def test_photos_that_share_descriptors_are_alike(monkeypatch):
    """Photos 2 i and 2 i + 1 show the same place: each must find its partner."""
    monkeypatch.setattr(pairing, "ALIKE", 1)
    rng = np.random.default_rng(1)
    places = [rng.integers(0, 256, (200, 128)) for _ in range(10)]
    photos = []
    for i in range(20):
        noise = rng.integers(-8, 9, (200, 128))
        photos.append(np.clip(places[i // 2] + noise, 0, 255).astype(np.uint8))
    found = pairing.alike(pairing.vlad(photos, 0), range(20))
    assert found == {(i, i + 1) for i in range(0, 20, 2)}
    assert np.array_equal(pairing.vlad(photos, 0), pairing.vlad(photos, 0))


def test_photos_without_features_are_alike_to_nothing_in_particular():
    none = np.zeros((0, 128), dtype=np.uint8)
    table = pairing.vlad([none, none], 0)
    assert np.isfinite(table).all()
    some = np.random.default_rng(0).integers(0, 256, (500, 128)).astype(np.uint8)
    table = pairing.vlad([none, some], 0)
    assert np.linalg.norm(table[0]) == 0
    assert np.linalg.norm(table[1]) == pytest.approx(1, abs=1e-5)
